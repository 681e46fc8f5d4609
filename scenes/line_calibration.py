"""The camera on the tool, calibrated by moving before the line is followed ([L] 4.4)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.interface import Array
from ideal_robot.robot import Robot
from planning.errors import OutOfReachError
from planning.kinematics import InverseKinematics
from planning.reference import ReferencePath
from scenes.errors import SceneError
from sensing.camera_model import CameraModel
from sensing.hand_eye import HandEye, Observation, calibrate, calibration_poses
from sensing.line_detection import DetectionSettings, PredictedLine, detect_line, search_windows
from sim.arm import SimulatedArm
from sim.camera import RenderedCamera

SPREAD = np.linspace(-0.06, 0.06, 9)
"""Places on the line looked for in each field, around the middle of the piece [m]."""
SIGMA = 0.006
"""How far the line may be from its reference, standard deviation [m]."""
FIELDS = 3
"""Fields taken at each pose, at rest."""
BEFORE = 10**7
"""Numbers the calibration's fields apart from those of the run: their noise must not be the same."""


def calibrate_by_moving(robot: Robot, reference: ReferencePath, believed: CameraModel, arm: SimulatedArm,
                        camera: RenderedCamera, deflection: GearDeflection | None, at: float,
                        detection: DetectionSettings) -> HandEye:
    """Looks at one piece of the line from many poses at rest and returns the camera that explains all of them.

    Only what a real cell has is used: motor angles, the model's gear deflection, and images.

    Args:
        robot: the arm.
        reference: the reference path; where the line really is stays unknown.
        believed: the camera as mounted by hand.
        arm: the arm, put to rest at each pose.
        camera: renders what the true camera sees from there.
        deflection: the gears' deflection as the model knows it.
        at: arc length of the reference around which the piece lies [m].
        detection: how the line looks.

    Raises:
        SceneError: fewer than half of the poses can be reached or show the line.
    """
    frames = reference.frames(np.array([at]))
    normal = frames.up[0]
    kinematics = InverseKinematics(robot)
    pose_of = robot.fk()
    s = at + SPREAD
    ahead = reference.frames(s)
    wanted = calibration_poses(frames.position[0], frames.tangent[0], normal, believed.T_tool_camera.translation[0])
    guess = kinematics.search(reference.pose(at), robot.home)
    observations = []
    period = 1.0 / camera.settings.rate
    for i, target in enumerate(wanted):
        try:
            q = kinematics.search(target, guess)
        except OutOfReachError:
            continue
        arm.reset(q)
        true_pose = arm.truth.tcp
        told = pose_of(q if deflection is None else q - deflection.at(np.tile(q, (3, 1))))
        prediction = PredictedLine.from_base(ahead.position, ahead.tangent, normal, told, SIGMA)
        windows = search_windows(believed, prediction, detection)
        for j in range(FIELDS):
            exposure = camera.settings.phase + (BEFORE + FIELDS * i + j) * period
            seen = detect_line(camera.windows(exposure, _at_rest(true_pose), windows), believed, prediction, detection)
            if seen.seen:
                observations.append(Observation(told, seen.pixels[seen.used], seen.sigma[seen.used]))
    if len(observations) < FIELDS * len(wanted) // 2:
        raise SceneError(f"the camera could not be calibrated: only {len(observations)} of {FIELDS * len(wanted)} "
                         "fields showed the line; check where the line is, or set calibration.by_moving = false")
    return calibrate(believed, observations, reference.position(np.linspace(s[0] - 0.1, s[-1] + 0.1, 400)), normal,
                     prior=None)


def _at_rest(pose: pin.SE3) -> Callable[[float], pin.SE3]:
    return lambda t: pose


def lateral_bias(true: CameraModel, believed: CameraModel, height: float, ahead: Array) -> Array:
    """How far beside its place a line straight ahead is believed to be ``(m,)`` [m]: what a calibration leaves.

    Args:
        true, believed: the two cameras.
        height: of the TCP above the surface [m].
        ahead: distances ahead of the TCP ``(m,)`` [m].
    """
    points = np.column_stack([ahead, np.zeros(len(ahead)), np.full(len(ahead), height)])
    back = believed.on_plane(true.project_tool(points), np.array([0.0, 0.0, -1.0]), -height)
    return np.asarray(back[:, 1])
