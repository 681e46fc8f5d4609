"""Checks which path corrections the commands can follow within the acceleration limit, behind any feedforward."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.feedforward.command_answer import CommandAnswer


class Commanded(NamedTuple):
    r"""The accelerations that path corrections require of the commands.

    .. math:: \ddot q_c = w * q_x \, (\ddot d - \ddot r)

    with the feedforward's weights ``w``, the change :math:`q_x` of the joint angles with the deviation, and the plan
    ``d`` beside the estimate ``r``, whose own acceleration no smoothing removes. The reference uses at most the arm's
    acceleration; a correction may use as much again, and the sum is permitted.

    Attributes:
        answer: of the feedforward.
        a_max: of the joints ``(n,)`` [rad/s²].
        per_metre: change of the joint angles with the deviation at every cycle ``(K, n, directions)`` [rad/m].
    """

    answer: CommandAnswer
    a_max: Array
    per_metre: Array

    def possible(self, first: int, past: Array, planned: Array, asked: Array) -> bool:
        """Whether the commands can follow a plan.

        Args:
            first: cycle of the next command.
            past: accelerations of the deviation from the first cycle that is in it, up to where the plan begins
                ``(p, directions)`` [m/s²].
            planned: accelerations of the plan, the last of which continues after its end ``(m, directions)`` [m/s²].
            asked: accelerations of the estimate that the plan follows ``(m, directions)`` [m/s²].
        """
        correction = held(np.concatenate([past, planned]) - held(asked, before=len(past)), after=self.answer.after)
        rows = np.arange(len(correction)) + first - self.answer.before
        per_metre = self.per_metre[np.clip(rows, 0, len(self.per_metre) - 1)]
        commands = self.answer.to((per_metre @ correction[:, :, None])[:, :, 0])
        return bool(np.all(np.abs(commands) <= self.a_max))
