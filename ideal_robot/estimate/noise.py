"""Coloured noise of one channel as an autoregression: its fit, its innovations, its spectrum at zero.

A channel's residual is coloured by filters, vibrations, and errors of the model class. An autoregression of order p,

    e_t = a_1 e_{t-1} + … + a_p e_{t-p} + v_t ,      v_t white,

turns rows into independent innovations. It is estimated from the autocovariance by Levinson's and Durbin's recursion,
which gives all lower orders too; an interval of used rows begins with these, so that no row before a gap is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array

ORDER = 4
"""Order of the autoregression. Orders 1 to 10 name the same causes in 48 recordings of a fourth engine."""
PASSES = 2
"""Iterations of expectation and maximisation, from white noise. Where there are hardly more rows than columns, further
iterations would follow the noise's own prediction of what the columns hide."""
_LARGEST_REFLECTION = 0.98
"""Of a partial autocorrelation: noise that lasts longer is drift, of which a recording holds too few periods."""
_OUTLIER = 5.0
"""Innovations beyond so many robust standard deviations are kicks: once in 1.7 million of a normal distribution."""


@dataclass(frozen=True)
class Free:
    """Columns with free coefficients: what a residual has along them may be signal, so it is no evidence of noise.

    Attributes:
        columns: orthonormal ``(N, k)``, zero in rows that are not used.
        products: of the columns with themselves shifted by 0 to p rows ``(k, k)`` each.
    """

    columns: Array
    products: tuple[Array, ...]

    @classmethod
    def of(cls, columns: Array, order: int = ORDER) -> Free:
        """The columns, orthonormal ``(N, k)``, with their products for autoregressive noise of an order."""
        pairs = (_apart(columns, lag) for lag in range(order + 1))
        return cls(columns, tuple(later.T @ earlier for later, earlier in pairs))


@dataclass(frozen=True)
class ColouredNoise:
    """Autoregressive noise of one channel.

    Attributes:
        predictors: of orders 0 to p ``(p + 1, p)``; row o predicts from the o values before.
        variance: of the innovations of each order ``(p + 1,)``, in the square of the channel's unit.
    """

    predictors: Array
    variance: Array

    @classmethod
    def fit(cls, residual: Array, use: np.ndarray, order: int = ORDER) -> ColouredNoise:
        """Fits the noise of a residual.

        Args:
            residual: of the channel ``(N,)``, in its unit.
            use: rows of it that are used ``(N,)``.
            order: of the autoregression.
        """
        values = np.where(use, residual, 0.0)
        return cls._of_products(np.array([np.vdot(*_apart(values, lag)) for lag in range(order + 1)]), use)

    @classmethod
    def beside(cls, residual: Array, use: np.ndarray, free: Free) -> ColouredNoise:
        """The noise in a residual beside signals that columns with free coefficients describe.

        A fit of the columns removes a part of the noise with the signal. Columns are mostly slow, so the remaining
        residual alone would show too little slow noise, and slow causes would seem too certain. So the average of the
        removed part is added, by the covariance of the fitted coefficients. That maximises the restricted likelihood
        (REML), by expectation and maximisation from white noise.

        Args:
            residual: of the channel ``(N,)``, in its unit; what of it is along the columns makes no difference.
            use: rows of it that are used ``(N,)``.
            free: the columns.
        """
        columns, lags = free.columns, range(len(free.products))
        values = np.where(use, residual, 0.0)
        values = values - columns @ (columns.T @ values)
        level = max(float(values @ values) / max(float(use.sum()) - columns.shape[1], 1.0), 1e-300)
        noise = cls.of_autocovariance(level * (np.arange(len(lags)) == 0))
        along = [later.T @ before + earlier.T @ after for (later, earlier), (after, before) in
                 ((_apart(columns, lag), _apart(values, lag)) for lag in lags)]
        for _ in range(PASSES):
            precision, across = np.zeros_like(free.products[0]), np.zeros(columns.shape[1])
            for weight, products, own in zip(noise.band, free.products, along, strict=True):
                precision += weight * (products + products.T)
                across += weight * own
            precision[np.diag_indices(len(precision))] *= 1.0 + 1e-9
            covariance = np.linalg.inv(precision)
            left = values - columns @ (covariance @ across)
            noise = cls._of_products(np.array([np.vdot(*_apart(left, lag)) + np.vdot(covariance, free.products[lag])
                                               for lag in lags]), use)
        return noise

    @classmethod
    def _of_products(cls, products: Array, use: np.ndarray) -> ColouredNoise:
        """The noise of which used rows have these sums of products at lags 0 to p ``(p + 1,)``."""
        used = use.astype(float)
        pairs = np.array([np.vdot(*_apart(used, lag)) for lag in range(len(products))])
        # Few pairs of samples at a lag determine its correlation poorly, so it is shrunk towards zero.
        order = len(products) - 1
        return cls.of_autocovariance(products / np.maximum(pairs + order * (np.arange(order + 1) > 0), 1.0))

    @classmethod
    def of_autocovariance(cls, covariance: Array) -> ColouredNoise:
        """Noise with a given autocovariance at lags 0 to p ``(p + 1,)``, in the square of the channel's unit."""
        p = len(covariance) - 1
        predictors, variance = np.zeros((p + 1, p)), np.zeros(p + 1)
        variance[0] = max(float(covariance[0]), 1e-300)
        for k in range(1, p + 1):
            before = predictors[k - 1, : k - 1]
            reflection = (covariance[k] - before @ covariance[1:k][::-1]) / variance[k - 1]
            reflection = float(np.clip(reflection, -_LARGEST_REFLECTION, _LARGEST_REFLECTION))
            predictors[k, : k - 1] = before - reflection * before[::-1]
            predictors[k, k - 1] = reflection
            variance[k] = variance[k - 1] * (1.0 - reflection**2)
        return cls(predictors, variance)

    @property
    def order(self) -> int:
        """Order of the autoregression."""
        return self.predictors.shape[1]

    @property
    def std(self) -> float:
        """Standard deviation of the noise, in the channel's unit."""
        return float(np.sqrt(self.variance[0]))

    @property
    def colour(self) -> float:
        """Number of rows worth one independent row in a slow mean: spectrum at zero over the variance."""
        return float(self.variance[-1] / self.variance[0] / max(1.0 - self.predictors[-1].sum(), 1e-3) ** 2)

    @property
    def band(self) -> Array:
        """Weights ``w (p + 1,)`` of the precision of rows, Σ_k w_k (S_k + S_k') with shifts S_k by k rows."""
        filtered = np.concatenate([[1.0], -self.predictors[-1]])
        band = np.array([np.vdot(*_apart(filtered, lag)) for lag in range(len(filtered))]) / self.variance[-1]
        band[0] *= 0.5
        return band

    def autocovariance(self, lags: int) -> Array:
        """Autocovariance ``(lags + 1,)`` of the noise, in the square of its unit (Yule and Walker)."""
        result = np.zeros(lags + 1)
        result[0] = self.variance[0]
        for k in range(1, lags + 1):
            order = min(k, self.order)
            result[k] = self.predictors[order, :order] @ result[k - 1 :: -1][:order]
        return result

    def scaled(self, factor: float) -> ColouredNoise:
        """The same noise with its standard deviation multiplied by ``factor``."""
        return ColouredNoise(self.predictors, self.variance * factor**2)

    def whiten(self, values: Array, use: np.ndarray) -> Array:
        """Innovations of rows in units of their standard deviation; zero where a row is not used.

        Args:
            values: a residual ``(N,)``, or columns ``(N, m)``.
            use: rows that are used ``(N,)``; each interval of them starts anew.
        """
        order = np.minimum(position_in_stretch(use), self.order)
        used = np.flatnonzero(order >= 0)
        rows, order = values[used], order[used]
        columns = rows if rows.ndim > 1 else rows[:, None]
        result = columns.copy()
        for lag in range(1, self.order + 1):
            weight = self.predictors[order, lag - 1]
            result[lag:] -= weight[lag:, None] * columns[:-lag]
        result /= np.sqrt(self.variance[order])[:, None]
        out = np.zeros((len(values), columns.shape[1]))
        out[used] = result
        return out if values.ndim > 1 else out[:, 0]


def _apart(values: Array, lag: int) -> tuple[Array, Array]:
    """Rows ``(N - lag, …)`` and those before them by a lag."""
    return values[lag:], values[: len(values) - lag]


def position_in_stretch(use: np.ndarray) -> np.ndarray:
    """Index of each row in its interval of used rows, from 0; -1 where it is not used ``(N,)``."""
    count = np.arange(len(use))
    last_gap = np.maximum.accumulate(np.where(use, -1, count))
    return np.where(use, count - last_gap - 1, -1)


def without_kicks(innovations: Array, use: np.ndarray) -> np.ndarray:
    """Mask of rows whose innovation is no outlier ``(N,)``, as noise has heavier tails than a normal distribution.

    Args:
        innovations: of the channel ``(N,)``, in any unit.
        use: rows that are used ``(N,)``.
    """
    used = np.abs(innovations[use])
    if not used.size:
        return use
    return np.asarray(use & (np.abs(innovations) <= _OUTLIER * 1.4826 * np.median(used)))
