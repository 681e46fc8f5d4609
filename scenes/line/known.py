"""What is known of a line scene before anything moves, by whoever follows the line: nothing of the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from planning.line.line_follower import FollowerSettings, LineFollower
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile
from planning.planning_error import OutOfReachError
from scenes.line.scene import LineScene
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import LineDetector

HORIZON = 0.3
"""Time for which desired positions are handed to the ideal robot, several of its main time constants ([L] 2.2) [s]."""
FOUND = (0.001, 0.0005)
"""What calibration by moving leaves open of the surface's height [m] and slope [rad], standard deviations."""
EDGE = 4
"""Pixels at the edge of a picture in which no line is looked for: half a window, and what the tool sways."""
START = 0.48
"""Time at rest before the path begins, in which the ideal robot takes up the gears' deflection under gravity [s]."""


@dataclass(kw_only=True)
class Known:
    """What a follower of the line is given.

    Attributes:
        scene: the file; of its tables those of the world are not looked at.
        robot: as its data sheet has it, with the controller's cycles.
        delay: cycles between the hand-over of a command and the begin of its interpolation.
        camera: as it is believed: by hand at first, then as calibrated.
        reference: the reference path.
        follower: plans along it.
        detector: finds the line's points in a field.
    """

    scene: LineScene
    robot: Robot
    delay: int
    camera: CameraModel
    reference: ReferencePath
    follower: LineFollower
    detector: LineDetector


def line_follower(scene: LineScene, robot: Robot, points: Array, camera: CameraModel, surface: pin.SE3 | None = None,
                  latency: float = FollowerSettings.latency) -> tuple[ReferencePath, LineFollower]:
    """Reference path and follower of a scene.

    Args:
        scene: speed, limits and what is measured.
        robot: the arm with the controller's cycle.
        points: of the reference ``(N, 3)`` [m].
        camera: as it is believed.
        surface: motion that takes the surface to where calibration saw it: the reference is laid on it. What it could
            not tell, or all of it where there was none, is left to the follower.
        latency: usual age of a field when it arrives [s].

    Raises:
        InputError: line out of reach, unreachable speed, a motion longer than the scene allows.
    """
    up = scene.surface.pose().rotation[:, 2]
    height, tilt = FollowerSettings.height, FollowerSettings.tilt
    if surface is not None:
        points, up = points @ surface.rotation.T + surface.translation, surface.rotation @ up
        height, tilt = FOUND
    reference = ReferencePath(points, up=up, turning=1.0)
    try:
        profile = SpeedProfile.plan(robot, reference, Limits(scene.speed, scene.reference.acceleration))
        scene.check_duration(profile.duration)
        follower = LineFollower(
            robot, reference, profile, round(HORIZON / robot.t_ipo), t_start=START, line_span=span_of(scene, reference),
            eye=camera.T_tool_camera.translation,
            settings=FollowerSettings(measurement=scene.measurement, height=height, tilt=tilt, view=view_of(camera),
                                      max_blind=scene.max_gap, max_search=scene.max_gap + 0.05, latency=latency,
                                      stamp=FollowerSettings.stamp if scene.stamp_estimate else 0.0))
    except OutOfReachError as error:
        raise InputError(f"the line is out of reach: {error}", field="surface.origin",
                         value=list(scene.surface.origin)) from error
    return reference, follower


def view_of(camera: CameraModel) -> tuple[float, float]:
    """Nearest and farthest distance ahead of the tool at which this camera shows a line [m], at most the usual ones."""
    ahead = np.linspace(*FollowerSettings.view, 151)
    pixels = camera.project_tool(np.column_stack([ahead, np.zeros((len(ahead), 2))]))
    size = np.array([camera.width, camera.height])
    shown = ahead[np.all((pixels >= EDGE) & (pixels <= size - 1 - EDGE), axis=1)]
    return (float(shown[0]), float(shown[-1])) if len(shown) > 1 else FollowerSettings.view


def span_of(scene: LineScene, reference: ReferencePath) -> tuple[float, float]:
    """Arc lengths of the reference between which the line ought to be [m]."""
    return scene.reference.run_up, reference.length - scene.reference.run_out
