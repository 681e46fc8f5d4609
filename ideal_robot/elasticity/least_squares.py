"""Linear least squares with the standard deviations of [J] (14)–(17), and wider ones where residuals are correlated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError


@dataclass(frozen=True)
class LeastSquares:
    """Solution of Y = W χ + ρ.

    Attributes:
        chi: estimate ``(b,)``.
        covariance: [J] (16) ``(b, b)``, for white residuals.
        robust: covariance that holds for correlated residuals too ``(b, b)`` (Newey–West over the given lag).
        std_percent: [J] (17) ``(b,)``.
        relative_residual: ‖W χ − Y‖ / ‖Y‖.
        condition: condition number of W with columns scaled to unit length.
    """

    chi: Array
    covariance: Array
    robust: Array
    std_percent: Array
    relative_residual: float
    condition: float


def least_squares(W: Array, Y: Array, *, lag: int = 0) -> LeastSquares:
    """Solves [J] (14) with (15)–(17).

    Args:
        W: observations ``(r, b)``.
        Y: measurements ``(r,)``.
        lag: number of neighbouring samples whose residuals may be correlated.

    Raises:
        InputError: fewer rows than parameters, or parameters that the data cannot tell apart.
    """
    r, b = W.shape
    if r <= b:
        raise InputError(f"{r} samples cannot determine {b} parameters; record longer")
    # Stiffness times angle plus offset: without scaling, W'W of angles varying by a milliradian loses all digits.
    scale = np.linalg.norm(W, axis=0)
    if np.any(scale == 0):
        raise InputError("a parameter has no influence on the recording")
    U, s, Vt = np.linalg.svd(W / scale, full_matrices=False)
    if s[-1] < 1e-12 * s[0]:
        raise InputError("the recording does not excite all parameters")
    chi = Vt.T @ (U.T @ Y / s) / scale
    rho = Y - W @ chi
    inverse = (Vt.T / s**2) @ Vt / np.outer(scale, scale)
    covariance = (rho @ rho) / (r - b) * inverse
    scores = W * rho[:, None]
    meat = scores.T @ scores
    for shift in range(1, min(lag, r - 1) + 1):
        cross = scores[shift:].T @ scores[:-shift]
        meat += (1 - shift / (lag + 1)) * (cross + cross.T)
    robust = inverse @ meat @ inverse * r / (r - b)
    norm = np.linalg.norm(Y)
    return LeastSquares(chi, covariance, robust, 100 * np.sqrt(np.diag(covariance)) / np.abs(chi),
                        float(np.linalg.norm(rho) / norm) if norm > 0 else 0.0, float(s[0] / s[-1]))
