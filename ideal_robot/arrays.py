"""What all rooms share of numbers: the array type, the time law of motions from rest to rest, gravity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Double precision, whatever the shape; the docstring of each function says which."""
G = 9.81
"""Acceleration of gravity [m/s²], as Pinocchio has it."""
GRAVITY = np.array([0.0, 0.0, -G])
"""Its direction and size in the base frame [m/s²]."""


def eased(share: Array) -> Array:
    """Way from rest to rest over the share of the time: both from 0 to 1, without a jump of the acceleration.

    The polynomial s³ (10 - 15 s + 6 s²) has 1.875 times the mean speed, and 5.774 times the way over the squared
    duration as acceleration, at its peaks.
    """
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def held(rows: Array, *, before: int = 0, after: int = 0) -> Array:
    """Rows with the first one repeated ahead and the last one behind.

    Args:
        rows: ``(N, …)``, at least one.
        before: how often the first one is repeated.
        after: how often the last one is repeated.
    """
    return np.concatenate([np.repeat(rows[:1], before, axis=0), rows, np.repeat(rows[-1:], after, axis=0)])
