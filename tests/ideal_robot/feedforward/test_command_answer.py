"""What a feedforward's commands are answered to a change of the path: recovered from commands of a known law."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward, PassThrough
from ideal_robot.feedforward.command_answer import CommandAnswer
from ideal_robot.feedforward.inverse import Inverse
from tests.arms import ROBOT, T, plant


class Lag(Feedforward):
    """Commands behind which an arm lags by ``tau`` [s] and is ``late`` cycles late."""

    n_d, t_ipo = 12, T

    def __init__(self, tau: float, late: int = 0) -> None:
        self.tau, self.late = tau, late

    def init(self, q0: Array) -> None:
        return None

    def step(self, state: None, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, None]:
        return q_d[self.late] + self.tau * (q_d[self.late + 1] - q_d[self.late]) / T, None


def smooth(rows: int, n: int, seed: int = 1) -> Array:
    """Deviations of frequencies up to 15 Hz ``(N, n)``."""
    rng, t = np.random.default_rng(seed), T * np.arange(rows)
    f, phase = rng.uniform(1.0, 15.0, (8, n)), rng.uniform(0.0, 2.0 * np.pi, (8, n))
    return np.asarray(1e-4 * np.sin(2.0 * np.pi * f[:, None] * t[:, None] + phase[:, None]).sum(axis=0))


@pytest.mark.parametrize(("tau", "late"), [(0.0, 0), (0.0, 3), (0.03, 0), (0.1, 2), (0.3, 1)])
def test_the_answer_of_a_lag_and_a_delay_is_what_is_commanded(tau: float, late: int) -> None:
    law = Lag(tau, late)
    answer = CommandAnswer.of(law, ROBOT, ROBOT.home)
    moved = smooth(200, ROBOT.n)
    wanted = law.along(moved)[answer.before : len(moved) - answer.after]
    assert np.std(answer.to(moved) - wanted) < 0.03 * np.std(wanted)
    np.testing.assert_allclose(answer.weights.sum(axis=0), 1.0, atol=0.02)


def test_of_what_is_commanded_as_it_is_nothing_more_is_asked() -> None:
    answer = CommandAnswer.of(PassThrough(T), ROBOT, ROBOT.home)
    moved = smooth(100, ROBOT.n)
    np.testing.assert_allclose(answer.to(moved), moved[answer.before : len(moved) - answer.after],
                               atol=0.05 * np.std(moved))


def test_the_answer_of_a_cascade_with_friction_and_gears_is_that_of_its_own_commands() -> None:
    inverse = Inverse(plant(), 25)
    answer = CommandAnswer.of(inverse, ROBOT, ROBOT.home)
    line = ROBOT.home + np.arange(100.0)[:, None] * 0.1 * ROBOT.v_max * T
    # Masses and friction are others along the way: the answer is that in the middle.
    for j in (0, 2, 5):
        aside = 0.1 * smooth(100, ROBOT.n) * np.eye(ROBOT.n)[j]
        wanted = (inverse.along(line + aside) - inverse.along(line))[answer.before : 100 - answer.after, j][30:-30]
        assert np.std(answer.to(aside)[30:-30, j] - wanted) < 0.15 * np.std(wanted)
