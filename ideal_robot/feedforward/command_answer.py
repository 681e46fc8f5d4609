"""How the commands of a feedforward answer a small change of the desired path: what they ask of the drives for it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.command.response import WIDTH, pulse_answers
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.robots.robot import Robot

_MOVES = 0.1
"""Speed of the joints meanwhile, over their largest."""
_RESOLVED = 0.02
"""Share of the pulse's largest part from which on a frequency is in the answer; paths are smoother than that."""
_SLIGHT = 1e-2
"""Weights below this share of a joint's largest are none."""


class CommandAnswer(NamedTuple):
    r"""Weights with which changes of the desired path appear in the commands.

    .. math:: \delta q_c(k) = \sum_l w_l \; \delta q_d(k - before + l)

    Of a command that is the path they are 1 at once; behind a lag :math:`\tau` they are those of
    :math:`\delta q_d + \tau \, \delta \dot q_d`, so that a command's acceleration is the path's and :math:`\tau` times
    its jerk; a delay moves them ahead and asks for no more. Each joint's answer is that to its own change.

    Attributes:
        weights: ``(L, n)``.
        before: rows of them that belong to cycles before the command's.
    """

    weights: Array
    before: int

    @property
    def after(self) -> int:
        """Number of rows of the weights that belong to cycles after the command's."""
        return len(self.weights) - 1 - self.before

    @classmethod
    def of(cls, feedforward: Feedforward, robot: Robot, q: Array) -> CommandAnswer:
        """The answer of each joint while all move, by the commands themselves.

        Args:
            feedforward: whatever makes commands; small changes of a motion are answered linearly.
            robot: cycle and speeds of the arm; a joint without a limit moves as if it were 1 rad/s (or m/s).
            q: posture about which it moves ``(n,)`` [rad].
        """
        reach = feedforward.n_d + round(4.0 * WIDTH)
        speed = _MOVES * np.where(np.isfinite(robot.v_max), robot.v_max, 1.0)
        pulse, answers = pulse_answers(feedforward.along, q, speed, robot.t_ipo, np.arange(2.0 * reach + 1) - reach)
        # Both begin and end with nothing, so the pulse is taken out of its answer by frequencies.
        own, count = np.fft.rfft(pulse, 4 * reach), 4 * reach
        freed = np.conj(own) / (np.abs(own) ** 2 + (_RESOLVED * np.abs(own).max()) ** 2)
        weights = np.fft.irfft(freed[:, None] * np.fft.rfft(answers, count, axis=0), count, axis=0)
        # A command before the pulse is answered to what comes behind it.
        weights = np.roll(weights, reach, axis=0)[2 * reach :: -1]
        used = np.flatnonzero((np.abs(weights) > _SLIGHT * np.abs(weights).max(axis=0)).any(axis=1))
        first, last = min(int(used[0]), reach), max(int(used[-1]), reach)
        return cls(weights[first : last + 1], reach - first)

    def to(self, rows: Array) -> Array:
        """What changes ``(N, n)`` make of the commands of the ``N - L + 1`` cycles whose weights they cover."""
        return np.column_stack([np.convolve(row, weights, mode="valid")
                                for row, weights in zip(rows.T, self.weights[::-1].T, strict=True)])
