"""A law over all effects: found at five times what can be seen, each is worth what its true number is worth.

The arm's only misfit is the effect; its number comes from a noisy recording of that arm. The law fails where the loop
ignores the effect: then as much of what the effect does to the path is left as before.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from docs.effects_table import change_of, with_table
from ideal_robot.arrays import held
from ideal_robot.diagnosis.channels.arm import arm_angle_regression, tool_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, SENSOR, TCP_POSITION, FittedEffect, library
from ideal_robot.effects.camera import CameraErrors
from ideal_robot.effects.force import ForceErrors
from ideal_robot.effects.kinematics import GeometryChange
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.loop.from_model import loop_model, with_effects
from ideal_robot.loop.loop import Loop
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording
from scenes.path.cell import Play
from sensing.force.force_calibration import ToolLoad
from tests.scenes.path import kind_arm as arm
from tests.scenes.path.effect_cases import CASES, friction_of
from tests.sources import ROOT

ACTING = [effect.key for effect in library() if not change_of(effect).nowhere and effect.domain != SENSOR]
BY_MOTION = ("backlash/qa", "backlash/tcp")
"""Play that is crossed where the motion turns: the simulated arm has no friction that would hold it there."""
QUICK = ("payload/tau",)
SMALLEST = 5e-7
"""What an effect does to the path below this is nothing [m]."""


def test_the_page_gets_a_table_with_every_effect() -> None:
    document = with_table((ROOT / "docs" / "effects.md").read_text(encoding="utf-8"))
    shown = [(name, channel) for name, channels in re.findall(r"`(\w+)` \(([\w, ]+)\)", document)
             for channel in channels.split(", ")]
    assert {(effect.name, effect.channel_prefix) for effect in library()} <= set(shown)


def test_every_effect_acts_or_says_why_not() -> None:
    for effect in library():
        change = change_of(effect)
        assert bool(change.places) != bool(change.nowhere), effect.key


def test_every_acting_effect_has_a_case() -> None:
    assert set(CASES) | set(BY_MOTION) == set(ACTING)


@pytest.mark.parametrize("key", [pytest.param(key, marks=() if key in QUICK else pytest.mark.slow) for key in CASES])
def test_extended_model_is_worth_the_true_number(key: str) -> None:
    case = CASES[key]()
    known = dataclasses.replace(arm.model(), friction=friction_of(case))
    fit = fitted(arm.recording(case.world, of=case.individual), known, case.true) if case.shown else case.true
    ignored, extended, true = (arm.played(case.world, model, of=case.individual) for model in (
        known, known.with_effects((fit,)), known.with_effects((case.true,))))
    assert extended.errors.aligned.E_car <= 1.25 * true.errors.aligned.E_car + SMALLEST
    # What the effect does to the path, beside what the exact model leaves of an arm without it.
    aim = arm.aim()
    before, after = apart(ignored, aim), apart(extended, aim)
    if before > SMALLEST:
        assert after < 0.6 * before


def apart(one: Play, other: Play) -> float:
    """Root mean square distance of two plays while the path is under way [m]."""
    span = arm.path().t[arm.path().counts]
    use = (one.t >= span[0]) & (one.t <= span[-1])
    return float(np.sqrt(np.mean(np.sum((one.tcp[use] - other.tcp[use]) ** 2, axis=1))))


def fitted(recording: Recording, known: Model, true: FittedEffect) -> FittedEffect:
    """The effect with the size that a recording says, the model's parameters held."""
    if true.domain == TCP_POSITION and not isinstance(true.effect, GeometryChange):
        # With arm angles gears would show there.
        columns = {name: values for name, values in recording.columns.items() if not name.startswith("qa_")}
        recording = dataclasses.replace(recording, columns=columns)
    torque = torque_regression(recording, arm.ROBOT, known, payload=True)
    about = recording, arm.ROBOT, torque, known.known_stiffness
    problem = {MOTOR_TORQUE: lambda: torque, ARM_POSITION: lambda: arm_angle_regression(*about),
               TCP_POSITION: lambda: tool_regression(*about)}[true.domain]()
    assert problem is not None
    shape = problem.filtered.decimate(true.effect.columns(problem.signals, true.joint, true.theta))
    shown = np.flatnonzero(np.any(np.abs(shape) > 1e-12, axis=(0, 1)))
    rows = shape[..., shown] if true.domain == MOTOR_TORQUE else np.concatenate([shape[..., shown], problem.W], axis=2)
    size = np.linalg.lstsq(rows[problem.use], problem.y[problem.use], rcond=1e-9)[0]
    coefficients = np.zeros(shape.shape[2])
    coefficients[shown] = size[: len(shown)]
    return dataclasses.replace(true, coefficients=tuple(float(value) for value in coefficients))


@pytest.mark.parametrize("key", BY_MOTION)
def test_play_crossed_with_the_motion_is_taken_up(key: str) -> None:
    """An arm whose brakes drag holds its joint where it is: the motor crosses the play at each reversal of motion."""
    gap = 2e-4
    bare = loop_model(arm.model(), arm.ROBOT, delay=0)
    path = arm.path().q_d
    dragged = -3000.0 * np.gradient(path[:, :1], arm.ROBOT.t_ipo, axis=0) * np.eye(6)[0]
    truth = bare.changed(half_gap=np.array([gap, 0.0, 0.0, 0.0, 0.0, 0.0]))
    name, prefix = key.split("/")
    known = with_effects(bare, (FittedEffect(name, 1, f"{prefix}_1", (1.0,), (), (gap,)),))

    def error(loop: Loop, plant: Loop) -> float:
        law = Inverse(loop)
        state, commands = law.init(path[0]), np.empty_like(path)
        ahead = held(path, after=law.n_d)
        torque = held(dragged, after=law.n_d)
        for k in range(len(path)):
            commands[k], state = law.step(state, ahead[k : k + law.n_d], torque[k : k + law.n_d])
        q_a = simulate(plant, commands, tau_ext=dragged).q_a[:-1]
        return float(np.sqrt(np.mean((q_a - path)[arm.path().counts, 0] ** 2)))

    without = error(bare, bare)
    assert error(bare, truth) > 1.5 * without
    assert error(known, truth) < 1.25 * without


def test_points_of_a_wrong_camera_are_put_right() -> None:
    """A pinhole at 0.25 m whose focal length, mounting and lens are not those that its readings are made with."""
    points = np.array([[x, y, 0.0] for x in (-0.04, 0.0, 0.05) for y in (-0.03, 0.02, 0.04)])
    height, focal, wrong = 0.25, 300.0, 300.0 * 1.02
    axis, yaw, shift, k1 = np.array([0.01, 0.0, 0.0]), 0.006, np.array([0.002, 0.0, 0.0]), 0.12
    # Seen by the true camera: turned and shifted on its mount, with a lens that bends outwards.
    ray = (points - axis - shift)[:, :2] / height
    ray = ray @ np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    pixels = wrong * ray * (1.0 + k1 * np.sum(ray**2, axis=1))[:, None]
    measured = np.column_stack([pixels / focal * height, np.zeros(len(points))]) + axis
    effects = (FittedEffect("camera_scale", 0, "line", (1.0 - focal / wrong,)),
               FittedEffect("lens_distortion", 0, "line", (k1 / height**2,)),
               FittedEffect("camera_offset", 0, "line", (-shift[0], -yaw, 0.0)))
    right = CameraErrors.of(effects).points(measured, axis)
    assert np.max(np.linalg.norm(measured - points, axis=1)) > 2e-3
    assert np.max(np.linalg.norm(right - points, axis=1)) < 0.1 * np.max(np.linalg.norm(measured - points, axis=1))


def test_time_stamps_of_a_drifting_clock_are_put_right() -> None:
    known = CameraErrors.of((FittedEffect("camera_latency", 0, "line", (-0.008,)),
                             FittedEffect("clock_drift", 0, "line", (0.001,))))
    stamps = np.array([0.0, 1.0, 10.0])
    exposed = stamps - 0.008 + 0.001 * stamps
    np.testing.assert_allclose([t + known.late_by(float(t)) for t in stamps], exposed, atol=1e-12)


def test_force_reading_and_contact_are_put_right() -> None:
    """[L] (3): a tip pressed 0.2 mm deep into what gives more than was assumed, read by a sensor with a bias."""
    assumed, true, bias, depth = 20000.0, 14000.0, np.array([2.0, -1.0, 0.5, 0.1, 0.0, 0.05]), 2e-4
    known = ForceErrors.of((FittedEffect("force_bias", 0, "force", tuple(bias)),
                            FittedEffect("force_compliance", 0, "force_contact", (1.0 / true - 1.0 / assumed,))))
    force = true * depth
    read = ToolLoad(known.wrench, 0.0, np.zeros(3), np.zeros(2)).contact(
        np.array([0.0, 0.0, force, 0.0, 0.0, 0.0]) + bias, np.eye(3))
    np.testing.assert_allclose(read, [0.0, 0.0, force, 0.0, 0.0, 0.0], atol=1e-12)
    # One step of the controller towards another force lands there.
    wanted = 6.0
    assert true * (depth + (wanted - force) / known.stiffness(assumed)) == pytest.approx(wanted)
