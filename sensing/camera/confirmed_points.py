"""Which points of a field the others confirm.

A straight line through three points, one of them far from the other two, bends to that one: its own residual stays
small however wrong it is (its leverage is nearly 1; Baarda's *internal reliability*). So a point is held against the
line of the *other* points, extrapolated to it, never against a line that it has drawn itself.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit


@jit()
def confirmed_points(along: Array, deviation: Array, used: NDArray[np.bool_], tolerance: float) -> NDArray[np.bool_]:
    """The points that lie within a tolerance of the least-squares line of the others.

    As long as one does not, the one that contradicts the others most is taken out.

    Args:
        along: places along the prediction ``(m,)`` [m].
        deviation: from the prediction ``(m,)`` [m]; where not used, of no account.
        used: points to choose from ``(m,)``.
        tolerance: how far a point may be off [m].

    Returns:
        ``(m,)``. Two points or fewer have nothing to be held against and remain.
    """
    m = along.size
    kept = used.copy()
    while kept.sum() > 2:
        worst, out, refused = 0.0, -1, False
        for i in range(m):
            if not kept[i]:
                continue
            count, a, d, aa, ad = 0, 0.0, 0.0, 0.0, 0.0
            for j in range(m):
                if kept[j] and j != i:
                    # About the point itself: the line's value there is the intercept.
                    x = along[j] - along[i]
                    count += 1
                    a, d, aa, ad = a + x, d + deviation[j], aa + x * x, ad + x * deviation[j]
            spread = aa - a * a / count
            slope = (ad - a * d / count) / spread if spread > 0.0 else 0.0
            off = abs(deviation[i] - (d - slope * a) / count)
            refused = refused or off > tolerance
            # In standard deviations: what the others say of a far end is itself uncertain.
            off /= math.sqrt(1.0 + 1.0 / count + ((a / count) ** 2 / spread if spread > 0.0 else 0.0))
            if off > worst:
                worst, out = off, i
        if not refused:
            break
        kept[out] = False
    return kept
