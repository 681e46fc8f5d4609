"""Array helpers that all packages share: the array type, motions from rest to rest, rows."""

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
    """Smooth motion from rest to rest: distance from 0 to 1 over time from 0 to 1, with continuous acceleration.

    The polynomial s³ (10 - 15 s + 6 s²) has 1.875 times the mean speed, and 5.774 times the distance over the squared
    duration as acceleration, at its peaks.
    """
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def eased_way(start: Array, end: Array, limits: tuple[Array, Array], T: float) -> Array:
    """Positions ``(K, n)`` at the cycles of the fastest common ``eased`` motion of all axes, without the start.

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
    """Rows interpolated linearly between given rows; constant beyond their ends.

    Args:
        at: times of the result ``(m,)``.
        t, rows: rising times of the given rows ``(N,)``, and the rows ``(N, n)``.
    """
    return np.column_stack([np.interp(at, t, column) for column in rows.T])


def held(rows: Array, *, before: int = 0, after: int = 0) -> Array:
    """Rows ``(N, …)`` padded: the first one repeated before, the last one after them.

    Args:
        rows, before, after: the rows, and the numbers of repetitions of the first and the last one.
    """
    return np.concatenate([np.repeat(rows[:1], before, axis=0), rows, np.repeat(rows[-1:], after, axis=0)])
