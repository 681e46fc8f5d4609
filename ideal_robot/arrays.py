"""What all rooms share of numbers: the array type, motions from rest to rest, rows, gravity."""

from __future__ import annotations

from typing import Any

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


def eased_way(start: Array, end: Array, limits: tuple[Array, Array], T: float) -> Array:
    """Positions ``(K, n)`` at the cycles of the quickest such motion of all axes together, the start left out.

    Args:
        start, end: ``(n,)``, at rest.
        limits: of speed and acceleration ``(n,)`` each.
        T: cycle [s].
    """
    distance, (v, a) = np.abs(end - start), limits
    duration = max(float(np.max(1.875 * distance / v)), float(np.sqrt(np.max(5.774 * distance / a))), T)
    count = int(np.ceil(duration / T))
    return start + eased(np.arange(1, count + 1)[:, None] / count) * (end - start)


def arc_lengths(points: Array) -> Array:
    """Lengths ``(N,)`` from the first of the points ``(N, d)`` to each, along straight lines between them."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def interpolated(at: NDArray[Any], t: NDArray[Any], rows: Array) -> Array:
    """Rows between rows ``(m, n)``: linear in between, and as the first and the last beyond them.

    Args:
        at: where they are wanted ``(m,)``.
        t, rows: where rows are known, rising ``(N,)``, and those ``(N, n)``.
    """
    return np.column_stack([np.interp(at, t, column) for column in rows.T])


def held(rows: Array, *, before: int = 0, after: int = 0) -> Array:
    """Rows ``(N, …)``, at least one, with the first one repeated ahead and the last one behind.

    Args:
        rows, before, after: what is repeated, and how often the first and the last of it are.
    """
    return np.concatenate([np.repeat(rows[:1], before, axis=0), rows, np.repeat(rows[-1:], after, axis=0)])
