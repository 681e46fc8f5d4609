"""Least squares in information form: the inverse-covariance Kalman filter [G] names for every linear fit.

It starts from no knowledge at all (information zero), takes measurements in any order and number, and gives the
estimate on demand. A prior is a measurement like any other.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array


class InformationFilter:
    """Information matrix ``Y = Σ Hᵀ R⁻¹ H`` and vector ``y = Σ Hᵀ R⁻¹ z`` of ``size`` unknowns.

    Args:
        size: number of unknowns.
    """

    def __init__(self, size: int) -> None:
        self.matrix = np.zeros((size, size))
        self.vector = np.zeros(size)

    def update(self, H: Array, z: Array, sigma: float) -> None:
        """Takes ``z (r,) = H (r, size) x + noise`` with standard deviation ``sigma``.

        Args:
            H: ``(r, size)``.
            z: measurements ``(r,)``.
            sigma: standard deviation of each of them, in the unit of ``z``.
        """
        self.matrix += H.T @ H / sigma**2
        self.vector += H.T @ z / sigma**2

    def solve(self) -> Array:
        """The estimate ``Y⁻¹ y (size,)``; of smallest norm in directions nothing is known about."""
        # Scaled to a unit diagonal, so that the rank decision does not depend on units.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.matrix), 1e-300))
        scaled = self.matrix * scale[:, None] * scale[None, :]
        return np.asarray(scale * np.linalg.lstsq(scaled, scale * self.vector, rcond=1e-12)[0])
