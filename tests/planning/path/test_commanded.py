"""The way to a line that has just been seen: what its commands, behind a loop that lags, ask of the joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward, PassThrough
from planning.path.desired_path import DesiredPath
from tests.planning.cell import T, kr6, profile, reference

N_D = 25
LIMIT = 6.0
"""Of each joint [rad/s²]."""


class Lag(Feedforward):
    """Commands behind which an arm lags by ``tau`` [s]."""

    n_d, t_ipo = 2, T

    def __init__(self, tau: float) -> None:
        self.tau = tau

    def init(self, q0: Array) -> None:
        return None

    def step(self, state: None, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, None]:
        return q_d[0] + self.tau * (q_d[1] - q_d[0]) / T, None


def commands(tau: float, aside: float, led_by: Feedforward | None) -> Array:
    """Commands ``(N, 6)`` [rad] along the reference, the line being seen ``aside`` [m] of it after 0.5 s."""
    robot = replace(kr6(), a_max=np.full(6, LIMIT))
    path = DesiredPath(robot, reference(), profile(0.4), N_D)
    if led_by is not None:
        path.led_by(led_by)
    law, sent = Lag(tau), []
    for k in range(round(1.6 / T)):
        seen = aside * (k * T >= 0.5)
        q_d = path.horizon(k * T, lambda s, seen=seen: np.full((len(s), 1), seen), k % 2 == 0)
        sent.append(law.step(None, q_d)[0])
    return np.array(sent)


def hardest(tau: float, aside: float, led_by: Feedforward | None) -> float:
    """Largest acceleration of a joint's command that the correction takes [rad/s²]."""
    more = commands(tau, aside, led_by) - commands(tau, 0.0, led_by)
    return float(np.abs(np.diff(more, 2, axis=0)).max() / T**2)


@pytest.mark.parametrize("tau", [0.03, 0.1, 0.2])
@pytest.mark.parametrize("aside", [0.003, 0.01])
def test_commands_behind_a_lag_keep_the_acceleration_of_the_joints(tau: float, aside: float) -> None:
    assert hardest(tau, aside, Lag(tau)) < 1.05 * LIMIT


def test_the_same_plan_without_the_lag_would_ask_for_more() -> None:
    assert hardest(0.1, 0.01, None) > 1.5 * LIMIT
    assert hardest(0.1, 0.01, PassThrough(T)) > 1.5 * LIMIT


def test_a_line_is_come_to_all_the_same() -> None:
    there = commands(0.0, 0.01, Lag(0.1))
    wanted = commands(0.0, 0.01, None)
    np.testing.assert_allclose(there[-1], wanted[-1], atol=1e-4)
    # Nothing is given away where commands are the path.
    np.testing.assert_allclose(commands(0.0, 0.003, PassThrough(T)), commands(0.0, 0.003, None), atol=1e-9)
