"""Calibration over wires: the camera is found from the piece of the line, whatever is seen on the way there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.camera_table import believed_camera
from scenes.drawn_line import reference_points
from scenes.follow.journal import Journal
from scenes.follow.line_calibration import Piece, calibrated_by_moving
from scenes.follow.live_arm import LiveArm
from scenes.follow.live_camera import EvaluatedField
from scenes.follow.scene_of_cell import load_cell
from scenes.line.known import line_follower, span_of
from scenes.model_files import shipped_model
from sensing.camera.camera_model import CalibrationError, CameraModel
from sensing.camera.hand_eye import HandEye, calibrate
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine
from tests.scenes.follow.parts import Tame
from tests.sensing.camera.test_hand_eye import measuring_error

LATE, EVERY = 0.04, 2
ERROR = CalibrationError(roll=0.0035, pitch=0.0035, yaw=0.0035, height=0.001, lateral=0.0005, focal=0.003,
                         principal_point=1.0, distortion=0.01)


class SeeingCamera:
    """Sees the line exactly where it is; where ``astray`` says so, something 5 mm beside it, now left, now right."""

    def __init__(self, true: CameraModel, arm: LiveArm, astray: Callable[[float], bool]) -> None:
        self.true, self.arm, self.astray, self.detection = true, arm, astray, DetectionSettings()
        self.predict: Callable[[float], PredictedLine] | None = None
        self.hand_eye: HandEye | None = None
        self.looked = 0

    def arrived(self, t: float) -> list[EvaluatedField]:
        self.looked += 1
        if self.predict is None or t < LATE or self.looked % EVERY:
            return []
        points = self.predict(t - LATE).points.copy()
        if self.astray(t - LATE):
            points[:, 1] += 0.005 * np.sign(np.sin(20.0 * t))
        pixels = self.true.project_tool(points)
        count = len(points)
        seen = LineField(t - LATE, points, pixels, np.zeros(count), np.full(count, 2e-5), np.ones(count),
                         np.ones(count, dtype=bool), True, "")
        return [EvaluatedField(t - LATE, t, (), (), seen)]

    def calibrate(self, camera, observations, near, normal) -> None:
        self.hand_eye = calibrate(camera, observations, near, normal)


@pytest.mark.parametrize("misled", [False, True])
def test_what_is_seen_on_the_way_to_the_piece_does_not_spoil_the_calibration(misled: bool, tmp_path: Path) -> None:
    scene, robot = load_cell("line"), Robot.load("kr6")
    by_hand = believed_camera(scene.camera)
    true = by_hand.perturbed(**ERROR.signed(np.random.default_rng(1)))
    reference, follower = line_follower(scene, robot, reference_points(scene), by_hand)
    arm = LiveArm(Tame(robot), Journal(tmp_path, robot, {"scene": "line"}))
    middle = 0.5 * sum(span_of(scene, reference))
    centre = reference.position(np.array([middle]))[0]
    pose = robot.fk()

    def away(_: float) -> bool:
        return misled and bool(np.linalg.norm(pose(arm.link.commanded).translation - centre) > 0.25)

    camera = SeeingCamera(true, arm, away)
    found = calibrated_by_moving(Piece(reference, middle, follower.q_start), by_hand,
                                 Model.load(shipped_model(robot.name)), arm, camera)  # type: ignore[arg-type]
    assert np.abs(measuring_error(true, by_hand)).mean() > 1e-4
    assert np.abs(measuring_error(true, found.camera)).max() < 1e-5
    assert found.residual_after < 1e-5
