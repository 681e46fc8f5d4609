"""A path is slowed along itself just where it or its commands leave a limit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from ideal_robot.arrays import Array
from ideal_robot.errors import LimitError
from ideal_robot.execution.command_limits import check_limits
from ideal_robot.execution.slowed import slowed
from ideal_robot.robots.robot import Robot

ARM = dataclasses.replace(Robot.load("kr6"), t_ipo=0.012)


def path(seed: int, quick: float) -> Array:
    """A path ``(N, 6)`` [rad] from rest to rest, with a quick movement in its middle."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 1.0, 700)
    slow, burst = (np.clip((t - a) / width, 0.0, 1.0) for a, width in ((0.1, 0.8), (0.5, 0.02 * quick)))
    ease = [s**3 * (10.0 - 15.0 * s + 6.0 * s**2) for s in (slow, burst)]
    way = rng.uniform(-0.3, 0.3, (2, 6))
    return np.asarray(ARM.home + ease[0][:, None] * way[0] + ease[1][:, None] * way[1])


def leading(q: Array) -> Array:
    """Commands that lead by 50 ms of speed, as behind a position loop of 20 1/s."""
    return np.asarray(q + 0.05 * np.gradient(q, ARM.t_ipo, axis=0))


@pytest.mark.parametrize("everywhere", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_a_path_that_is_too_quick_is_slowed_and_stays_itself(seed: int, everywhere: bool) -> None:
    q_d = path(seed, 1.0)
    with pytest.raises(LimitError):
        check_limits(leading(q_d), ARM, ARM.t_ipo)
    result = slowed(q_d, leading, ARM, everywhere=everywhere)
    for q in (result.q_d, result.q_c):
        check_limits(q, ARM, ARM.t_ipo)
    assert result.q_c == pytest.approx(leading(result.q_d))
    assert np.all(np.diff(result.row) > 0.0)
    assert result.row[[0, -1]] == pytest.approx([0.0, len(q_d) - 1.0])
    assert result.q_d == pytest.approx(np.asarray(make_interp_spline(np.arange(float(len(q_d))), q_d, k=5)(result.row)))
    assert 0.05 < result.slowest < 1.0
    far = np.abs(result.row[:-1] - 357.0) > 120.0
    pace = np.diff(result.row)[far[: len(result.row) - 1]][:-1]
    assert (pace < 0.999).all() if everywhere else (pace > 0.999).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_path_within_the_limits_is_left_as_it_is(seed: int) -> None:
    q_d = path(seed, 20.0)
    result = slowed(q_d, leading, ARM)
    assert result.q_d == pytest.approx(q_d, abs=1e-12)
    assert result.slowest == 1.0


def test_what_no_speed_mends_is_refused() -> None:
    q_d = path(1, 1.0)
    with pytest.raises(LimitError):
        slowed(q_d, lambda q: q + 10.0, ARM)
