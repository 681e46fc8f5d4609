"""Whole pictures of a drawn line, with uneven light, a scratch and noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array


def drawn_line(*, dark: bool = True, width: float = 8.0, upright: bool = False, seed: int = 0, noise: float = 4.0,
               size: tuple[int, int] = (640, 480)) -> tuple[NDArray[np.uint8], Callable[[Array], Array]]:
    """A picture and the line's place across as a function of the place along."""
    columns, rows = size
    v, u = np.mgrid[0:rows, 0:columns].astype(float)
    s, across, length, middle = (v, u, rows, columns / 2) if upright else (u, v, columns, rows / 2)
    k = 2.0 * np.pi * 0.8 / length

    def truth(x: Array) -> Array:
        return np.asarray(middle + 55.0 * np.sin(k * x + 0.4))

    distance = np.abs(across - truth(s)) / np.hypot(1.0, 55.0 * k * np.cos(k * s + 0.4))
    background, ink = (180.0, 60.0) if dark else (70.0, 210.0)
    gray = background + (ink - background) * np.clip(0.5 + (width / 2 - distance) / 1.5, 0.0, 1.0)
    gray *= 0.7 + 0.5 * u / columns
    gray += 40.0 * np.clip(1.0 - np.abs(0.6 * (u - 300.0) - (v - 100.0)) / 2.0, 0.0, 1.0)
    gray += noise * np.random.default_rng(seed).standard_normal(gray.shape)
    return np.clip(np.rint(gray), 0, 255).astype(np.uint8), truth
