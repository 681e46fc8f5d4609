"""Calibrates the camera by moving it over a segment of the line before the line is followed ([L] 4.4).

Only what a real cell has is used: commands and motor angles, the model's gear deflection, camera fields with their time
stamps, and the reference path near the line.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import held
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.robots.interface import RobotState
from planning import OutOfReachError
from planning.line.line_follower import line_ahead
from planning.path.joint_path import JointPath
from planning.path.joints_beside import JointsBeside
from planning.path.kinematics import InverseKinematics
from scenes.line_way import calibration_postures, middle_of_view, shapes_about
from scenes.online.known import Known
from scenes.online.line_known import REST, CalibrationView, SeenBefore, piece_map, view_of
from scenes.online.live_arm import moves
from sensing import SensingError
from sensing.camera.camera_device import Field
from sensing.camera.hand_eye import HandEye, calibrate
from sensing.camera.line_appearance import line_appearance
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows
from sim.arm.arm import SimulatedArm
from sim.camera.camera import RenderedCamera
from sim.camera.lamp import ArmShape
from sim.equipped_arm import shadow_of

SPARING = 4
"""One field in so many is looked at: neighbours tell the same."""
HOPELESS = 20
"""Fields without the line after which to give up."""
BEFORE = 10**7
"""Numbers the calibration's fields apart from those of the run: their noise must not be the same."""


def calibrate_by_moving(known: Known, arm: SimulatedArm, camera: RenderedCamera,
                        deflection: GearDeflection | None, at: float, before: SeenBefore,
                        moved: list[RobotState] | None = None) -> HandEye:
    """Calibrates the camera from fields that it takes while the arm moves it over one segment of the line.

    The arm goes from pose to pose through its positional interface; fields are taken at short rests and on the way.
    Raises SceneError where fewer than half of the poses can be reached, or fewer than half of the fields show the line.

    Args:
        known: arm, reference path, camera as mounted by hand and detector; where the line really is stays unknown.
        arm: the arm; it is put to rest at the first pose.
        camera: the simulated camera.
        deflection: the gears' deflection as the model knows it.
        at: arc length of the reference around which the piece lies [m].
        before: the line's appearance and places in earlier pictures.
        moved: receives the controller's reports, cycle by cycle.
    """
    robot, reference, believed = known.robot, known.reference, known.camera
    T, ahead = arm.t_ipo, BEFORE / camera.settings.rate  # the camera's clock runs ahead by a whole number of fields
    fusion, detection = piece_map(reference, at, before), before.detection
    path = JointPath.of(robot, reference)
    postures = calibration_postures(robot, reference, path, believed, at, known.clear, shapes_about(known.scene, robot),
                                    line=line_ahead(reference, fusion, np.array([at])))
    commands = held(moves(robot, postures, REST), before=max(round(REST / T), 1) - 1)
    arm.reset(commands[0])
    camera.restart()
    view = CalibrationView(robot, reference, believed, detection, known.detector, commands[0], fusion,
                           JointsBeside(robot, path, at, float(middle_of_view(believed)[0])))
    shape = ArmShape(robot) if camera.lamp is not None else None
    sag = np.zeros(commands.shape) if deflection is None else deflection.along(commands)
    late, due, fields, moved = list[tuple[Field, PredictedLine]](), 0, 0, [] if moved is None else moved
    for k, q_c in enumerate(commands):
        exposures = camera.due(k * T + ahead, (k + 1) * T + ahead)
        instants, due = [t for i, t in enumerate(exposures, due) if i % SPARING == 0], due + len(exposures)
        predictions = [view.predicted(camera.stamp(t) - ahead) for t in instants]
        moved.append(arm.cycle(q_c))
        view.history.add((k + 1) * T, moved[-1].q - sag[k])
        for t, prediction in zip(instants, predictions, strict=True):
            middle = max(t - ahead, 0.0)
            late.append((camera.windows(
                t, lambda at: arm.tcp_at(max(at - ahead, 0.0)), search_windows(believed, prediction, detection),
                shadow_of(shape, arm, middle), arm.q_at(middle) if camera.shows_arm else None), prediction))
        # The pose at a time stamp is known once the controller has reported it.
        while late and late[0][0].t_stamp - ahead < k * T:
            fields += 1
            view.look(*late.pop(0), ahead)
        if fields >= HOPELESS and not view.observations:
            break
    return calibrate(believed, view.observations, *view.piece(at, fields, "or set calibration.by_moving = false"),
                     known.prior)


LOOKS = 5
"""Whole pictures of a line that are taken at least; one of them may fall into a gap."""


def look_at_line(known: Known, arm: SimulatedArm, camera: RenderedCamera, span: tuple[float, float],
                 rng: np.random.Generator) -> SeenBefore:
    """Finds place and appearance of the whole line in pictures from above its expected place.

    Raises SensingError where no picture shows a line.

    Args:
        known: arm, reference path and camera as mounted by hand; where the line really is stays unknown.
        arm: the arm; it is put to rest above each place.
        camera: the simulated camera.
        span: arc lengths of the reference between which the line ought to be [m].
        rng: of the pictures' noise.
    """
    robot, reference, believed, clear = known.robot, known.reference, known.camera, known.clear
    kinematics, above = InverseKinematics(robot), pin.SE3(np.eye(3), np.array([0.0, 0.0, -clear]))
    pictures, q = [], robot.home
    near, far = view_of(believed)
    looks = max(LOOKS, 1 + int(np.ceil((span[1] - span[0]) / (far - near))))
    for s in np.linspace(span[0] - near, span[1] - far, looks):
        try:
            q = kinematics.search(reference.pose(s) * above, q)
        except OutOfReachError:
            continue
        arm.reset(q)
        pictures.append((camera.frame(arm.truth.tcp, rng, q=arm.q_a), robot.fk()(q)))
    if not pictures:
        raise SensingError("the arm reaches no place above the line")
    line = line_appearance([picture for picture, _ in pictures], believed, clear)
    return SeenBefore.of(DetectionSettings.of(line.width, line.contrast if line.dark else -line.contrast), line.places,
                         pictures, reference)
