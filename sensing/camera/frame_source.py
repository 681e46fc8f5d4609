"""The seam of cameras on cables: whole pictures with stamps of the camera's own clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from sensing.camera.field import Gray
from sensing.clock.clock_relation import ClockRelation


@dataclass(frozen=True)
class Frame:
    """A whole picture.

    Attributes:
        number: counts the pictures of its camera.
        stamp: mid-exposure by the camera's clock, or whatever its stamps mean; see ``FrameSource.stamps``  [s].
        arrived: when it was read, by ``time.perf_counter`` [s].
        image: gray values ``(height, width)``, uint8.
    """

    number: int
    stamp: float
    arrived: float
    image: Gray


class FrameSource(Protocol):
    """A camera that delivers whole pictures, as long as it is open.

    Attributes:
        width, height: size of a picture [px].
        stamps: whose clock the stamps are of: ``camera`` (its own), ``stream`` (of the recording or the sender) or
            ``arrival`` (there is none but this computer's: the stamp is when the picture was read).
        clock: how that clock relates to this computer's; ``read`` adds to it.
    """

    width: int
    height: int
    stamps: str
    clock: ClockRelation

    def read(self, timeout: float) -> Frame | None:
        """The next picture; None if none comes within ``timeout`` [s], or what came could not be used.

        Raises:
            SensingError: the camera is gone, or its stream has ended.
        """
        ...

    def close(self) -> None:
        """Gives the camera back."""
        ...
