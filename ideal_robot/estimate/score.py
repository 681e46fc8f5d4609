"""The score of a model: how densely it predicts blocks of time that were left out.

With A = Λ + Σ_b X_b'X_b and r_b what the fit to all other blocks leaves of block b, in units of the noise,

    ln p(y_b | all others) = −½ [ r'r − (X'r)' A⁻¹ (X'r) + ln|A| − ln|A − A_b| ]        (up to a constant),

in closed form from the products of columns in each block. The sum over blocks is the score; the difference of two
models is a sum over blocks as well, whose standard error follows from their scatter.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.estimate.gaussian import ROUNDING


def left_out(products: Array, precision: Array | None = None) -> Array:
    """Logarithm of the density of each block given all others ``(B,)``.

    Args:
        products: ``[X, y]' [X, y]`` of whitened rows, block by block ``(B, P + 1, P + 1)``.
        precision: of the parameters beforehand, about zero ``(P, P)``; None where nothing is known.
    """
    P = products.shape[1] - 1
    own, right, squares = products[:, :P, :P], products[:, :P, P], products[:, P, P]
    if P == 0:
        return np.asarray(-0.5 * squares)
    A = own.sum(axis=0) + (0.0 if precision is None else precision)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-12 * (np.max(np.diag(A)) + 1e-300)))
    own, right = own * np.outer(scale, scale), right * scale
    A = A * np.outer(scale, scale) + 10.0 * ROUNDING * np.eye(P)
    without = A - own
    without[:, np.arange(P), np.arange(P)] += 10.0 * ROUNDING
    root, roots = np.linalg.cholesky(A), _roots(without)
    beta = np.linalg.solve(without, (right.sum(axis=0) - right)[..., None])[..., 0]
    product = np.einsum("bij,bj->bi", own, beta)
    residual = squares - 2.0 * np.einsum("bi,bi->b", right, beta) + np.einsum("bi,bi->b", beta, product)
    along = np.linalg.solve(root, (right - product).T)
    logarithm = np.log(np.diag(root)).sum() - np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    return np.asarray(-0.5 * (residual - (along**2).sum(axis=0)) - logarithm)


def _roots(matrices: Array) -> Array:
    """Cholesky factors of stacked matrices; where a block holds all there is of a column, with a little more."""
    more = np.zeros_like(matrices[0])
    for _ in range(6):
        try:
            return np.asarray(np.linalg.cholesky(matrices + more))
        except np.linalg.LinAlgError:
            more = np.eye(len(more)) * max(10.0 * float(more[0, 0]), 10.0 * ROUNDING)
    raise np.linalg.LinAlgError("products of columns that are not positive: a column is not finite")


def standard_error(difference: Array) -> float:
    """Standard error of a sum over blocks ``(B,)``, from their scatter."""
    return float(np.std(difference, ddof=1) * np.sqrt(len(difference))) if len(difference) > 1 else float("inf")
