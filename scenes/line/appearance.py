"""The camera looks at the line before anything is calibrated: how wide it is, dark or bright."""

from __future__ import annotations

import numpy as np

from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from planning.planning_error import OutOfReachError
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_appearance import line_appearance
from sensing.camera.line_search import DetectionSettings
from sensing.sensing_error import SensingError
from sim.arm.arm import SimulatedArm
from sim.camera.camera import RenderedCamera

LOOKS = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Shares of the line at which a whole picture is taken; one of them may fall into a gap."""
CONTRAST = 0.3
"""Share of the line's contrast below which a cross-section does not count."""


def look_at_line(robot: Robot, reference: ReferencePath, believed: CameraModel, arm: SimulatedArm,
                 camera: RenderedCamera, span: tuple[float, float], rng: np.random.Generator) -> DetectionSettings:
    """Puts the arm above a few places where the line ought to be, and takes from its pictures how the line looks.

    Args:
        robot: the arm.
        reference: the reference path; where the line really is stays unknown.
        believed: the camera as mounted by hand.
        arm: the arm; it is put to rest above each place.
        camera: renders what the true camera sees.
        span: arc lengths of the reference between which the line ought to be [m].
        rng: of the pictures' noise.

    Raises:
        SensingError: no picture shows a line.
    """
    kinematics = InverseKinematics(robot)
    pictures, q = [], robot.home
    for share in LOOKS:
        try:
            q = kinematics.search(reference.pose(span[0] + share * (span[1] - span[0])), q)
        except OutOfReachError:
            continue
        arm.reset(q)
        pictures.append(camera.frame(arm.truth.tcp, rng, q=arm.q_a))
    if not pictures:
        raise SensingError("the arm reaches no place above the line")
    seen = line_appearance(pictures, believed)
    return DetectionSettings(line_width=seen.width, dark=seen.dark,
                             min_contrast=min(DetectionSettings.min_contrast, CONTRAST * seen.contrast))
