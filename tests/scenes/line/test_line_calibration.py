"""The camera calibrated by moving the simulated arm over the line, with everything on that disturbs it."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.elasticity.deflection import GearDeflection
from scenes import load_scene
from scenes.line.calibration import calibrate_by_moving
from scenes.line.cell import Cell, set_up
from scenes.line.scene import LineScene
from scenes.models import model_for
from scenes.scene_error import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import EdgePairs
from sensing.camera.hand_eye import HandEye
from sensing.camera.line_detection import DetectionSettings
from sim.arm.arm import SimulatedArm
from sim.camera.camera import CameraSettings, RenderedCamera


def cell_of(**changes: object) -> Cell:
    scene = load_scene("line").changed(world="bench").changed(**changes)
    assert isinstance(scene, LineScene)
    return set_up(scene)


def calibrated(cell: Cell, deflection: GearDeflection | None = None) -> HandEye:
    middle = 0.5 * cell.reference.length
    with (SimulatedArm(cell.robot, cell.world, cell.noise, cell.follower.q_start) as arm,
          RenderedCamera(cell.true_camera, cell.line, CameraSettings(resolution=0.0005), cell.camera_noise) as camera):
        return calibrate_by_moving(cell.robot, cell.reference, cell.camera, arm, camera, deflection, middle,
                                   DetectionSettings(), EdgePairs())


def measuring_error(cell: Cell, believed: CameraModel) -> Array:
    """Lateral error [m] of points 20 to 110 mm ahead of the TCP and 20 mm aside."""
    x, y = np.meshgrid(np.linspace(0.02, 0.11, 5), np.linspace(-0.02, 0.02, 5))
    points = np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()])
    back = believed.on_plane(cell.true_camera.project_tool(points), np.array([0.0, 0.0, 1.0]), 0.0)
    return np.asarray((back - points)[:, 1])


def test_a_camera_mounted_by_hand_measures_to_thirty_micrometres_afterwards() -> None:
    cell = cell_of(seed=3)
    deflection = GearDeflection(model_for(cell.scene, cell.robot), cell.world.t_ipo)
    result = calibrated(cell, deflection)
    assert np.abs(measuring_error(cell, cell.camera)).mean() > 0.5e-3
    assert np.abs(measuring_error(cell, result.camera)).mean() < 3e-5
    assert result.residual_after < 1e-4 < result.residual_before


def test_a_line_that_is_not_there_is_no_calibration() -> None:
    cell = cell_of(line={"gray": 195.0})
    with pytest.raises(SceneError, match="0 of"):
        calibrated(cell)


def test_too_few_poses_in_reach() -> None:
    with pytest.raises(SceneError, match="reaches only"):
        calibrated(cell_of(camera={"mount_ahead": 0.9}))
