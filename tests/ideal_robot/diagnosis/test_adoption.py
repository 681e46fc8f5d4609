"""What goes from a diagnosis into the model for another motion: a joint's effects and friction together, or not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.prior import TYPE
from ideal_robot.diagnosis.validation.refit import friction_anew
from ideal_robot.diagnosis.validation.result import FoundEffect
from ideal_robot.diagnosis.validation.transfer import accepted, adopted, log_reduction, with_joint
from ideal_robot.effects import FittedEffect
from ideal_robot.friction import PerJointFriction, ViscousCoulomb
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

STICKS = FittedEffect("stribeck", 2, "tau_2", (60.0,), theta=(0.05,))
"""What joint 2 truly has; its Coulomb friction is 40 N m less than an ordinary fit makes of it."""
HABIT = FittedEffect("stribeck", 3, "tau_3", (60.0,), theta=(0.05,))


def with_coulomb(robot: Robot, levels: list[float]) -> Model:
    laws = [ViscousCoulomb(np.array([[100.0], [level]])) for level in levels]
    return dataclasses.replace(Model.nominal(robot), friction=PerJointFriction(laws))


def recorded(model: Model) -> Recording:
    t = 0.004 * np.arange(2000.0)
    phase = np.outer(t, 0.7 + 0.2 * np.arange(model.n)) + np.arange(model.n)
    rate = 0.7 + 0.2 * np.arange(model.n)
    q, qd, qdd = 0.3 * np.sin(phase), 0.3 * rate * np.cos(phase), -0.3 * rate**2 * np.sin(phase)
    tau = model.inverse_dynamics(q, qd, qdd, t=t)
    tau = tau + np.random.default_rng(1).normal(0.0, 1.0, tau.shape)
    columns = {"t": t, **{f"q_{i + 1}": q[:, i].copy() for i in range(model.n)},
               **{f"tau_{i + 1}": tau[:, i].copy() for i in range(model.n)}}
    return Recording(columns, {"robot": model.robot_name})


@pytest.fixture(scope="module")
def case() -> tuple[Robot, Model, Diagnosis, Recording]:
    robot = Robot.load("kr15")
    known = with_coulomb(robot, [100.0] * robot.n)
    fitted = with_coulomb(robot, [100.0, 60.0, 60.0, 100.0, 100.0, 100.0]).with_effects((STICKS, HABIT))
    diagnosis = Diagnosis("effects", (), tuple(FoundEffect(e, 1.0, 0.5, 50.0) for e in (STICKS, HABIT)), (), "", 0.0,
                          model=fitted)
    truth = with_joint(known, fitted, 2, (STICKS,))
    return robot, known, diagnosis, recorded(truth)


def test_joint_is_taken_as_it_was_fitted_and_a_habit_of_the_other_motion_is_not(case):
    robot, known, diagnosis, run = case
    model = adopted(known, diagnosis, run, robot)
    assert model.effects == (STICKS,)
    assert [law.coefficients[1, 0] for law in model.friction.laws] == [100.0, 60.0, 100.0, 100.0, 100.0, 100.0]
    before, after = (m.predict(run).relative_error_percent for m in (known, model))
    assert after[1] < 0.7 * before[1]
    # Without effects a prediction is filtered at the kept instants alone, which is the same to 2e-5 of the torque.
    np.testing.assert_allclose(np.delete(after, 1), np.delete(before, 1), atol=2e-3)


def test_on_the_friction_of_before_the_same_effect_is_worth_less(case):
    """Why the two are one package."""
    robot, known, diagnosis, run = case
    alone = known.with_effects((STICKS,)).predict(run).relative_error_percent[1]
    assert alone > adopted(known, diagnosis, run, robot).predict(run).relative_error_percent[1]


def test_without_an_extended_model_nothing_changes(case):
    robot, known, diagnosis, run = case
    assert adopted(known, dataclasses.replace(diagnosis, effects=(), model=None), run, robot).effects == known.effects


def test_friction_of_another_arm_of_the_type_is_taken_where_another_recording_bears_it_out(case):
    robot, known, diagnosis, _ = case
    fitted = with_coulomb(robot, [100.0, 60.0, 60.0, 100.0, 100.0, 100.0])
    run = recorded(with_coulomb(robot, [100.0, 60.0, 100.0, 100.0, 100.0, 100.0]))
    model = adopted(known, dataclasses.replace(diagnosis, effects=(), model=fitted, taken_for=TYPE), run, robot)
    assert [law.coefficients[1, 0] for law in model.friction.laws] == [100.0, 60.0, 100.0, 100.0, 100.0, 100.0]


def test_friction_is_fitted_anew_beside_all_else_and_within_bounds(case):
    robot, known, _, _ = case
    run = recorded(with_coulomb(robot, [100.0, 60.0, 250.0, 100.0, 100.0, 100.0]))
    regression = torque_regression(run, robot, known)
    anew = friction_anew(regression, known, (1, 2, 3))
    assert list(anew) == [1, 2, 3]
    levels = np.array([[law.coefficients[1, 0] for law in anew[joint].friction.laws] for joint in anew])
    np.testing.assert_allclose(levels[0], 100.0, rtol=0.02)
    np.testing.assert_allclose(levels[1], [100.0, 60.0, 100.0, 100.0, 100.0, 100.0], rtol=0.02)
    # Two and a half times as much is more than friction does: the model keeps what it may.
    assert levels[2][2] <= 200.0
    assert friction_anew(regression, known, ()) == {}


# Which effects carry over: each that lowers the error of the other recording, and no other.

TRUE = {"a": 3.0, "b": 1.0, "habit": 0.0}
"""What is in the other recording of each effect; each claims twice, once and once of its own."""
CLAIMED = {"a": 2.0, "b": 1.0, "habit": 1.0}


def error(kept):
    squares = sum((TRUE[name] - CLAIMED[name] * (name in kept)) ** 2 for name in TRUE)
    return np.array([np.sqrt(squares + 0.1), 1.0])


def test_what_lowers_the_error_is_taken():
    assert accepted(["habit", "a", "b"], error, lambda name: 0) == ["a", "b"]


def test_an_effect_without_a_channel_is_judged_by_all():
    assert log_reduction(np.array([4.0, 1.0]), np.array([1.0, 1.0]), None) == pytest.approx(np.log(2.0))
    assert log_reduction(np.array([4.0, 1.0]), np.array([1.0, 1.0]), 1) == 0.0
