"""The cell is looked at before the job: the line from two poses above the surface, and whether pictures come evenly.

A camera that has been knocked, or pictures that are cut or shifted, show the same piece of the line at two places when
it is looked at from two heights and two sides; an arm that does not follow is noticed on the way. What weighs on the
force sensor is looked at where its tool is turned (``scenes.online.force_calibration``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from scenes.online.line_known import CalibrationView, piece_map
from scenes.online.live_arm import LiveArm, moves
from scenes.online.live_sensors import FoundBefore, LiveCamera
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_model import CameraModel

POSES = ((0.04, 0.0), (0.09, 0.35))
"""Height of the tip above the surface [m] and turn about its normal [rad], from which the line is looked at."""
AHEAD = 0.06
"""Way behind the begin of the line to the place that is looked at [m]."""
REST = 0.5
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
        reference: the reference path.
        begin: arc length at which the line begins [m].
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        camera: as it is calibrated.
        model: of the arm, for the gears' deflection.
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
        places.append(_seen(look, arm, camera, view, moves(robot, [last, q], REST)))
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
    axis, postures = mount.rotation[:, 2], []
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


def _seen(look: Look, arm: LiveArm, camera: LiveCamera, view: CalibrationView, way: Array) -> float:
    """Leads the arm to a pose and returns how far beside the reference the line is seen from there [m].

    Args:
        look: at what.
        arm: to be led.
        camera: on it.
        view: what is known of arm and line meanwhile.
        way: commands ``(N, n)`` to the pose and at rest there [rad].
    """
    sag = arm.meanwhile(lambda: GearDeflection(look.model, arm.t_ipo).along(way))
    rests = arm.t + arm.t_ipo * len(way) - REST + 0.1
    beside = list[float]()
    for cycle in range(len(way) + round(PATIENCE / arm.t_ipo)):
        if cycle >= len(way) and len(beside) >= FEWEST:
            break
        q_c = way[min(cycle, len(way) - 1)]
        arm.check(arm.t)
        arm.q_d = q_c
        # In the last row the deflection is not known; the arm rests before it.
        view.history.add(arm.t + arm.t_ipo, arm.cycle(q_c).q - sag[min(cycle, len(way) - 2)])
        for field in camera.arrived(arm.t):
            found = view.detector.detect(field, look.camera, view.predicted(field.t_stamp), view.detection)
            if field.t_stamp < rests or not found.seen:
                continue
            pose = view.history.pose(field.t_stamp)
            points = found.points_tcp[found.used] @ pose.rotation.T + pose.translation
            beside.append(float(np.mean(look.reference.project(points, look.begin + AHEAD)[1])))
    if len(beside) < FEWEST:
        raise SceneError(f"only {len(beside)} pictures from above showed the line; check where it is, how it looks "
                         "(line.gray, line.width_mm) and whether the camera sends")
    return float(np.median(beside))
