"""What a force sensor shows of nothing: its bias has drifted since calibration, and the approach shows by how much."""

from __future__ import annotations

from collections import deque

import numpy as np

from ideal_robot.arrays import Array

BEGIN = 0.06
"""Time after the first sample in which the arm speeds up, and the tool's inertia is felt [s]."""
END = 0.06
"""Time before a sample in which it may have touched already [s]."""


class Tare:
    """Mean of the contact force that is left in the air, after bias and weight from calibration were taken away."""

    def __init__(self) -> None:
        self._first: float | None = None
        self._recent: deque[tuple[float, Array]] = deque()
        self._sum, self._count = np.zeros(3), 0

    @property
    def force(self) -> Array:
        """What is to be taken away from contact forces in the tool frame ``(3,)`` [N]."""
        return self._sum / max(self._count, 1)

    def add(self, t: Array, contact: Array) -> None:
        """Takes contact forces ``(m, 3)`` [N] of the instants ``t (m,)`` [s] of an approach."""
        for at, one in zip(t, contact, strict=True):
            self._first = float(at) if self._first is None else self._first
            if at >= self._first + BEGIN:
                self._recent.append((float(at), one))
        while self._recent and self._recent[0][0] < float(np.max(t)) - END:
            self._sum, self._count = self._sum + self._recent.popleft()[1], self._count + 1
