"""Filtering and synchronising of clamped recordings."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.elasticity.clamped_signals import clamped_signals, lowpass, synchronise
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


def test_lowpass_keeps_levels_and_removes_ripple() -> None:
    t = np.arange(0.0, 10.0, 0.002)
    level = 3.0 + 2.0 * (t > 5.0)
    smooth = lowpass(level + np.sin(2 * np.pi * 40 * t), 500.0)
    away = (t > 1) & (t < 4) | (t > 6) & (t < 9)
    np.testing.assert_allclose(smooth[away], level[away], atol=2e-3)


@pytest.mark.parametrize("offset", [-3.21, 0.0, 1.37, 8.4])
def test_clock_of_the_sensor_is_found(offset: float) -> None:
    rng = np.random.default_rng(1)
    drift = 2e-4
    t = np.arange(0.0, 60.0, 0.1)
    steps = np.repeat(rng.uniform(-1, 1, 30), 20)
    q_m = np.outer(np.convolve(steps, np.ones(5) / 5, mode="same"), [1e-3, -4e-4])
    true_time = np.arange(10.0, 50.0, 0.012)
    force = -2e6 * np.interp(true_time, t, q_m[:, 0]) + 3 * rng.standard_normal(len(true_time))
    clock = synchronise(t, q_m, (true_time - offset) / (1 + drift), force[:, None])
    at = clock.offset + (1 + clock.drift) * (true_time - offset) / (1 + drift)
    assert np.max(np.abs(at - true_time)) < 0.01


def test_what_cannot_be_used_is_said() -> None:
    robot = Robot.load("kr500")
    t = np.arange(0.0, 8.0, 0.002)
    q = np.zeros((len(t), 6))
    with pytest.raises(InputError, match="neither current_i"):
        clamped_signals(Recording.from_arrays(t, q=q), robot)
    with pytest.raises(InputError, match="5 joints"):
        clamped_signals(Recording.from_arrays(t, q=q[:, :5], tau=q[:, :5]), robot)
    with pytest.raises(InputError, match="at least 5 s"):
        clamped_signals(Recording.from_arrays(t[:500], q=q[:500], tau=q[:500]), robot)
    with pytest.raises(InputError, match="at least 5 s"):
        clamped_signals(Recording.from_arrays(t[:0], q=q[:0], tau=q[:0]), robot)
