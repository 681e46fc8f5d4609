"""Columns of TCP and force effects are what finite differences of an altered geometry give.

A camera's effect lists its errors: what moves points across the line and what a follower takes out are the same.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm import frames_along
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.effects import FittedEffect, Signals, library, register, unregister
from ideal_robot.effects.camera import CameraEffect, CameraErrors, PointError
from ideal_robot.effects.force import CONTACT_FORCE, MOMENTS
from ideal_robot.effects.registry import find
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from studies.sensors.scene import AXIS, draw_line_trial, gantry
from tests.arms import written
from tests.ideal_robot.effects.test_laws import as_read

ROBOT = Robot.load("kr6")
TOOL = [e for e in library() if e.domain == "tcp_position" or e.name in ("force_bias", "force_compliance")]


def swinging_arm(count: int = 200) -> Signals:
    t = np.linspace(0.0, 4.0, count)
    n = ROBOT.n
    q = ROBOT.home + 0.4 * np.sin(np.outer(t, 1.0 + 0.3 * np.arange(n)) + np.arange(n))
    qd = np.gradient(q, t, axis=0)
    load = 20.0 * np.sin(q)
    still = np.zeros_like(q)
    extra = {MOMENTS: np.ones(count), CONTACT_FORCE: 20.0 + np.sin(t)}
    return Signals(t, q, qd, still, load, still, still, frames=frames_along(ROBOT, q), extra=extra)


def tcp(model: pin.Model, q: np.ndarray) -> np.ndarray:
    return dataclasses.replace(ROBOT, pinocchio=model).tool_places(q)


@pytest.mark.parametrize("name", ["joint_elasticity", "backlash", "transmission_error"])
def test_gears_move_the_tool_as_their_angle_does(name):
    signals, joint, h = swinging_arm(), 2, 1e-6
    effect, angle = find(name, "tcp"), find(name, "qa")
    theta = effect.starts(signals, joint)[0]
    columns, bend = effect.columns(signals, joint, theta), angle.columns(signals, joint, theta)
    for i in range(columns.shape[2]):
        sides = [tcp(ROBOT.pinocchio, signals.q + sign * h * bend[:, :, i]) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(columns[:, :, i], (sides[0] - sides[1]) / (2 * h), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("joint", [2, 3, 4, 5])
def test_kinematic_errors_are_those_of_altered_placements(joint):
    signals, h = swinging_arm(60), 1e-6
    columns = find("kinematic_error", "tcp").columns(signals, joint, ())
    data = ROBOT.pinocchio.createData()
    pin.forwardKinematics(ROBOT.pinocchio, data, signals.q[0])
    R = data.oMi[joint].rotation
    z, x = R.T @ signals.frames.axis[0, joint - 1], R.T @ signals.frames.normal[0, joint - 1]
    nothing = np.zeros(3)
    for i, (shift, turn) in enumerate(((x, nothing), (z, nothing), (nothing, x), (nothing, z))):
        sides = []
        for sign in (1.0, -1.0):
            model = ROBOT.pinocchio.copy()
            error = pin.SE3(pin.exp3(sign * h * turn), sign * h * shift)
            model.jointPlacements[joint + 1] = error * model.jointPlacements[joint + 1]
            sides.append(tcp(model, signals.q))
        np.testing.assert_allclose(columns[:, :, i], (sides[0] - sides[1]) / (2 * h), rtol=1e-5, atol=1e-8)


def test_a_link_grows_along_itself():
    signals, joint, h = swinging_arm(60), 3, 1e-5
    effect = find("thermal_growth", "tcp")
    warm = 1.0 - np.exp(-signals.t / 2.0)
    sides = []
    for sign in (1.0, -1.0):
        places = []
        for k, q in enumerate(signals.q):
            model = ROBOT.pinocchio.copy()
            model.jointPlacements[joint + 1].translation *= 1.0 + sign * h * warm[k]
            places.append(tcp(model, q[None])[0])
        sides.append(np.array(places))
    np.testing.assert_allclose(effect.columns(signals, joint, (2.0,))[:, :, 0], (sides[0] - sides[1]) / (2 * h),
                               rtol=1e-5, atol=1e-8)


def test_the_common_normal_is_square_to_both_axes():
    frames = swinging_arm(20).frames
    for j in range(ROBOT.n - 1):
        parallel = np.linalg.norm(np.cross(frames.axis[0, j], frames.axis[0, j + 1])) < 1e-6
        for axis in (j,) if parallel else (j, j + 1):
            dots = np.einsum("kj,kj->k", frames.normal[:, j], frames.axis[:, axis])
            np.testing.assert_allclose(dots, 0.0, atol=1e-9)


@pytest.mark.parametrize("effect", TOOL, ids=lambda e: f"{e.name}-{e.channel(1)}")
def test_effects_survive_their_file_and_leave_torques_alone(effect):
    signals, bare = swinging_arm(60), Model.nominal(ROBOT)
    with_it = dataclasses.replace(bare, effects=(as_read(effect, signals),))
    motion_of = signals.q, signals.qd, signals.qdd
    np.testing.assert_array_equal(with_it.inverse_dynamics(*motion_of), bare.inverse_dynamics(*motion_of))


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
    robot, recording = Robot.load(written(tmp_path, gantry())), draw_line_trial(33, "none")[2]

    def seen(size: float) -> tuple[Array, Array]:
        columns = dict(recording.columns)
        for i in range(1, 6):
            columns[f"line_y_{i}"] = columns[f"line_y_{i}"] + size * (columns[f"line_y_{i}"] - AXIS[1])
        moved = Recording(columns, recording.meta)
        regression = line_regression(moved, robot, torque_regression(moved, robot, Model.nominal(robot)), None)
        assert regression is not None
        return regression.y[:, 0], own.columns(regression.signals, 0, ())[:, 0, 0]

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
