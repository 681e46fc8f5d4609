"""Looking at one piece of the line while the camera moves over it: where to move, what to expect, what was seen."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from planning.path.pose_history import PoseHistory
from planning.path.reference import ReferencePath
from planning.planning_error import OutOfReachError
from scenes.scene_error import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import LineDetector
from sensing.camera.field import Field
from sensing.camera.hand_eye import Observation, calibration_poses
from sensing.camera.line_detection import DetectionSettings, PredictedLine
from sensing.camera.rolling_readout import predicted_by_rows

SPREAD = np.linspace(-0.07, 0.07, 9)
"""Places on the line looked for in each field, around the middle of the view [m]."""
SIGMA, SIGMA_FOUND = 0.006, 0.002
"""How far the line may be from its reference before and after it is first seen, standard deviations [m]."""
PER_SPEED = 1e-3
"""Uncertainty of a moving tool's place: a millisecond's way, standard deviation [m per m/s]."""


class CalibrationView:
    """What is known of arm and line while the camera moves, and what was seen.

    Args:
        robot: the arm.
        reference: the reference path.
        believed: the camera as mounted by hand.
        detection: how the line looks.
        detector: what finds its points.
        q: where the arm rests at first ``(n,)`` [rad].

    Attributes:
        history: where the tool was.
        observations: what was seen.
    """

    def __init__(self, robot: Robot, reference: ReferencePath, believed: CameraModel, detection: DetectionSettings,
                 detector: LineDetector, q: Array) -> None:
        self.reference, self.believed, self.detection, self.detector = reference, believed, detection, detector
        self.history = PoseHistory(robot)
        self.history.add(0.0, q)
        self.observations: list[Observation] = []
        self._aside, self._sigma = 0.0, SIGMA
        self._table = np.arange(0.0, reference.length, 0.005)
        self._places = reference.position(self._table)

    def predicted(self, t: float) -> PredictedLine:
        """The line around the middle of the view at ``t`` [s], as far aside of the reference as it was first seen."""
        pose = self.history.pose(t)
        look = pose.act(_middle_of_view(self.believed))
        s = self._table[np.argmin(np.sum((self._places - look) ** 2, axis=1))]
        frames = self.reference.frames(s + SPREAD)
        points = frames.position + self._aside * frames.normal
        there = PredictedLine.from_base(points, frames.tangent, frames.up.mean(axis=0), pose, self._sigma)
        return predicted_by_rows(there, self.believed, t, self.history.row_pose)

    def look(self, field: Field, prediction: PredictedLine, ahead: float) -> None:
        """Notes the line points of a field.

        Args:
            field: as it arrived.
            prediction: where the line should be in it.
            ahead: by how much the stamps run ahead of the arm's time [s].
        """
        found = self.detector.detect(field, self.believed, prediction, self.detection)
        if not found.seen:
            return
        if self._sigma > SIGMA_FOUND:
            self._aside, self._sigma = self._aside + float(np.mean(found.lateral[found.used])), SIGMA_FOUND
        t = field.t_stamp - ahead
        velocity, angular = self.history.velocity(t)
        sigma = np.hypot(found.sigma[found.used], PER_SPEED * np.linalg.norm(velocity))
        self.observations.append(
            Observation(self.history.pose(t), found.pixels[found.used], sigma, velocity, angular))


def _middle_of_view(camera: CameraModel) -> Array:
    """Where the optical axis meets the plane through the TCP, in the tool frame ``(3,)`` [m]."""
    T = camera.T_tool_camera
    axis = T.rotation[:, 2]
    return np.asarray(T.translation - T.translation[2] / axis[2] * axis)


def calibration_postures(robot: Robot, reference: ReferencePath, camera: CameraModel, at: float, clear: float = 0.0
                         ) -> list[Array]:
    """Joint angles of the poses that the arm reaches, each near the one before.

    Args:
        robot: the arm.
        reference: the reference path.
        camera: as mounted by hand.
        at: arc length of the reference around which the piece lies [m].
        clear: how far the tip keeps away from the reference at least [m].

    Raises:
        SceneError: fewer than half of the poses can be reached.
    """
    frames = reference.frames(np.array([at]))
    kinematics = InverseKinematics(robot)
    q = kinematics.search(reference.pose(at), robot.home)
    centre = frames.position[0] + clear * frames.up[0]
    wanted = calibration_poses(centre, frames.tangent[0], frames.up[0], float(_middle_of_view(camera)[0]))
    postures: list[Array] = []
    for pose in wanted:
        try:
            q = kinematics.search(pose, q)
        except OutOfReachError:
            continue
        postures.append(q)
    if len(postures) < len(wanted) // 2:
        raise SceneError(f"the camera could not be calibrated: the arm reaches only {len(postures)} of {len(wanted)} "
                         "poses; move the surface nearer, or set calibration.by_moving = false")
    return postures
