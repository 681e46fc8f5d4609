"""Posterior of a linear Gaussian model: parameters of whitened rows, with a prior, from products of columns.

With rows in units of their noise, ``y = X β + v``, and a prior of β with mean zero and precision Λ,

    p(β | y) = N( A⁻¹ X'y , A⁻¹ ) ,      A = Λ + X'X .

It needs only the products of ``[X, y]`` with themselves, which are small and add up over channels and blocks of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from ideal_robot.arrays import Array
from ideal_robot.tolerances import PRODUCTS


@dataclass(frozen=True)
class Posterior:
    """Gaussian posterior of the parameters, given rows and a prior.

    Attributes:
        mean: ``(P,)``.
        root: lower Cholesky factor of the scaled precision ``(P, P)``.
        scale: factors by which parameters were multiplied before ``(P,)``.
        squares: whitened squares of the residual.
        logarithm: of the determinant of the precision A.
    """

    mean: Array
    root: Array
    scale: Array
    squares: float
    logarithm: float

    @property
    def rounding(self) -> Array:
        """Rounding error added to the diagonal of the precision ``(P,)``."""
        return np.asarray(PRODUCTS / self.scale**2)

    @cached_property
    def covariance(self) -> Array:
        """Covariance ``(P, P)``."""
        inverse = linalg.cho_solve((self.root, True), np.eye(len(self.mean)))
        return np.asarray(inverse * np.outer(self.scale, self.scale))

    @property
    def std(self) -> Array:
        """Standard deviations ``(P,)``."""
        return np.sqrt(np.diag(self.covariance))

    def solve(self, right: Array) -> Array:
        """Product of the covariance and ``right``, ``(P,)`` or ``(P, k)``."""
        scale = self.scale if right.ndim == 1 else self.scale[:, None]
        return np.asarray(scale * linalg.cho_solve((self.root, True), scale * right))


def posterior(products: Array, precision: Array | None = None) -> Posterior:
    """Mean and covariance of the parameters of a linear model, from products of its whitened columns.

    Args:
        products: ``[X, y]' [X, y]`` ``(P + 1, P + 1)``.
        precision: prior precision of the parameters about zero ``(P, P)``; None for no prior.
    """
    P = len(products) - 1
    A = products[:P, :P] + (0.0 if precision is None else precision)
    own = np.maximum(np.diag(A), PRODUCTS * (np.max(np.diag(A), initial=0.0) + 1e-300))
    scale = 1.0 / np.sqrt(own)
    scaled = A * np.outer(scale, scale)
    scaled[np.diag_indices(P)] = np.diag(scaled) + PRODUCTS
    root = _root(scaled)
    mean = scale * linalg.cho_solve((root, True), scale * products[:P, P])
    squares = float(products[P, P] - 2.0 * mean @ products[:P, P] + mean @ products[:P, :P] @ mean)
    logarithm = float(2.0 * np.log(np.diag(root)).sum() - 2.0 * np.log(scale).sum())
    return Posterior(mean, root, scale, max(squares, 0.0), logarithm)


def _root(scaled: Array) -> Array:
    """Lower Cholesky factor of a matrix with a diagonal of one; of a singular one with as much more as it takes."""
    more = 0.0
    for _ in range(8):
        try:
            return np.asarray(linalg.cholesky(scaled + more * np.eye(len(scaled)), lower=True, check_finite=False))
        except linalg.LinAlgError:
            more = max(10.0 * more, PRODUCTS)
    raise linalg.LinAlgError("products of columns that are not positive: a column is not finite")


@dataclass(frozen=True)
class Joined:
    """The posterior's change when a further group of columns is added.

    Attributes:
        mean, covariance: of its coefficients ``(m,)``, ``(m, m)``, with all other parameters fitted again.
        evidence: logarithm of the density of all rows with it over that without it, its prior included.
    """

    mean: Array
    covariance: Array
    evidence: float


def root_of(covariance: Array) -> Array:
    """Matrix square root ``R (m, m)`` with ``R R'`` the covariance ``(m, m)``, which may be singular."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    units = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T) / np.outer(units, units))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def joined(present: Posterior, with_others: Array, with_itself: Array, with_y: Array, root: Array) -> Joined:
    """Adds a group of columns whose coefficients have the prior covariance ``R R'``; the gain in evidence.

    With M = C'C − C'X A⁻¹ X'C and g = C'(y − X β),

        ln p(y | with) − ln p(y | without) = ½ g'R (I + R'M R)⁻¹ R'g − ½ ln |I + R'M R| .

    Args:
        present: the others.
        with_others: products with the others' columns ``(m, P)``.
        with_itself: products with itself ``(m, m)``.
        with_y: products with the measurement ``(m,)``.
        root: ``R (m, k)``; coefficients of prior variance zero stay zero.
    """
    M = with_itself - with_others @ present.solve(with_others.T)
    g = root.T @ (with_y - with_others @ present.mean)
    A = root.T @ (0.5 * (M + M.T)) @ root
    # Rounding makes eigenvalues slightly negative, so they are bounded by zero.
    values, vectors = np.linalg.eigh(0.5 * (A + A.T))
    values = 1.0 + np.maximum(values, 0.0)
    along = vectors.T @ g
    back = root @ vectors
    return Joined(back @ (along / values), (back / values) @ back.T,
                  float(0.5 * (along**2 / values).sum() - 0.5 * np.log(values).sum()))


def measured(mean: Array, covariance: Array, places: np.ndarray, y: Array, variance: Array) -> tuple[Array, Array]:
    """Mean ``(p,)`` and covariance ``(p, p)`` of parameters after direct measurements of some of them.

    Args:
        mean, covariance: estimate before the measurement ``(p,)``, ``(p, p)``.
        places: of the measured parameters ``(k,)``.
        y, variance: the measurements, and the variance of their noise ``(k,)``.
    """
    seen = covariance[:, places]
    gain = np.linalg.solve(covariance[np.ix_(places, places)] + np.diag(variance), seen.T).T
    after = covariance - gain @ seen.T
    return mean + gain @ (y - mean[places]), 0.5 * (after + after.T)
