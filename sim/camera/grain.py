"""What the bare surface looks like: paper, wood or brushed metal in place of one even gray."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

GRAINS: dict[str, tuple[tuple[int, int], float]] = {
    "paper": ((2, 2), 6.0),
    "wood": ((200, 12), 15.0),
    "metal": ((40, 1), 10.0),
}
"""Texels along the plane's x and y over which the grain is the same, and its standard deviation in gray values."""


def add_grain(gray: NDArray[np.float32], kind: str, seed: int) -> None:
    """Adds a grain to gray values ``(rows, columns)``: noise averaged over texels along and across.

    Args:
        gray: is changed.
        kind: one of ``GRAINS``.
        seed: of the grain; one surface has one grain, whatever else is drawn.
    """
    size, sigma = GRAINS[kind]
    noise = cv2.blur(np.random.default_rng(seed).standard_normal(gray.shape, dtype=np.float32), size)
    gray += np.float32(sigma / float(noise.std())) * noise
