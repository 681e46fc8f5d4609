"""Back to the commands that are wanted, from where and how fast the controller has the arm instead.

What is sent is the wanted command plus an offset ``o``. Where an answer was missed the offset starts with the
difference in position and speed, so that the controller sees no jump, and fades on a cubic::

    o(u) = (1 - u)² (o_0 + (2 o_0 + N d_0) u) ,   u = i / N

with ``o_0`` [rad] and ``d_0`` [rad a cycle] at ``i = 0`` and rest at ``i = N``. All joints take the same time, so the
arm leaves the path as little as it can.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array

_LONGEST = 2000
"""Cycles after which an offset has faded whatever it costs."""


class CatchUp:
    """The offset of what is sent from what is wanted.

    Args:
        room: acceleration of the arm it may take ``(n,)`` [rad/s²].
        v_max: speed the arm may reach with it ``(n,)`` [rad/s].
        t_ipo: cycle [s].
    """

    def __init__(self, room: Array, v_max: Array, t_ipo: float) -> None:
        self._room, self._fastest = room * t_ipo**2, v_max * t_ipo
        self._offset = self._drift = np.zeros(len(room))
        self._cycles = self._done = 0

    @property
    def active(self) -> bool:
        """Whether there is an offset still."""
        return self._done < self._cycles

    def start(self, offset: Array, drift: Array, wanted: Array) -> None:
        """From another position and speed.

        Args:
            offset: position in force minus the one wanted ``(n,)`` [rad].
            drift: the same of the speeds ``(n,)`` [rad a cycle].
            wanted: speed wanted ``(n,)`` [rad a cycle].
        """
        self._offset, self._drift, self._done = offset, drift, 0
        # |ö| is largest at an end: |6 o + 4 N d| / N² and |6 o + 2 N d| / N².
        lengths = np.arange(1.0, _LONGEST + 1.0)[:, None]
        needed = np.maximum(np.abs(6 * offset + 4 * lengths * drift), np.abs(6 * offset + 2 * lengths * drift))
        fits = (needed <= self._room * lengths**2).all(axis=1)
        self._cycles = int(np.argmax(fits)) + 1 if fits.any() else _LONGEST
        allowed = np.maximum(self._fastest, np.maximum(np.abs(wanted), np.abs(wanted + drift))) + 1e-12
        while self._cycles < _LONGEST:
            rows = np.array([self._at(i) for i in range(self._cycles + 1)])
            if (np.abs(wanted + np.diff(rows, axis=0)) <= allowed).all():
                break
            self._cycles = min(int(1.25 * self._cycles) + 1, _LONGEST)

    def next(self) -> Array:
        """Offset of the coming command ``(n,)`` [rad]."""
        self._done = min(self._done + 1, self._cycles)
        return self._at(self._done)

    def _at(self, i: int) -> Array:
        if i >= self._cycles:
            return np.zeros_like(self._offset)
        u = i / self._cycles
        return np.asarray((1 - u) ** 2 * (self._offset + (2 * self._offset + self._cycles * self._drift) * u))
