"""A deadline for waiting, on a clock that neither jumps nor goes back."""

from __future__ import annotations

import time
from dataclasses import dataclass

TIME_LIMIT = 3600.0
"""How long a run may take unless another limit is given [s]; the longest scene of an hour takes a third of it."""
LONGEST = 86400.0
"""Longest single wait [s]: the system counts milliseconds in 32 bits. Who waits for longer asks again."""


@dataclass(frozen=True)
class Deadline:
    """An end, by ``time.perf_counter`` [s], that a whole wait of some seconds shares, however many reads it takes."""

    seconds: float
    end: float

    @classmethod
    def within(cls, seconds: float) -> Deadline:
        """A deadline that passes ``seconds`` from now."""
        return cls(seconds, time.perf_counter() + seconds)

    @property
    def left(self) -> float:
        """Remaining time [s], ``LONGEST`` at most; 0 when the deadline has passed."""
        return min(max(self.end - time.perf_counter(), 0.0), LONGEST)

    @property
    def passed(self) -> bool:
        """Whether the deadline has passed."""
        return self.left == 0.0
