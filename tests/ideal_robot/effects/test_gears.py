"""Gears that have play and give, and causes in the whole arm's dynamics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.channels.motor_torque import in_own_units, torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.dynamics import torques
from ideal_robot.effects import FittedEffect, Signals, signals
from ideal_robot.effects.backlash import crossed
from ideal_robot.effects.elasticity import swinging
from ideal_robot.effects.registry import find
from ideal_robot.effects.signals import RigidDerivatives
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.recording import Recording
from studies.strangers.arm import robot_of
from studies.strangers.score import score
from studies.strangers.trial import draw_trial

INERTIA, WEIGHT, CUTOFF = 0.12, 3.0, 20.0
STIFFNESS, DAMPING = INERTIA * (2.0 * np.pi * 8.0) ** 2, 0.07
CONSTANT, HALF_GAP = 0.3, 2e-3
FLIGHT = find("backlash", "tau_flight")


def through_gear(q: Array, dt: float, gear: Callable[[float, float], float], constant: float = 0.0) -> Array:
    """Torque through the gear ``(N,)`` [N m] along motor angles [rad]; ``gear``: of a twist and its rate."""
    qd = np.gradient(q, dt)
    angle, speed, torque = q[0], qd[0], np.empty(len(q))
    for i in range(len(q)):
        torque[i] = gear(q[i] - angle, qd[i] - speed)
        speed += dt * (torque[i] - WEIGHT * np.sin(angle) - constant) / INERTIA
        angle += dt * speed
    return torque


def signals_of(t: Array, q: Array, constant: float = 0.0) -> Signals:
    """What a diagnosis knows of motor angles ``(N, 1)``: the arm with a rigid gear, the constant as the motor's."""
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)

    def rigid(a: Array, b: Array, c: Array) -> Array:
        return INERTIA * c + WEIGHT * np.sin(a)

    load, still = rigid(q, qd, qdd), np.zeros_like(q)
    return Signals(t, q, qd, qdd, load, load + constant, still, rigid=rigid, cutoff=CUTOFF)


def swung() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, motor angles and torque through the gear of a pendulum behind it, its motor on a given path."""
    dt, count = 1e-4, 150_000
    t = dt * np.arange(count)
    q = 0.25 * np.sin(2.1 * t) + 0.004 * np.sin(2.0 * np.pi * 4.7 * t) + 0.0005 * np.sin(2.0 * np.pi * 10.3 * t + 1.0)
    d = 2.0 * DAMPING * np.sqrt(STIFFNESS * INERTIA)
    return t, q, through_gear(q, dt, lambda twist, rate: STIFFNESS * twist + d * rate)


def test_the_torque_of_a_swinging_arm_is_that_of_an_oscillator_and_tells_its_stiffness():
    t, q, torque = swung()
    signals = signals_of(t[::40], q[::40, None])
    missing = lowpass(torque[::40] - signals.load[:, 0], signals.dt, 12.5)
    away = slice(500, -500)

    def left(prefix: str, theta: tuple[float, ...]) -> tuple[float, float]:
        """Share of the squares that the best coefficient leaves, and that coefficient."""
        column = lowpass(find("joint_elasticity", prefix).columns(signals, 1, theta)[:, 0, 0], signals.dt, 12.5)[away]
        size = missing[away] @ column / (column @ column)
        return float(np.sum((missing[away] - size * column) ** 2) / np.sum(missing[away] ** 2)), float(size)

    stiffness = STIFFNESS * np.linspace(0.6, 1.6, 41)
    fits = [left("tau_resonance", (k,)) for k in stiffness]
    best = int(np.argmin([share for share, _ in fits]))
    assert stiffness[best] == pytest.approx(STIFFNESS, rel=0.1)
    assert fits[best][0] < 0.05
    assert fits[best][1] == pytest.approx(1.0, abs=0.25)
    # Above the resonance the arm moves against its load: what a slow gear gives has the wrong sign there.
    assert left("tau", ())[0] > 0.5


def test_under_a_slow_load_the_gear_bends_as_the_load_asks():
    dt = 1e-3
    t = dt * np.arange(8000)
    load = 2.0 * np.sin(2.0 * np.pi * 0.2 * t)
    twist = swinging(load / INERTIA, np.full(len(t), INERTIA), dt, STIFFNESS)
    np.testing.assert_allclose(twist[2000:], load[2000:] / STIFFNESS, atol=0.03 * np.max(load) / STIFFNESS)


def test_starts_lie_within_one_search_of_any_stiffness_in_the_band():
    t, q, _ = swung()
    signals, effect = signals_of(t[::40], q[::40, None]), find("joint_elasticity", "tau_resonance")
    reached = [effect.bounds_near(signals, 1, theta)[0] for theta in effect.starts(signals, 1)]
    low, high = effect.bounds(signals, 1)[0]
    for stiffness in np.geomspace(1.2 * low, high, 30):
        assert any(a <= stiffness <= b * (1.0 + 1e-9) for a, b in reached)


@pytest.mark.slow
def test_a_stranger_s_soft_gear_is_found_beside_a_delay():
    """It swings at 8 Hz; what a slow gear gives took 6 per cent of what is left, and it was missed."""
    trial = draw_trial(737265, size=(3.0, 10.0))
    with robot_of(trial.urdf) as robot:
        diagnosis = diagnose(trial.recording, robot)
    assert score(trial, diagnosis).right
    stiffness = next(e.fitted.parameters[0] for e in diagnosis.effects if e.fitted.name == "joint_elasticity")
    assert stiffness.value == pytest.approx(trial.values["joint_elasticity", 5, "stiffness"], rel=0.1)


def between_stops(half_gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, motor angles and torque through the gear of a pendulum behind stops, its motor on a given path."""
    dt, count = 1e-4, 120_000
    t = dt * np.arange(count)
    q = 0.25 * np.sin(2.1 * t) + 0.12 * np.sin(5.3 * t + 1.0)
    k = (2.0 * np.pi * 40.0) ** 2 * INERTIA
    d = np.sqrt(k * INERTIA)

    def stops(twist: float, rate: float) -> float:
        beyond = np.sign(twist) * max(abs(twist) - half_gap, 0.0)
        return k * beyond + d * rate * (beyond != 0.0)

    return t, q, through_gear(q, dt, stops, CONSTANT)


@pytest.mark.parametrize(("prefix", "least", "most"), [("tau_flight", 0.9, 1.0), ("tau", 0.0, 0.5)])
def test_torque_of_a_gap_is_that_of_free_flight_and_impact(prefix, least, most):
    t, q, torque = between_stops(HALF_GAP)
    signals = signals_of(t[::20], q[::20, None], CONSTANT)
    missing = (torque - between_stops(0.0)[2])[::20]
    effect = find("backlash", prefix)
    thetas = [(HALF_GAP, 0.0)] if prefix == "tau_flight" else effect.starts(signals, 1)
    filtered, away = lowpass(missing, signals.dt, 12.5), slice(500, -500)
    shares = []
    for theta in thetas:
        column = lowpass(effect.columns(signals, 1, theta)[:, 0, 0], signals.dt, 12.5)
        size = filtered[away] @ column[away] / (column[away] @ column[away])
        if prefix == "tau_flight":
            assert size == pytest.approx(1.0, abs=0.15)
        shares.append(1.0 - np.sum((filtered - size * column)[away] ** 2) / np.sum(filtered[away] ** 2))
    assert least < max(shares) < most


def test_a_start_lies_near_the_gap():
    t, q, _ = between_stops(HALF_GAP)
    gaps = {theta[0] for theta in FLIGHT.starts(signals_of(t[::20], q[::20, None], CONSTANT), 1)}
    assert min(abs(np.log(gap / HALF_GAP)) for gap in gaps) < np.log(2.0)


def test_a_joint_at_rest_is_not_asked_but_has_starts_for_another_motion():
    still = signals_of(np.linspace(0.0, 1.0, 200), np.full((200, 1), 0.3), CONSTANT)
    assert not FLIGHT.usable(still, 1)
    assert FLIGHT.starts(still, 1)


def test_a_gap_takes_its_time_to_be_crossed():
    """Under a load that rises evenly the way in the gap is cubic in time."""
    dt, rate, half_gap = 1e-4, 50.0, 2e-3
    t = dt * np.arange(-2000, 4000)
    twist = crossed(rate * t, dt, half_gap)
    inside = np.flatnonzero(np.abs(twist) < half_gap)
    assert dt * len(inside) == pytest.approx((12.0 * half_gap / rate) ** (1.0 / 3.0), rel=0.01)


@pytest.mark.slow
def test_a_stranger_s_gap_is_found():
    trial = draw_trial(732001, size=(3.0, 10.0))
    with robot_of(trial.urdf) as robot:
        diagnosis = diagnose(trial.recording, robot)
    assert [(e.fitted.name, e.fitted.joint) for e in [*diagnosis.effects, *diagnosis.unknown]] == [("backlash", 2)]


# Causes in the whole arm's dynamics: what they add is what the changed arm does; laws of the torques' derivatives.

ROBOT = Robot.load("kr6")


@cache
def of_a_moved_arm() -> Regression:
    robot, t = ROBOT, np.arange(0.0, 6.0, 0.005)
    q = 0.4 * np.sin(np.outer(t, np.linspace(1.0, 2.0, robot.n)) + np.arange(robot.n))
    tau = np.zeros_like(q)
    tau[300, 2] = 1e6
    return torque_regression(Recording.from_arrays(t, q=q, tau=tau), robot, Model.nominal(robot), payload=True)


def torques_of(model: pin.Model, signals: Signals) -> Array:
    return torques(model, signals.q, signals.qd, signals.qdd)


def test_they_are_what_the_changed_arm_does():
    signals = of_a_moved_arm().signals
    before = torques_of(ROBOT.pinocchio, signals)

    tilted = ROBOT.pinocchio.copy()
    tilted.gravity.linear = tilted.gravity.linear + np.array([0.2, -0.1, 0.0])
    columns = find("base_tilt", "tau").columns(signals, 0, ())
    np.testing.assert_allclose(columns @ [0.2, -0.1, 0.0, 0.0], torques_of(tilted, signals) - before, atol=1e-6)

    angle = 1e-4
    ahead = signals.rigid(signals.q + angle * np.eye(6)[2], signals.qd, signals.qdd)
    column = find("zero_error", "tau").columns(signals, 3, ())[:, :, 0]
    np.testing.assert_allclose(angle * column, ahead - signals.load, atol=1e-4)

    loaded = ROBOT.pinocchio.copy()
    # Away from the axis, so that it has an inertia about it.
    body = pin.Inertia(2.0, np.array([0.1, -0.2, 0.15]), 0.01 * np.eye(3))
    loaded.inertias[3] = loaded.inertias[3] + body
    columns = find("link_load", "tau").columns(signals, 3, ())
    np.testing.assert_allclose(columns @ body.toDynamicParameters(), torques_of(loaded, signals) - before, atol=1e-6)


def test_a_base_leans_where_its_z_axis_does():
    base = pin.exp3(np.array([0.0, 0.05, 0.0]))
    leaning, angle = ROBOT.pinocchio.copy(), np.arctan2(*base[1::-1, 2])
    leaning.gravity.linear = base.T @ leaning.gravity.linear
    tilt, signals = find("base_tilt", "tau"), of_a_moved_arm().signals
    shown = torques_of(leaning, signals) - torques_of(ROBOT.pinocchio, signals)
    fit = np.linalg.lstsq(tilt.columns(signals, 0, ())[:, :, :2].reshape(-1, 2), shown.ravel(), rcond=None)[0]
    size, direction = tilt.parameters(np.append(fit, [0.0, 0.0]), np.full(4, 1e-3), (), ())
    assert size.value == pytest.approx(0.05, rel=0.02)
    assert direction.value == pytest.approx(angle, abs=0.05)


def test_a_leaning_base_shows_moments_of_an_upright_first_axis_that_the_urdf_has_wrong():
    signals, tilt = of_a_moved_arm().signals, find("base_tilt", "tau")
    true = ROBOT.pinocchio.copy()
    true.inertias[1] = true.inertias[1] + pin.Inertia(6.0, np.array([0.08, -0.05, 0.0]), np.zeros((3, 3)))
    upright = torques_of(true, signals)
    true.gravity.linear = true.gravity.linear + np.array([0.2, -0.1, 0.0])
    leaning = torques_of(true, signals) - upright
    columns = tilt.columns(signals, 0, ())
    fit = np.linalg.lstsq(columns.reshape(-1, 4), leaning.ravel(), rcond=None)[0]
    np.testing.assert_allclose(columns @ fit, leaning, atol=1e-6)
    np.testing.assert_allclose(fit[:2], [0.2, -0.1], atol=1e-6)
    assert tilt.plausible(fit, (), signals, 0)
    # As large as all of the arm's own they are no error of a URDF, nor do they turn anything where nothing leans.
    assert not tilt.plausible(fit * [1.0, 1.0, 1000.0, 1000.0], (), signals, 0)
    assert not tilt.plausible(fit * [0.0, 0.0, 1.0, 1.0], (), signals, 0)
    # The file of an earlier version has two coefficients.
    before = FittedEffect("base_tilt", 0, "tau", (0.2, -0.1)).contribution(signals)
    np.testing.assert_allclose(before, columns[:, :, :2] @ [0.2, -0.1])


@pytest.mark.parametrize("unit", ["N m", "A"])
def test_a_spring_balances_gravity_where_there_is_some_in_any_unit(unit):
    regression = of_a_moved_arm()
    if unit == "A":
        amperes = 0.1 * regression.filtered.decimate(regression.signals.torque)
        regression = in_own_units(replace(regression, measured=amperes))
    usable = [find("gravity_spring", "tau").usable(regression.signals, joint) for joint in (1, 2, 3)]
    assert usable == [False, True, True]


def test_a_single_sample_that_stands_out_costs_nothing():
    assert np.max(np.abs(of_a_moved_arm().measured[:, 2])) == 0.0


RNG = np.random.default_rng(5)
Q, QD, QDD = (RNG.uniform(-1.0, 1.0, (7, ROBOT.n)) for _ in range(3))
_rigid = partial(torques, ROBOT.pinocchio)


def test_they_are_those_that_pinocchio_has_in_closed_form() -> None:
    data = ROBOT.pinocchio.createData()
    known = [tuple(np.array(matrix) for matrix in pin.computeRNEADerivatives(ROBOT.pinocchio, data, *row))
             for row in zip(Q, QD, QDD, strict=True)]
    ours = RigidDerivatives(_rigid, Q, QD, QDD)
    for joint in range(1, ROBOT.n + 1):
        for k, derivative in enumerate(ours.by(joint)):
            expected = np.array([row[k][:, joint - 1] for row in known])
            if k == 2:  # of the mass matrix it gives the upper triangle
                M = np.array([np.triu(row[2]) + np.triu(row[2], 1).T for row in known])
                expected = M[:, :, joint - 1]
            np.testing.assert_allclose(derivative, expected, atol=1e-5 * np.max(np.abs(expected)))


def test_a_small_motion_changes_torques_by_them() -> None:
    step = 1e-5
    motion = [step * RNG.uniform(-1.0, 1.0, len(Q)) for _ in range(3)]
    moved = [values.copy() for values in (Q, QD, QDD)]
    for values, change in zip(moved, motion, strict=True):
        values[:, 1] += change
    change = RigidDerivatives(_rigid, Q, QD, QDD).along(2, *motion)
    np.testing.assert_allclose(change, _rigid(*moved) - _rigid(Q, QD, QDD), atol=1e-3 * np.max(np.abs(change)))


def test_what_memory_does_not_hold_is_computed_anew(monkeypatch) -> None:
    calls: list[int] = []

    def counted(q: Array, qd: Array, qdd: Array) -> Array:
        calls.append(1)
        return _rigid(q, qd, qdd)

    kept, dropped = RigidDerivatives(counted, Q, QD, QDD), RigidDerivatives(counted, Q, QD, QDD)
    first = [kept.by(joint) for joint in (1, 2)]
    count = len(calls)
    again = [kept.by(joint) for joint in (1, 2, 2)]
    assert len(calls) == count
    np.testing.assert_array_equal(again[:2], first)
    monkeypatch.setattr(signals, "_KEPT", 1.0)
    other = [dropped.by(joint) for joint in (1, 2, 2, 1)]
    # The mass matrix is kept.
    assert len(calls) == count + (count - 1 - ROBOT.n) // 2 * 3 + 1 + ROBOT.n
    np.testing.assert_array_equal(other, [first[0], first[1], first[1], first[0]])
