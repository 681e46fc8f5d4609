"""A camera's effect lists its errors: what moves points across the line and what a follower takes out are the same."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.effects import FittedEffect, library, register, unregister
from ideal_robot.effects.camera import CameraEffect, CameraErrors, PointError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from studies.sensors.line import AXIS, draw_line_trial, gantry


def stretched(out: Array) -> Array:
    """A lens that is wider in one direction than in the other."""
    return out * [0.0, 1.0, 0.0]


class Stretch(CameraEffect):
    """Pixels that are not square."""

    name = "camera_stretch"
    errors = (PointError("line_stretch", stretched),)
    coefficient_names = ("stretch",)
    coefficient_units = ("1",)


@pytest.fixture
def own() -> Iterator[Stretch]:
    effect = Stretch()
    register(effect)
    yield effect
    unregister(effect)


def test_an_own_effect_moves_the_seen_points_and_is_taken_out(own: Stretch, tmp_path: Path) -> None:
    """Its column is the finite difference of moved points; the follower moves them back."""
    file = tmp_path / "gantry.urdf"
    file.write_text(gantry(), encoding="utf-8")
    robot, recording = Robot.load(file), draw_line_trial(33, "none")[2]

    def seen(size: float) -> tuple[Array, Array]:
        columns = dict(recording.columns)
        for i in range(1, 6):
            columns[f"line_y_{i}"] = columns[f"line_y_{i}"] + size * (columns[f"line_y_{i}"] - AXIS[1])
        moved = Recording(columns, recording.meta)
        made = line_regression(moved, robot, torque_regression(moved, robot, Model.nominal(robot)), None)
        assert made is not None
        return made.y[:, 0], own.columns(made.signals, 0, ())[:, 0, 0]

    slope, column = (seen(2e-3)[0] - seen(-2e-3)[0]) / 4e-3, seen(0.0)[1]
    assert np.linalg.norm(slope - column) < 0.1 * np.linalg.norm(column)
    axis = np.array([0.01, 0.0, 0.0])
    points = np.array([[0.05, 0.02, 0.0], [-0.03, -0.04, 0.0]])
    right = CameraErrors.of((FittedEffect("camera_stretch", 0, "line", (0.1,)),)).points(points * [1.0, 1.1, 1.0], axis)
    np.testing.assert_allclose(right, points, atol=0.1 * 0.1 * 0.04)


def test_every_camera_effect_has_one_error_for_each_coefficient() -> None:
    effects = [effect for effect in library() if isinstance(effect, CameraEffect)]
    signals = [error.signal for effect in effects for error in effect.errors]
    assert len(set(signals)) == len(signals)
    for effect in effects:
        assert len(effect.errors) == len(effect.coefficient_names) == len(effect.coefficient_units)
        optional = [error.optional for error in effect.errors]
        assert optional == sorted(optional)
