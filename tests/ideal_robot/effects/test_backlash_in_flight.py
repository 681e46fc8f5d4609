"""Play in a gear whose crossing takes a tenth of a second, against a motor and an arm between two stops."""

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.effects import library
from ideal_robot.effects.backlash import crossed
from ideal_robot.signals.preprocess import lowpass
from tests.ideal_robot.effects.pendulum import INERTIA, signals_of, through_gear
from trials.report import arm_of
from trials.strangers.trial import draw_trial

CONSTANT, HALF_GAP = 0.3, 2e-3


def driven(half_gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    t, q, torque = driven(HALF_GAP)
    signals = signals_of(t[::20], q[::20, None], CONSTANT)
    missing = (torque - driven(0.0)[2])[::20]
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
    t, q, _ = driven(HALF_GAP)
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
    with arm_of(trial.urdf) as robot:
        found = diagnose(trial.recording, robot)
    assert [(e.fitted.name, e.fitted.joint) for e in [*found.effects, *found.unknown]] == [("backlash", 2)]
