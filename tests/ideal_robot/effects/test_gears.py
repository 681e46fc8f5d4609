"""A gear in which an arm swings or falls from flank to flank: a pendulum behind a gear whose motor follows a path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import diagnose
from ideal_robot.effects import Signals, library
from ideal_robot.effects.backlash import crossed
from ideal_robot.effects.elasticity import swinging
from ideal_robot.signals.preprocess import lowpass
from studies.strangers.arm import robot_of
from studies.strangers.score import score
from studies.strangers.trial import draw_trial

INERTIA, WEIGHT, CUTOFF = 0.12, 3.0, 20.0
STIFFNESS, DAMPING = INERTIA * (2.0 * np.pi * 8.0) ** 2, 0.07
CONSTANT, HALF_GAP = 0.3, 2e-3


def through_gear(q: Array, dt: float, gear: Callable[[float, float], float], constant: float = 0.0) -> Array:
    """Torque through the gear ``(N,)`` [N m] along motor angles ``(N,)`` [rad].

    Args:
        q: of the motor.
        dt: between them [s].
        gear: torque of a twist [rad] and its rate [rad/s].
        constant: torque on the arm besides its weight [N m].
    """
    qd = np.gradient(q, dt)
    at, speed, torque = q[0], qd[0], np.empty(len(q))
    for i in range(len(q)):
        torque[i] = gear(q[i] - at, qd[i] - speed)
        speed += dt * (torque[i] - WEIGHT * np.sin(at) - constant) / INERTIA
        at += dt * speed
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

    def left(key: str, theta: tuple[float, ...]) -> tuple[float, float]:
        """Share of the squares that the best coefficient leaves, and that coefficient."""
        effect = next(e for e in library() if e.key == key)
        column = lowpass(effect.columns(signals, 1, theta)[:, 0, 0], signals.dt, 12.5)[away]
        size = missing[away] @ column / (column @ column)
        return float(np.sum((missing[away] - size * column) ** 2) / np.sum(missing[away] ** 2)), float(size)

    stiffness = STIFFNESS * np.linspace(0.6, 1.6, 41)
    found = [left("joint_elasticity/tau_resonance", (k,)) for k in stiffness]
    best = int(np.argmin([share for share, _ in found]))
    assert stiffness[best] == pytest.approx(STIFFNESS, rel=0.1)
    assert found[best][0] < 0.05
    assert found[best][1] == pytest.approx(1.0, abs=0.25)
    # Above the resonance the arm moves against its load: what a slow gear gives has the wrong sign there.
    assert left("joint_elasticity/tau", ())[0] > 0.5


def test_under_a_slow_load_the_gear_bends_as_the_load_asks():
    dt = 1e-3
    t = dt * np.arange(8000)
    load = 2.0 * np.sin(2.0 * np.pi * 0.2 * t)
    twist = swinging(load / INERTIA, np.full(len(t), INERTIA), dt, STIFFNESS)
    np.testing.assert_allclose(twist[2000:], load[2000:] / STIFFNESS, atol=0.03 * np.max(load) / STIFFNESS)


def test_starts_lie_within_one_search_of_any_stiffness_in_the_band():
    signals = signals_of(*(one[::40] if one.ndim == 1 else one for one in (swung()[0], swung()[1][::40, None])))
    effect = next(e for e in library() if e.key == "joint_elasticity/tau_resonance")
    reached = [effect.bounds_near(signals, 1, theta)[0] for theta in effect.starts(signals, 1)]
    low, high = effect.bounds(signals, 1)[0]
    for stiffness in np.geomspace(1.2 * low, high, 30):
        assert any(a <= stiffness <= b * (1.0 + 1e-9) for a, b in reached)


@pytest.mark.slow
def test_a_stranger_s_soft_gear_is_found_beside_a_delay():
    """It swings at 8 Hz; what a slow gear gives took 6 per cent of what is left, and it was missed."""
    trial = draw_trial(737265, size=(3.0, 10.0))
    with robot_of(trial.urdf) as robot:
        found = diagnose(trial.recording, robot)
    assert score(trial, found).right
    stiffness = next(e.fitted.parameters[0] for e in found.effects if e.fitted.name == "joint_elasticity")
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
    effect = next(e for e in library() if e.name == "backlash" and e.channel_prefix == prefix)
    thetas = [(HALF_GAP, 0.0)] if prefix == "tau_flight" else effect.starts(signals, 1)
    seen, away = lowpass(missing, signals.dt, 12.5), slice(500, -500)
    shares = []
    for theta in thetas:
        column = lowpass(effect.columns(signals, 1, theta)[:, 0, 0], signals.dt, 12.5)
        size = seen[away] @ column[away] / (column[away] @ column[away])
        if prefix == "tau_flight":
            assert size == pytest.approx(1.0, abs=0.15)
        shares.append(1.0 - np.sum((seen - size * column)[away] ** 2) / np.sum(seen[away] ** 2))
    assert least < max(shares) < most


def test_a_start_lies_near_the_gap():
    t, q, _ = between_stops(HALF_GAP)
    effect = next(e for e in library() if e.key == "backlash/tau_flight")
    gaps = {theta[0] for theta in effect.starts(signals_of(t[::20], q[::20, None], CONSTANT), 1)}
    assert min(abs(np.log(gap / HALF_GAP)) for gap in gaps) < np.log(2.0)


def test_a_joint_at_rest_is_not_asked_but_has_starts_for_another_motion():
    effect = next(e for e in library() if e.key == "backlash/tau_flight")
    still = signals_of(np.linspace(0.0, 1.0, 200), np.full((200, 1), 0.3), CONSTANT)
    assert not effect.usable(still, 1)
    assert effect.starts(still, 1)


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
        found = diagnose(trial.recording, robot)
    assert [(e.fitted.name, e.fitted.joint) for e in [*found.effects, *found.unknown]] == [("backlash", 2)]
