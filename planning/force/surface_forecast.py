"""The surface ahead of the tip, from waves that the surface behind it has shown."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from planning.force.wave_variances import likelier_variances
from planning.line.deviation_model import matern

SPACING = 0.008
"""Way over which older measurements are one [m]."""
LEARNS = 0.004
"""Way after which the kernel is learned anew [m]."""
RECENT = 8
"""Newest measurements, which are kept as they are: a mean would be late where the tip is slow."""
WINDOW = 70
"""Places that are remembered: half a metre, two of the longer waves."""
MOST = 10
"""Measurements that count of a place where the tip stands."""
DISPLACEMENT, ROTATION = 0.02, 0.05
"""Standard deviations of the surface's height [m] and slope against the nominal plane."""
SHAPE, ROUGHEST, SMOOTHEST = 1e-4, 6e-3, 5e-6
"""Standard deviation of the shape that is no wave, at first, and its bounds [m]."""
LENGTH = 0.08
"""Distance over which that shape becomes another [m]."""
WAVELENGTHS = 1.0 / np.linspace(1.0 / 0.8, 1.0 / 0.08, 60)
"""Waves that a surface may have [m]."""
WAVES = (4e-3 * WAVELENGTHS**2 / 0.09) ** 2 / len(WAVELENGTHS)
"""Variances of the waves before any is known: the longer, the larger [m²]."""
LARGEST_WAVE = 1e-4
"""Bound of a wave's variance [m²]."""
ALIKE = 3.0
"""Standard deviations of the noise by which the sensor's errors may differ between measurements of one place."""
BEGIN = 8
"""Places from which on waves are learned."""


class SurfaceForecast:
    r"""Height along the path as a Gaussian process whose kernel is learned from what was felt.

    .. math:: k(s, s') = \sigma_0^2 + \sigma_1^2 s s' + \sigma^2\, m(s - s')
              + \sum_i \gamma_i \cos \frac{2 \pi (s - s')}{\lambda_i}

    with Matérn's correlation m. A force shows the surface under the tip and nothing ahead, so the height is continued
    over all that delays an answer, some 15 mm at 0.2 m/s. A prior of smoothness alone is poor there;
    surfaces that were milled, bent or cast have waves, and one that was felt once goes on. The
    variances γ are those that make what was felt likelier (``wave_variances``), and σ changes by factors of two for the
    same reason. Errors of the sensor itself are part of the same regression.

    Args:
        errors: standard deviations of the sensor's errors ``(b,)``, as in ``planning.line.fusion.DeviationFilter``.
    """

    def __init__(self, errors: tuple[float, ...]) -> None:
        self._errors = np.square(errors)
        # Of each place: arc length, value, variance, effects of the sensor's errors; and the measurements in it.
        self._places = np.zeros((0, 3 + len(errors)))
        self._counts: list[int] = []
        self._learned_at = -np.inf
        self._gamma, self._sigma = WAVES.copy(), SHAPE
        self._turn = 0
        self._weights: Array | None = None

    def add(self, s: float, value: float, variance: float, wrong: Array) -> None:
        """Takes one measurement.

        Args:
            s: arc length that was felt [m].
            value: height there [m].
            variance: of the value [m²].
            wrong: how much each error of the sensor adds to the value ``(b,)``.
        """
        self._places = np.vstack([self._places[-WINDOW:], np.concatenate([[s, value, variance], wrong])])
        self._counts = [*self._counts[-WINDOW:], 1]
        self._weights = None
        old = len(self._places) - RECENT - 1
        if old > 0 and self._alike(old):
            self._counts[old - 1] = min(self._counts[old - 1] + 1, MOST)
            self._places[old - 1] += (self._places[old] - self._places[old - 1]) / self._counts[old - 1]
            self._places = np.delete(self._places, old, axis=0)
            del self._counts[old]
        if s - self._learned_at >= LEARNS and len(self._places) > BEGIN:
            self._learned_at = s
            self._learn()

    def _alike(self, old: int) -> bool:
        """Whether a place is near the one before and the sensor's errors count there as much, but for the noise."""
        apart = np.abs(self._places[old] - self._places[old - 1])
        return bool(apart[0] < 0.5 * SPACING
                    and np.all(self._errors * apart[3:] ** 2 < ALIKE**2 * self._places[old, 2]))

    def height(self, s: Array) -> Array:
        """Height expected at arc lengths ``(m,)`` [m]; zero before anything was felt."""
        if not len(self._places):
            return np.zeros(len(s))
        at, origin = self._places[:, 0], self._places[-1, 0]
        if self._weights is None:
            K = self._covariance(self._sigma, self._gamma)
            self._weights = np.asarray(np.linalg.solve(K, self._places[:, 1]), dtype=np.float64)
        apart = s[:, None] - at
        cross = DISPLACEMENT**2 + ROTATION**2 * np.outer(s - origin, at - origin)
        cross += self._sigma**2 * matern(np.abs(apart), LENGTH)
        cross += (_waves(s) * np.tile(self._gamma, 2)) @ _waves(at).T
        return np.asarray(cross @ self._weights, dtype=np.float64)

    def _covariance(self, sigma: float, gamma: Array) -> Array:
        at, wrong = self._places[:, 0], self._places[:, 3:]
        away, apart = at - at[-1], at[:, None] - at
        K = DISPLACEMENT**2 + ROTATION**2 * np.outer(away, away) + sigma**2 * matern(np.abs(apart), LENGTH)
        waves = _waves(at)
        K += (waves * np.tile(gamma, 2)) @ waves.T
        return np.asarray(K + (wrong * self._errors) @ wrong.T + np.diag(self._places[:, 2]))

    def _likelihood(self, sigma: float, gamma: Array) -> tuple[float, Array, Array]:
        """Log likelihood of what was felt but for a constant, the covariance's inverse, and the latter times values."""
        K, value = self._covariance(sigma, gamma), self._places[:, 1]
        inverse = np.asarray(np.linalg.inv(K), dtype=float)
        weights = inverse @ value
        size = float(np.linalg.slogdet(K)[1])
        return -0.5 * (float(value @ weights) + size), inverse, weights

    def _learn(self) -> None:
        """One step: another size of the shape that is no wave, and other variances of some waves."""
        best, inverse, weights = self._likelihood(self._sigma, self._gamma)
        self._turn += 1
        sigma = float(np.clip(self._sigma * (0.5 if self._turn % 2 else 2.0), SMOOTHEST, ROUGHEST))
        if sigma != self._sigma:
            likelihood, other, others = self._likelihood(sigma, self._gamma)
            if likelihood > best:
                self._sigma, inverse, weights = sigma, other, others
        self._gamma = likelier_variances(self._gamma, _waves(self._places[:, 0]), inverse, weights, LARGEST_WAVE)


def _waves(s: Array) -> Array:
    """Cosines and sines of all waves at arc lengths ``(m,)`` [m], ``(m, 2 waves)``."""
    phase = 2 * np.pi / WAVELENGTHS * s[:, None]
    return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
