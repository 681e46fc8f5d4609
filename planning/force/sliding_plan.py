"""The plan of the coming cycles in two directions, which slides along with time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array, held
from planning.path.smoothing import Smoother

SPARE = 6
"""Cycles planned beyond the horizon."""


class SlidingPlan:
    """Desired positions in two directions with their derivatives, and their joint angles, from the current cycle on.

    Args:
        n_d: desired joint positions of a horizon.
        t_ipo: interpolation cycle [s].
        q_start: joint angles at the beginning ``(n,)`` [rad].
        start: position at the beginning ``(2,)`` [m].
        cutoff: frequency up to which an estimate is followed [Hz].
        correction: acceleration that corrections may cost [m/s²].

    Attributes:
        samples: cycles that are planned at a time.
        q: joint angles of the same cycles ``(samples + 2, n)`` [rad].
        cycle: number of the current cycle.
    """

    def __init__(self, n_d: int, t_ipo: float, q_start: Array, start: Array, *, cutoff: float,
                 correction: float) -> None:
        self.n_d, self.samples, self.cycle = n_d, n_d + SPARE, 0
        self._smoother = Smoother(self.samples, t_ipo, cutoff, correction)
        # By cycle: position, velocity and acceleration in both directions.
        self._states = np.zeros((self.samples + 2, 3, 2))
        self._states[:, 0] = start
        self.q = np.tile(q_start, (self.samples + 2, 1))

    @property
    def position(self) -> Array:
        """Positions from the current cycle on ``(samples + 2, 2)`` [m]."""
        return self._states[:, 0]

    def advance(self, cycle: int) -> None:
        """Goes on to a cycle; behind the end of what was planned the last position is held."""
        passed = cycle - self.cycle
        if passed <= 0:
            return
        self._states = held(self._states[passed:], after=passed)
        self._states[-passed:, 1:] = 0.0
        self.q = held(self.q[passed:], after=passed)
        self.cycle = cycle

    def follow(self, estimate: Array, keep: int) -> None:
        """Plans anew towards an estimate, each direction on its own: a large correction must not slow the other one.

        Args:
            estimate: wanted positions of the cycles behind ``keep`` ``(samples, 2)`` [m].
            keep: cycles from now on that stay as they are.
        """
        for direction in (0, 1):
            one = slice(direction, direction + 1)
            planned = self._smoother.plan(self._states[keep, :, one], estimate[:, one])
            self._states[keep + 1 : keep + 1 + self.samples, :, one] = planned.transpose(1, 0, 2)

    def solve(self, keep: int, joint_angles: Callable[[slice, Array], Array]) -> Array:
        """Joint angles of the horizon ``(n_d, n)`` [rad].

        Args:
            keep: cycles from now on that stay as they are.
            joint_angles: of the rows given, from their last joint angles ``(m, n)`` [rad].
        """
        rows = slice(keep + 1, self.n_d)
        if rows.start < rows.stop:
            self.q[rows] = joint_angles(rows, self.q[rows])
        return self.q[: self.n_d].copy()
