"""The response of a feedforward's commands to a small change of the desired path."""

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
    r"""Weights of changes of the desired path in the commands.

    .. math:: \delta q_c(k) = \sum_l w_l \; \delta q_d(k - before + l)

    For a command equal to the path the weight is 1 at l = 0; behind a lag :math:`\tau` they are those of :math:`\delta
    q_d + \tau \, \delta \dot q_d`, so that a command's acceleration is the path's and :math:`\tau` times its jerk; a
    delay only shifts them. Each joint's response is that to its own change.

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
        """The response of each joint while all move, measured on the commands themselves.

        Args:
            feedforward: whatever makes commands; small changes of a motion are answered linearly.
            robot: cycle and speeds of the arm; a joint without a limit moves as if it were 1 rad/s (or m/s).
            q: posture about which it moves ``(n,)`` [rad].
        """
        reach = feedforward.n_d + round(4.0 * WIDTH)
        speed = _MOVES * np.where(np.isfinite(robot.v_max), robot.v_max, 1.0)
        pulse, answers = pulse_answers(feedforward.along, q, speed, robot.t_ipo, np.arange(2.0 * reach + 1) - reach)
        # Pulse and response begin and end at zero, so the response is deconvolved in the frequency domain.
        own, count = np.fft.rfft(pulse, 4 * reach), 4 * reach
        freed = np.conj(own) / (np.abs(own) ** 2 + (_RESOLVED * np.abs(own).max()) ** 2)
        weights = np.fft.irfft(freed[:, None] * np.fft.rfft(answers, count, axis=0), count, axis=0)
        # Weights are reversed in time: a command before the pulse responds to what follows.
        weights = np.roll(weights, reach, axis=0)[2 * reach :: -1]
        used = np.flatnonzero((np.abs(weights) > _SLIGHT * np.abs(weights).max(axis=0)).any(axis=1))
        first, last = min(int(used[0]), reach), max(int(used[-1]), reach)
        return cls(weights[first : last + 1], reach - first)

    def to(self, rows: Array) -> Array:
        """Changes of the commands in the ``N - L + 1`` cycles covered by changes ``(N, n)`` of the path."""
        return np.column_stack([np.convolve(row, weights, mode="valid")
                                for row, weights in zip(rows.T, self.weights[::-1].T, strict=True)])
