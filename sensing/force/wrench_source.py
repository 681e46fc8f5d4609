"""The seam of force sensors on networks: readings with stamps of the sensor's own clock."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from ideal_robot.arrays import Array
from sensing.clock.clock_relation import ClockRelation


@dataclass(frozen=True)
class Reading:
    """One reading.

    Attributes:
        stamp: instant of the measurement by the sensor's clock [s].
        wrench: force [N] and moment [N m] ``(6,)``, in the sensor's frame.
    """

    stamp: float
    wrench: Array


@dataclass
class ReadingCounts:
    """What became of what the sensor sent.

    Attributes:
        readings: that were handed on.
        lost: numbers that never came.
        outdated: readings that came again, or behind a newer one.
        refused: packets that are none of the sensor's, or readings with numbers that are not finite.
        invalid: readings that the sensor itself says are wrong.
        last_invalid: what it said.
    """

    readings: int = 0
    lost: int = 0
    outdated: int = 0
    refused: int = 0
    invalid: int = 0
    last_invalid: str = field(default="")


class WrenchSource(Protocol):
    """A force/torque sensor, as long as it is open.

    Attributes:
        clock: how the stamps relate to this computer's clock; ``read`` adds to it.
        counts: what became of what it sent.
    """

    clock: ClockRelation
    counts: ReadingCounts

    def read(self, timeout: float) -> list[Reading]:
        """The readings of the next packet, none if none comes within ``timeout`` [s]; never raises."""
        ...

    def close(self) -> None:
        """Gives the sensor back."""
        ...
