"""What a camera delivers of one field: gray patches of the windows that were asked for, and its time stamp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Gray = NDArray[np.uint8]


class Window(NamedTuple):
    """A rectangle of pixels: column and row of its first pixel, columns and rows."""

    u: int
    v: int
    width: int
    height: int


@dataclass(frozen=True)
class Field:
    """One camera field, cut to windows.

    Attributes:
        t_stamp: controller time of mid-exposure as the camera reports it [s].
        t_arrival: controller time at which the data are available [s].
        windows: the rectangles.
        patches: gray values of each window, shape ``(height, width)``, uint8.
    """

    t_stamp: float
    t_arrival: float
    windows: tuple[Window, ...]
    patches: tuple[Gray, ...]
