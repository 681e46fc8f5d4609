"""Points of a curve at even steps of arc length."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array

KNOT = 0.002
"""Spacing of the points [m]; between them the curvature is linear."""


def even_steps(points: Array, chord: Array, smoothing: float) -> tuple[Array, Array]:
    """Averages the points and gives them even steps of arc length: points ``(K, 3)`` and arc lengths ``(K,)``.

    Args:
        points: of the curve ``(N, 3)`` [m].
        chord: length along the polygon up to each point ``(N,)`` [m].
        smoothing: the curve is averaged twice over half of this length [m].
    """
    fine = max(round(chord[-1] / 0.0005), 20)
    grid = np.linspace(0.0, chord[-1], fine + 1)
    # Sparse points are corners of a polygon, dense ones a curve.
    dense = len(points) > 50
    curve = (
        CubicSpline(chord, points)(grid)
        if dense
        else np.column_stack([np.interp(grid, chord, points[:, i]) for i in range(3)])
    )
    curve = averaged(
        averaged(curve, round(0.5 * smoothing / (grid[1] - grid[0]))), round(0.5 * smoothing / (grid[1] - grid[0]))
    )
    for _ in range(3):
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
        spline = CubicSpline(s, curve)
        # Chords are shorter than arcs: Gauss' rule on each piece gives the arc length that the spline really has.
        node, weight = np.polynomial.legendre.leggauss(3)
        half = 0.5 * np.diff(s)
        at = s[:-1, None] + half[:, None] * (1.0 + node)
        s = np.concatenate([[0.0], np.cumsum(half * (np.linalg.norm(spline(at, 1), axis=2) @ weight))])
        count = max(round(s[-1] / KNOT), 10)
        knots = np.linspace(0.0, s[-1], count + 1)
        curve = CubicSpline(s, curve)(knots)
        if len(curve) == len(s):
            break
    return curve, np.linspace(0.0, s[-1], len(curve))


def averaged(values: Array, width: int) -> Array:
    """Moving average over ``width`` samples; beyond the ends the values go on by point reflection, so the ends stay."""
    half = width // 2
    if half < 1:
        return values
    half = min(half, len(values) - 1)
    before, after = 2 * values[:1] - values[half:0:-1], 2 * values[-1:] - values[-2 : -half - 2 : -1]
    padded = np.concatenate([before, values, after])
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(padded, axis=0)])
    window = 2 * half + 1
    return (total[window:] - total[:-window]) / window
