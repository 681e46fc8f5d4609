"""Long series thinned for what people look at: pages, replays, curves in results."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.file_array import let_go

MOST = 100_000
"""Rows of a series at most, 200 s at 500 Hz; a picture is some thousand pixels wide."""


def step(count: int) -> int:
    """Every so manieth of ``count`` rows is shown; 1 for all but long series."""
    return max(1, -(-count // MOST))


def extremes(values: Array) -> NDArray[np.int_]:
    """Rows of a series ``(N,)`` to be drawn: all, or of a long one the lowest and the highest of every few."""
    size = 2 * step(len(values))
    if size == 2:
        return np.arange(len(values))
    whole = len(values) // size * size
    pieces = values[:whole].reshape(-1, size)
    first = np.arange(0, whole, size)
    rows = np.concatenate([first + pieces.argmin(axis=1), first + pieces.argmax(axis=1)])
    let_go(values)
    return np.unique(rows)
