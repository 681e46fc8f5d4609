"""A buffer of earlier states, so that late measurements can be fused in their order."""

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
    """The state before a measurement or a travel step ``(F, Q)``, and that measurement or step.

    Attributes:
        t: time of the measurement or step [s].
        stand: position of the state's window.
        x, P: state ``(n,)`` and covariance ``(n, n)``.
        then: the measurement or step.
    """

    t: float
    stand: Stand
    x: Array
    P: Array
    then: Measurement | tuple[Array, Array] = field(repr=False)


class Buffer:
    """The last states with the measurements and steps that followed them."""

    def __init__(self) -> None:
        self._entries: deque[Before] = deque()

    def add(self, entry: Before) -> None:
        """Adds an entry; entries that are too old are dropped with the next measurement."""
        self._entries.append(entry)

    def forget(self, t: float) -> None:
        """Drops entries too far before ``t`` [s]."""
        while self._entries[0].t < t - MEMORY:
            self._entries.popleft()

    def clear(self) -> None:
        """Drops all entries."""
        self._entries.clear()

    def taken_back(self, t: float) -> list[Before] | None:
        """Removes and returns the entries after ``t`` [s], oldest first; None where ``t`` lies before the buffer."""
        late = [entry for entry in self._entries if entry.t > t]
        if late and t < self._entries[0].t and len(late) == len(self._entries):
            return None
        for _ in late:
            self._entries.pop()
        return late

    @property
    def newest(self) -> float | None:
        """Time of the newest entry [s]; None without any."""
        return self._entries[-1].t if self._entries else None
