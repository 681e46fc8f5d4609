"""Linear operators that turn samples of a path into its smoothed value and derivatives at other instants.

A penalised B-spline (degree 5, a knot per sample) is fitted to the samples. Fit and evaluation are linear, so for
fixed instants they are one matrix, made once and multiplied every cycle.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from ideal_robot.arrays import Array

_DEGREE, _PENALTY_ORDER = 5, 4
"""A quintic has continuous third derivatives; differences of order 4 make the gain ``1/(1 + (f/cutoff)^8)``."""


def spline_operators(t_samples: Array, t_out: Array, spacing: float, cutoff: float, orders: int = 3) -> list[Array]:
    """Matrices ``(len(t_out), len(t_samples))``: from samples to value, derivative, … of the smoothed path.

    Args:
        t_samples, t_out: instants of the samples, evenly spaced, and of the result, within the samples [s].
        spacing: distance of the spline's knots [s].
        cutoff: frequency at which a sinusoid is halved [Hz]; the gain is 1/(1 + (f/cutoff)^8), so a quarter of it
            passes unharmed (1e-5).
        orders: number of matrices, that of the value included.
    """
    start, end = float(t_samples[0]), float(t_samples[-1])
    pieces = max(1, round((end - start) / spacing))
    knots = start + (end - start) / pieces * np.arange(-_DEGREE, pieces + _DEGREE + 1)
    size = len(knots) - _DEGREE - 1
    basis = BSpline(knots, np.eye(size), _DEGREE, extrapolate=True)
    B = basis(t_samples)
    differences = np.diff(np.eye(size), _PENALTY_ORDER, axis=0)
    # A sinusoid of coefficients is penalised by (2 sin(ω h/2))^8 and appears in the samples with the basis' own gain
    # sinc(f h)^6; both terms shall weigh the same at the cut-off.
    h = (end - start) / pieces
    seen = len(t_samples) / (pieces + 1) * np.sinc(cutoff * h) ** (2 * (_DEGREE + 1))
    weight = seen / (2 * np.sin(min(np.pi * cutoff * h, 1.5))) ** (2 * _PENALTY_ORDER)
    fit = np.linalg.solve(B.T @ B + weight * differences.T @ differences, B.T)
    return [np.ascontiguousarray(basis.derivative(order)(t_out) @ fit if order else basis(t_out) @ fit)
            for order in range(orders)]
