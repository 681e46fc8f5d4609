"""The camera before the job: calibrated by moving, and then whether it sees the line at one place from two poses.

A camera that has been knocked, or pictures that are cut or shifted, show the same piece of the line at two places when
it is looked at from two heights and two sides; an arm that does not follow is noticed on the way. What weighs on the
force sensor is looked at where its tool is turned (``scenes.online.force_calibration``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.model.model import Model
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from scenes.online.line_known import REST, CalibrationView, calibration_postures, piece_map
from scenes.online.live_arm import LiveArm, moves
from scenes.online.live_sensors import FoundBefore, ImaginedCamera, LiveCamera
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import PRIOR, HandEye
from sensing.camera.line_search import DetectionSettings

# The camera on the tool is calibrated by moving the real arm over a piece of the line ([L] 4.4).

_COMPUTING = 60.0
"""How long the computation may take; the arm is held meanwhile [s]."""


@dataclass(frozen=True)
class Piece:
    """The piece of the line that is looked at.

    Attributes:
        at: arc length of the reference around which the piece lies [m].
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        clear: how far the tip keeps away from the reference at least [m].
        shapes: the arm in its cell.
        prior: of the calibration, see ``sensing.camera.hand_eye.calibrate``.
    """

    reference: ReferencePath
    at: float
    start: Array
    clear: float = 0.0
    shapes: Shapes | None = None
    prior: Mapping[str, float] = field(default_factory=lambda: PRIOR)


@dataclass(frozen=True)
class CalibrationMotion:
    """From the start over the piece of the line and back, which is planned before the arm is connected.

    Attributes:
        out, over, back: commands ``(N, n)`` [rad] from rest to rest. On the way there and back another piece of the
            line is seen, or none: that fits no common curve.
        deflection: of the gears.
        view: of the camera as mounted by hand.
    """

    piece: Piece
    out: Array
    over: Array
    back: Array
    deflection: GearDeflection
    view: CalibrationView

    @classmethod
    def planned(cls, piece: Piece, by_hand: CameraModel, model: Model, robot: Robot, detection: DetectionSettings
             ) -> CalibrationMotion:
        """Plans it, and loads what is compiled: nothing of either may fall into a cycle.

        Args:
            piece: of the line.
            by_hand: the camera as mounted by hand.
            model: of the arm, for the gears' deflection.
            robot: the arm.
            detection: how the line looks.

        Raises:
            SceneError: too few of the poses can be reached, or the arm would touch something.
        """
        reference, start, at = piece.reference, piece.start, piece.at
        postures = calibration_postures(robot, reference, by_hand, at, piece.clear, piece.shapes)
        for end in (postures[0], postures[-1]):
            if piece.shapes is not None and (touch := piece.shapes.touch_between(start, end)) is not None:
                raise SceneError(f"the camera cannot be calibrated: {touch} between the start and the calibration's "
                                 "poses; set calibration.by_moving = false")
        out, over, back = (moves(robot, some, REST) for some in ([start, postures[0]], postures, [postures[-1], start]))
        imagined, view = (CalibrationView(robot, reference, by_hand, detection, FoundBefore(), start,
                                          piece_map(reference, at)) for _ in range(2))
        imagined.history.add(robot.t_ipo, start)
        camera, t = ImaginedCamera(), 0.5 * robot.t_ipo
        camera.predict = imagined.predicted
        camera.request(t, t, lambda _: None)
        for shown in camera.arrived(t):
            imagined.look(shown, imagined.predicted(t), 0.0)
        deflection = GearDeflection(model, robot.t_ipo)
        deflection.along(out)
        return cls(piece, out, over, back, deflection, view)


def calibrated_by_moving(motion: CalibrationMotion, arm: LiveArm, camera: LiveCamera) -> HandEye:
    """Moves from the start over the piece of the line and back; returns the camera that explains what was seen.

    Args:
        motion: as planned.
        arm: at the start, and again when this returns.
        camera: on the arm.

    Raises:
        SceneError: too few of the fields show the line.
        FollowStoppedError: the arm has to stop, or is gone.
    """
    piece, view = motion.piece, motion.view
    ways = arm.timed(motion.out, motion.over, motion.back)
    commands = np.concatenate(ways)
    sag = arm.meanwhile(lambda: motion.deflection.along(commands))
    begin, end = arm.t_ipo * np.cumsum([len(way) for way in ways])[:2]
    arm.begin()
    camera.predict = view.predicted
    fields = 0
    with arm.motion():
        for q_c, bent in zip(commands, sag, strict=True):
            arm.check(arm.t)
            arm.q_d = q_c
            q = arm.cycle(q_c).q
            view.history.add(arm.t, q - bent)
            for shown in camera.arrived(arm.t):
                if begin <= shown.t_stamp <= end:
                    fields += 1
                    view.look(shown, view.predicted(shown.t_stamp), 0.0)
    near, up = view.piece(piece.at, fields, "how it looks (line.gray, line.width_mm), and the camera")
    arm.meanwhile(lambda: camera.calibrate(view.believed, view.observations, near, up, piece.prior))
    for _ in range(int(_COMPUTING / arm.robot.t_ipo)):
        if camera.hand_eye is not None:
            break
        arm.check(arm.t)
        arm.cycle(piece.start)
    if not isinstance(camera.hand_eye, HandEye):
        raise SceneError(f"the camera could not be calibrated: {camera.hand_eye or 'it took too long'}")
    return camera.hand_eye


# The line is looked at from two poses.

POSES = ((0.04, 0.0), (0.09, 0.35))
"""Height of the tip above the surface [m] and turn about its normal [rad], from which the line is looked at."""
AHEAD = 0.06
"""Way behind the begin of the line to the place that is looked at [m]."""
STILL = 0.5
"""Rest in each pose, in which pictures count [s]."""
FEWEST, PATIENCE = 5, 2.0
"""Pictures that have to show the line in each pose, and how long beyond the rest a slow camera is waited for [s]."""
APART = 0.0004
"""Distance of the two places at which the line may be seen [m]. On the simulated cell it is 0.05 mm with the true
camera, 0.7 with pictures moved by eight pixels, 1.1 with a camera as it was mounted by hand."""


@dataclass(frozen=True)
class Look:
    """What is looked at.

    Attributes:
        begin: arc length of the reference at which the line begins [m].
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        camera: as it is calibrated.
    """

    reference: ReferencePath
    begin: float
    start: Array
    camera: CameraModel
    model: Model


def check_line(look: Look, arm: LiveArm, camera: LiveCamera) -> float:
    """Looks at the line from two poses; returns how far apart it is seen [m].

    Args:
        look: at what.
        arm: at the start, and again when this returns.
        camera: on the arm.

    Raises:
        SceneError: the line is not seen, or at two places.
        FollowStoppedError: the arm does not follow, the camera is gone, or its stamps wander.
    """
    robot = arm.robot
    postures, view = arm.meanwhile(lambda: (_postures(look, robot), CalibrationView(
        robot, look.reference, look.camera, camera.detection, FoundBefore(), look.start,
        piece_map(look.reference, look.begin + AHEAD))))
    arm.begin()
    camera.predict = view.predicted
    places, last = [], look.start
    for q in postures:
        places.append(_seen(look, arm, camera, view, moves(robot, [last, q], STILL)))
        last = q
    camera.predict = None
    arm.lead(moves(robot, [last, look.start], 2 * robot.t_ipo))
    apart = float(abs(places[1] - places[0]))
    if not apart <= APART:
        raise SceneError(f"the line is seen {1e3 * apart:.1f} mm apart from two poses above it, where a calibrated "
                         f"camera sees it within {1e3 * APART:.1f} mm; calibrate the camera anew, or see "
                         "docs/follow.md for what --no-check leaves out")
    return apart


def _postures(look: Look, robot: Robot) -> list[Array]:
    """Joint angles from which the optical axis meets the line where it is looked at."""
    s = look.begin + AHEAD
    up, place = look.reference.frames(np.array([s])).up[0], look.reference.position(np.array([s]))[0]
    mount, kinematics, q = look.camera.T_tool_camera, InverseKinematics(robot), look.start
    axis, postures = mount.rotation[:, 2], list[Array]()
    for height, turn in POSES:
        rotation = pin.exp3(turn * up) @ look.reference.rotation(s)
        # In the tool frame, whose z axis points into the surface.
        met = mount.translation + (height - mount.translation[2]) / axis[2] * axis
        try:
            q = kinematics.search(pin.SE3(rotation, place - rotation @ met), q)
        except OutOfReachError as error:
            raise SceneError(f"the line cannot be looked at from above: {error}; or follow with --no-check") from error
        postures.append(q)
    return postures


def _seen(look: Look, arm: LiveArm, camera: LiveCamera, view: CalibrationView, commands: Array) -> float:
    """Leads the arm by commands ``(N, n)`` [rad]; how far beside the reference the line is seen at their end [m]."""
    commands = arm.timed(commands)
    sag = arm.meanwhile(lambda: GearDeflection(look.model, arm.t_ipo).along(commands))
    rests = arm.t + arm.t_ipo * len(commands) - STILL + 0.1
    beside = list[float]()
    with arm.motion():
        for cycle in range(len(commands) + round(PATIENCE / arm.t_ipo)):
            if cycle >= len(commands) and len(beside) >= FEWEST:
                break
            q_c = commands[min(cycle, len(commands) - 1)]
            arm.check(arm.t)
            arm.q_d = q_c
            # In the last row the deflection is not known; the arm rests before it.
            view.history.add(arm.t + arm.t_ipo, arm.cycle(q_c).q - sag[min(cycle, len(commands) - 2)])
            for shown in camera.arrived(arm.t):
                detected = view.detector.detect(shown, look.camera, view.predicted(shown.t_stamp), view.detection)
                if shown.t_stamp < rests or not detected.seen:
                    continue
                pose = view.history.pose(shown.t_stamp)
                points = detected.points_tcp[detected.used] @ pose.rotation.T + pose.translation
                beside.append(float(np.mean(look.reference.project(points, look.begin + AHEAD)[1])))
    if len(beside) < FEWEST:
        raise SceneError(f"only {len(beside)} pictures from above showed the line; check where it is, how it looks "
                         "(line.gray, line.width_mm) and whether the camera sends")
    return float(np.median(beside))
