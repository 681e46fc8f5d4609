"""Rows of a run, into memory that is there before the first packet: nothing grows while a cycle waits."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState


class CycleLog:
    """Time, desired and commanded position, measured position and torque of every cycle.

    Args:
        rows: cycles it holds; further ones are dropped.
        n: number of joints.
    """

    def __init__(self, rows: int, n: int) -> None:
        # Written once here: memory that is only promised would be fetched while a controller waits.
        self._t, self._values = np.full(rows, 0.0), np.full((4, rows, n), 0.0)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, state: RobotState, q_d: Array, q_c: Array) -> None:
        """Writes one cycle down.

        Args:
            state: of the arm before the command.
            q_d: desired position ``(n,)`` [rad].
            q_c: commanded position ``(n,)`` [rad].
        """
        if self._count < len(self._t):
            self._t[self._count] = state.t
            for values, row in zip(self._values, (q_d, q_c, state.q, state.tau), strict=True):
                values[self._count] = row
            self._count += 1

    def columns(self) -> tuple[Array, dict[str, Array]]:
        """Times ``(N,)`` [s] and ``q_d``, ``q_c``, ``q``, ``tau``, each ``(N, n)``."""
        values = self._values[:, : self._count]
        return self._t[: self._count], dict(zip(("q_d", "q_c", "q", "tau"), values, strict=True))
