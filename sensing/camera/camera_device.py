"""The interface of cameras that look ahead of the tool: requests for fields, and the fields that arrive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

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

    @classmethod
    def cut(cls, t: float, picture: Gray, windows: Sequence[Window]) -> Field:
        """A field cut from a whole picture ``(height, width)`` that was exposed and arrived at ``t`` [s].

        Args:
            t: stamp [s].
            picture: gray values.
            windows: inside it.
        """
        return cls(t, t, tuple(windows),
                   tuple(np.ascontiguousarray(picture[w.v : w.v + w.height, w.u : w.u + w.width]) for w in windows))


WindowsAt = Callable[[float], Sequence[Window] | None]
"""Rectangles to read out of the field exposed at a controller time [s]; None where the field is not wanted."""


class Camera(Protocol):
    """A camera as a device.

    It exposes on its own clock, not the controller's, and its fields come late and not always in order. Each field is
    stamped with the *controller's* time of mid-exposure as well as the device knows it; errors of the stamps are
    estimated while the line is followed (``FollowerSettings.stamp``) and found by diagnosis (effect
    ``camera_latency``).
    """

    def request(self, t0: float, t1: float, windows: WindowsAt) -> None:
        """Asks for the fields of a cycle before it begins.

        Args:
            t0: begin of the cycle in controller time [s].
            t1: its end [s].
            windows: called with the instant of each exposure that ends in the cycle, as the device's stamp will say.
        """
        ...

    def arrived(self, t: float) -> list[Field]:
        """The fields that have arrived by the controller time ``t`` [s], in order of arrival, each once."""
        ...
