"""The line of one field as a polynomial of its deviation from the reference path, with covariance ([L] 5).

A cubic through five exact points of the line itself misses a curve of 80 mm radius by 0.3 mm over 170 mm. The deviation
from the reference path is far smoother than either, so the polynomial describes that, over the path's arc length:

    Δ(s) = Σ_i c_i ((s - s_0) / h)^i,   c = (Vᵀ W V)⁻¹ Vᵀ W Δ,   Cov(c) = (Vᵀ W V)⁻¹,   W = diag(1/σ²)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import chdtri

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.estimate.cholesky import factor, inverse
from ideal_robot.jit import jit
from sensing import SensingError


@dataclass(frozen=True)
class LinePolynomial:
    """Deviation of the line from the reference path over arc length.

    Attributes:
        centre, scale: s_0 and h [m].
        coefficients: c ``(d + 1,)`` [m].
        covariance: of the coefficients ``(d + 1, d + 1)`` [m²].
        combination: how the coefficients follow from the points' deviations, c = combination @ deviation,
            ``(d + 1, m)``; columns of points that were left out are zero.
        residual: root mean square of the residuals of the points used, in units of their sigma.
        used: points that passed the outlier test ``(m,)``.
        span: smallest and largest arc length of the points used [m].
    """

    centre: float
    scale: float
    coefficients: Array
    covariance: NDArray[np.floating[Any]]
    combination: Array
    residual: float
    used: NDArray[np.bool_]
    span: tuple[float, float]

    def deviation(self, s: Array) -> tuple[Array, Array]:
        """Deviation and its standard deviation ``(k,)`` [m] at arc lengths ``(k,)`` [m]."""
        x = (np.asarray(s, dtype=float) - self.centre) / self.scale
        V = np.vander(x, len(self.coefficients), increasing=True)
        variance = np.einsum("ij,jk,ik->i", V, self.covariance, V)
        return V @ self.coefficients, np.sqrt(variance)


def fit_line_polynomial(
    s: Array, deviation: Array, sigma: Array, degree: int = 2, outlier: float = 5.0, shape_noise: float = 2e-5
) -> LinePolynomial:
    """Weighted least squares with an outlier test.

    While there are more points than coefficients, the point that the others contradict most is dropped if it is off
    by more than ``outlier`` standard deviations of that contradiction (its own and the others' prediction). With too
    few points for the degree the degree is lowered.

    Args:
        s: arc lengths on the reference path ``(m,)`` [m], in any order.
        deviation: lateral deviations ``(m,)`` [m]; NaN rows are left out.
        sigma: their standard deviations ``(m,)`` [m].
        degree: largest degree.
        outlier: limit of the outlier test.
        shape_noise: what a polynomial of that degree cannot follow, added to every sigma [m].

    Raises:
        SensingError: fewer than two usable points.

    Five points of a straight line, one of which is not on it:

    >>> s = np.linspace(0.0, 0.1, 5)
    >>> line = fit_line_polynomial(s, 0.001 + 0.2 * s + [0, 0, 0.005, 0, 0], np.full(5, 1e-4), degree=1)
    >>> line.used
    array([ True,  True, False,  True,  True])
    >>> line.deviation([0.05])[0].round(6)
    array([0.011])
    """
    s, deviation = np.asarray(s, dtype=float), np.asarray(deviation, dtype=float)
    variance = np.asarray(sigma, dtype=float) ** 2 + shape_noise**2
    used = np.isfinite(s) & np.isfinite(deviation) & np.isfinite(variance)
    if np.count_nonzero(used) < 2:
        raise SensingError(f"a line needs two points at least, {np.count_nonzero(used)} were given")
    centre, scale, coefficients, covariance, combination, rms, first, last = _fitted(s, deviation, variance, used,
                                                                                     degree, outlier)
    return LinePolynomial(centre, scale, coefficients, covariance, combination, rms, used, (first, last))


@jit()
def _fitted(s: Array, deviation: Array, variance: Array, used: NDArray[np.bool_], degree: int, outlier: float
            ) -> tuple[float, float, Array, NDArray[np.floating[Any]], Array, float, float, float]:
    """The fit of ``fit_line_polynomial``, and both ends of its span; clears the points that it drops in ``used``."""
    inside = s[used]
    centre, scale = 0.5 * (inside.min() + inside.max()), max(0.5 * (inside.max() - inside.min()), 1e-6)
    while True:
        rows = np.flatnonzero(used)
        m, d = len(rows), min(degree, len(rows) - 1)
        V, weighted = np.ones((m, d + 1)), np.empty((m, d + 1))
        for i in range(m):
            for j in range(d + 1):
                if j > 0:
                    V[i, j] = V[i, j - 1] * (s[rows[i]] - centre) / scale
                weighted[i, j] = V[i, j] / variance[rows[i]]
        covariance, normal = np.empty((d + 1, d + 1)), V.T @ weighted
        if not factor(normal):
            # Points at one place do not determine this order.
            degree = d - 1
            continue
        inverse(normal, covariance)
        weights = covariance @ weighted.T
        coefficients = weights @ deviation[rows]
        residual = deviation[rows] - V @ coefficients
        worst, most, squares = 0, 0.0, 0.0
        for i in range(m):
            # Deleted residual r_i/(1 - h_i), its variance σ_i²/(1 - h_i), h_i the leverage.
            free = 1.0
            for j in range(d + 1):
                free -= V[i, j] * weights[j, i]
            contradiction = abs(residual[i]) / np.sqrt(variance[rows[i]] * max(free, 1e-9))
            if contradiction > most:
                worst, most = i, contradiction
            squares += residual[i] ** 2 / variance[rows[i]]
        if m <= d + 1 or m <= 3 or most <= outlier:
            break
        used[rows[worst]] = False
    combination = np.zeros((d + 1, len(s)))
    for i in range(m):
        combination[:, rows[i]] = weights[:, i]
    return (centre, scale, coefficients, covariance, combination, np.sqrt(squares / m), s[rows].min(), s[rows].max())


def fit_of_lowest_order(
    s: Array, deviation: Array, sigma: Array, *, orders: tuple[int, int] = (1, 3), significance: float = 0.01
) -> LinePolynomial:
    """The polynomial of the lowest order whose residual is no more than the points' noise.

    The weighted sum of squares of the residual follows χ² with m - d - 1 degrees of freedom where the order suffices;
    an order that leaves more than the bound of ``significance`` is too low. At least one degree of freedom is left, so
    that there is a residual to judge by.

    Args:
        s: arc lengths on the reference path ``(m,)`` [m], in any order.
        deviation: lateral deviations ``(m,)`` [m].
        sigma: their standard deviations ``(m,)`` [m].
        orders: lowest and highest order.
        significance: probability with which a sufficient order counts as too low.

    Raises:
        SensingError: fewer than two usable points.
    """
    lowest, highest = orders
    highest = max(lowest, min(highest, len(s) - 2))
    for order in range(lowest, highest + 1):
        fit = fit_line_polynomial(s, deviation, sigma, order)
        count = int(np.count_nonzero(fit.used))
        free = count - len(fit.coefficients)
        # A point dropped at a low order may be the line's shape: all points have to fit.
        if order == highest or (count == len(s) and fit.residual**2 * count <= chdtri(free, significance)):
            return fit
    return fit


@dataclass(frozen=True)
class Nearest:
    """Nearest points on the line.

    Attributes:
        distance: distance ``(m,)`` [m], in space.
        s: arc length of the foot ``(m,)`` [m].
        lateral: signed distance in the plane, positive to the left of the line ``(m,)`` [m].
        foot: nearest points on the line ``(m, 3)`` [m].
    """

    distance: Array
    s: Array
    lateral: Array
    foot: Array


class Polyline:
    """Points joined by straight segments, in space: at least two, neighbours apart ``(N, 3)`` [m].

    Raises ``InputError`` where there are too few points, or two neighbours coincide.
    """

    def __init__(self, points: Array) -> None:
        self.points = np.asarray(points, dtype=float)
        if self.points.ndim != 2 or self.points.shape[1] != 3 or len(self.points) < 2:
            raise InputError("expected at least two points, shape (N, 3)", field="line.points",
                             value=self.points.shape)
        step = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        if np.any(step <= 0.0):
            raise InputError("two neighbouring points of the line coincide", field="line.points",
                             value=int(np.argmin(step)))
        self.s: Array = np.concatenate([[0.0], np.cumsum(step)])
        self._step = step
        self._direction = np.diff(self.points, axis=0) / step[:, None]
        self._tree = cKDTree(self.points)

    @property
    def length(self) -> float:
        """Length of the polyline [m]."""
        return float(self.s[-1])

    def at(self, s: Array) -> tuple[Array, Array]:
        """Points ``(m, 3)`` [m] and unit tangents ``(m, 3)`` at arc lengths ``(m,)`` [m], clipped to the ends."""
        s = np.clip(np.asarray(s, dtype=float), 0.0, self.s[-1])
        i = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2)
        tangent = self._direction[i]
        return self.points[i] + (s - self.s[i])[:, None] * tangent, tangent

    def nearest(self, points: Array, up: Array) -> Nearest:
        """Exact nearest points to ``(m, 3)`` [m]; ``up (3,)`` is the surface normal that says where left is.

        The nearest vertex is found first; the foot lies on one of the two segments at it, which holds for every
        polyline whose segments are shorter than its distance from other parts of itself.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        vertex = self._tree.query(points)[1]
        best = np.full(len(points), np.inf)
        s = np.empty(len(points))
        foot, tangent = np.empty_like(points), np.empty_like(points)
        for segment in (np.maximum(vertex - 1, 0), np.minimum(vertex, len(self._step) - 1)):
            a, direction = self.points[segment], self._direction[segment]
            along = np.clip(np.einsum("ij,ij->i", points - a, direction), 0.0, self._step[segment])
            candidate = a + along[:, None] * direction
            distance = np.linalg.norm(points - candidate, axis=1)
            closer = distance < best
            best[closer] = distance[closer]
            s[closer] = (self.s[segment] + along)[closer]
            foot[closer], tangent[closer] = candidate[closer], direction[closer]
        left = np.cross(up, tangent)
        return Nearest(best, s, np.einsum("ij,ij->i", points - foot, left), foot)
