"""Which motions a loop can be asked for: their commands, behind whatever feedforward, keep the arm's acceleration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.feedforward.command_answer import CommandAnswer


class Commanded(NamedTuple):
    r"""The commands' accelerations of a reference path with a deviation from it.

    .. math:: \ddot q_c = w * (\ddot q_r + q_x \, \ddot d)

    with the feedforward's weights ``w`` and the change :math:`q_x` of the joint angles with the deviation. A plan is
    possible where these keep the arm's limits, or what the path itself asks for: no smoothing takes that off.

    Attributes:
        answer: of the feedforward.
        a_max: of the joints ``(n,)`` [rad/s²].
        reference: accelerations of the reference at every cycle ``(K, n)`` [rad/s²].
        per_metre: change of the joint angles with the deviation ``(K, n, directions)`` [rad/m].
    """

    answer: CommandAnswer
    a_max: Array
    reference: Array
    per_metre: Array

    def possible(self, first: int, past: Array, planned: Array, asked: Array) -> bool:
        """Whether commands follow a plan.

        Args:
            first: cycle of the next command.
            past: accelerations of the deviation from the first cycle that is in it, up to where the plan begins
                ``(p, directions)`` [m/s²].
            planned: those of the plan ``(m, directions)`` [m/s²].
            asked: those of the estimate that it follows ``(m, directions)`` [m/s²].
        """
        wanted = np.abs(self._commands(first, np.concatenate([past, planned])))
        if np.all(wanted <= self.a_max):
            return True
        path = np.abs(self._commands(first, held(asked, before=len(past))))
        return bool(np.all(wanted <= np.maximum(self.a_max, path)))

    def _commands(self, first: int, deviation: Array) -> Array:
        """Accelerations of the commands ``(m, n)`` [rad/s²], the last one of the deviation held behind it."""
        before, after = self.answer.before, self.answer.after
        rows = np.clip(np.arange(first - before, first - before + len(deviation) + after), 0, len(self.reference) - 1)
        d = held(deviation, after=after)
        return self.answer.to(self.reference[rows] + (self.per_metre[rows] @ d[:, :, None])[:, :, 0])
