"""What the camera's process tells the one that leads the arm."""

from __future__ import annotations

from dataclasses import dataclass

from sensing.camera.field import Gray, Window
from sensing.camera.line_detection import LineField


@dataclass(frozen=True)
class Header:
    """A picture has come: when it was taken and read, by this computer's clock [s]."""

    number: int
    taken: float
    read: float


@dataclass(frozen=True)
class Evaluated:
    """What was found in a picture, and its windows."""

    seen: LineField
    windows: tuple[Window, ...]
    patches: tuple[Gray, ...]
