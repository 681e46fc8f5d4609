"""Rational filters of evenly spaced rows: from powers of s to recursions, in steady state at the start."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array


def bilinear(num: Array, den: Array, dt: float) -> tuple[Array, Array]:
    """Filters of rows ``dt`` [s] apart by the trapezoidal rule, ``s = 2/dt (z - 1)/(z + 1)``.

    Args:
        num, den: numerators ``(m, k)`` and denominator ``(k,)`` from the highest power of s on.
        dt: [s].
    """
    order = len(den) - 1
    powers = []
    for power in range(order, -1, -1):
        row = np.array([(2.0 / dt) ** power])
        for k in range(order):
            row = np.convolve(row, [1.0, -1.0] if k < power else [1.0, 1.0])
        powers.append(row)
    table = np.array(powers)
    scale = float(den @ table[:, 0])
    return num @ table / scale, den @ table / scale


def from_rest(num: Array, den: Array, x: Array) -> Array:
    """Filters rows ``(N,)``, as if the first one had been constant before.

    Args:
        num, den: coefficients of the recursion ``(k,)`` each.
        x: rows ``(N,)``.
    """
    from scipy import signal

    if len(den) == 1:
        return np.asarray(num[0] / den[0] * x)
    return np.asarray(x[0] * num.sum() / den.sum() + signal.lfilter(num, den, x - x[0]))
