"""Measurements that come late: the state before each is kept, so that one can go back and take all in their order."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from ideal_robot.arrays import Array
from planning.line.deviation_model import Stand
from planning.line.measurement import Measurement

MEMORY = 0.5
"""How late a measurement may be where their order matters [s]."""


@dataclass
class Before:
    """The state before a measurement or a travel step ``(F, Q)``, and which of them it was.

    Attributes:
        t: when [s].
        stand: where the state stood.
        x, P: state ``(n,)`` and covariance ``(n, n)``.
        then: what came.
    """

    t: float
    stand: Stand
    x: Array
    P: Array
    then: Measurement | tuple[Array, Array] = field(repr=False)


class Buffer:
    """The last states, and what came then."""

    def __init__(self) -> None:
        self._entries: deque[Before] = deque()

    def add(self, entry: Before) -> None:
        """One more; what is too old to be gone back to is forgotten with the next measurement."""
        self._entries.append(entry)

    def forget(self, t: float) -> None:
        """Forgets what lies too far before ``t`` [s]."""
        while self._entries[0].t < t - MEMORY:
            self._entries.popleft()

    def clear(self) -> None:
        """Forgets all measurements that are kept."""
        self._entries.clear()

    def taken_back(self, t: float) -> list[Before] | None:
        """What came after ``t`` [s], taken out, the oldest first; None where ``t`` lies before what is kept."""
        late = [entry for entry in self._entries if entry.t > t]
        if late and t < self._entries[0].t and len(late) == len(self._entries):
            return None
        for _ in late:
            self._entries.pop()
        return late

    @property
    def newest(self) -> float | None:
        """When the last of them was [s]; None without any."""
        return self._entries[-1].t if self._entries else None
