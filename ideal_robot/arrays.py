"""The array type of the whole project."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Double precision, whatever the shape; the docstring of each function says which."""


def held(rows: Array, *, before: int = 0, after: int = 0) -> Array:
    """Rows with the first one repeated ahead and the last one behind.

    Args:
        rows: ``(N, …)``, at least one.
        before: how often the first one is repeated.
        after: how often the last one is repeated.
    """
    return np.concatenate([np.repeat(rows[:1], before, axis=0), rows, np.repeat(rows[-1:], after, axis=0)])
