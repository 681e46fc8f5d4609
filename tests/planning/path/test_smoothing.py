"""Smoothing: continuous, without delay, gentle where it has to be."""

from __future__ import annotations

import numpy as np
import pytest

from planning.path.smoothing import Smoother
from tests.planning.cell import T

N = 40


def chain(smoother: Smoother, estimate: np.ndarray, every: int = 2, start: float = 0.0) -> np.ndarray:
    """Plans again and again from the state reached; positions, velocities, accelerations executed ``(K, 3)``."""
    state = np.array([[start], [0.0], [0.0]])
    out = []
    for k in range(0, len(estimate) - N - 1, every):
        plan = smoother.plan(state, estimate[k + 1 : k + 1 + N, None])
        out += [plan[:, i, 0] for i in range(every)]
        state = plan[:, every - 1]
    return np.array(out)


def test_constant_velocity_passes_unchanged() -> None:
    ramp = 0.003 + 0.02 * T * np.arange(200)
    smoother = Smoother(N, T)
    state = np.array([[ramp[0]], [0.02], [0.0]])
    plan = smoother.plan(state, ramp[1 : N + 1, None])
    np.testing.assert_allclose(plan[0, :, 0], ramp[1 : N + 1], atol=1e-12)
    np.testing.assert_allclose(plan[1, :, 0], 0.02, atol=1e-9)


@pytest.mark.parametrize("frequency", [1.0, 3.0, 5.0])
def test_waves_below_the_cutoff_pass_without_delay(frequency: float) -> None:
    t = T * np.arange(400)
    wave = 1e-3 * np.sin(2 * np.pi * frequency * t)
    executed = chain(Smoother(N, T, cutoff=12.0, acceleration=100.0), wave)[:, 0]
    settled = slice(80, 300)
    reference = wave[1 : len(executed) + 1]
    gain = float(executed[settled] @ reference[settled] / (reference[settled] @ reference[settled]))
    assert gain == pytest.approx(1.0 / (1.0 + (frequency / 12.0) ** 6), abs=0.01)
    assert np.max(np.abs(executed - reference)[settled]) < 0.02e-3


def test_position_velocity_and_acceleration_are_continuous_although_the_estimate_jumps() -> None:
    rng = np.random.default_rng(1)
    smoother = Smoother(N, T)
    state = np.zeros((3, 1))
    executed = []
    for k in range(100):
        # Each field moves the whole estimate a little.
        estimate = 2e-3 * np.sin(0.05 * (k + 1 + np.arange(N))) + 1e-4 * rng.normal()
        plan = smoother.plan(state, estimate[:, None])
        state = plan[:, 0]
        executed.append(state[:, 0])
    x, v, a = np.array(executed).T
    # The motion over a cycle follows from the state before it and a constant jerk.
    jerk = np.diff(a) / T
    np.testing.assert_allclose(x[1:], x[:-1] + T * v[:-1] + 0.5 * T**2 * a[:-1] + T**3 / 6 * jerk, atol=1e-12)
    np.testing.assert_allclose(v[1:], v[:-1] + T * a[:-1] + 0.5 * T**2 * jerk, atol=1e-10)


@pytest.mark.parametrize("step", [1e-3, 1e-2, 3e-2])
def test_jump_of_the_estimate_is_worked_off_within_the_acceleration(step: float) -> None:
    executed = chain(Smoother(N, T, acceleration=4.0), np.full(200, step))
    assert np.max(np.abs(executed[:, 2])) <= 4.0 + 1e-9
    # As fast as that acceleration allows, give and take a factor: rest to rest takes 2.4 √(step/a).
    arrived = np.flatnonzero(np.abs(executed[:, 0] - step) > 0.05 * step)[-1] * T
    assert arrived < 4.0 * 2.4 * np.sqrt(step / 4.0) + 0.1
    assert executed[-1, 0] == pytest.approx(step, rel=1e-3)


def test_directions_do_not_mix() -> None:
    smoother = Smoother(N, T)
    rng = np.random.default_rng(2)
    state, estimate = 1e-4 * rng.normal(size=(3, 2)), 1e-4 * rng.normal(size=(N, 2)).cumsum(axis=0)
    both = smoother.plan(state, estimate)
    alone = Smoother(N, T, acceleration=np.inf)
    np.testing.assert_allclose(alone.plan(state, estimate)[:, :, 1], alone.plan(state[:, 1:], estimate[:, 1:])[:, :, 0])
    assert both.shape == (3, N, 2)
