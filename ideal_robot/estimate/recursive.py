r"""The linear Gaussian estimator in recursive form, compiled, for use in a control cycle.

Parameters are in units of their prior standard deviations, so that the prior is :math:`x \sim N(0, 1)` as that of the
batch (``ideal_robot.estimate.gaussian`` with the unit matrix as precision). They change in time by **process noise**
that keeps the prior (an Ornstein-Uhlenbeck process of time constant T):

.. math:: x \leftarrow a x + w, \qquad w \sim N(0, 1 - a^2), \qquad a = e^{-t/T}.

So their uncertainty grows back to that of the prior, never beyond. A measurement :math:`y = h^T x + v`, :math:`v \sim
N(0, R)`, updates mean and covariance by Kalman's equations,

.. math:: K = P h / (h^T P h + R), \qquad x \leftarrow x + K (y - h^T x), \qquad P \leftarrow P - K h^T P.

It is used if it lies within ``GATE`` standard deviations of the prior's prediction, :math:`y^2 < GATE^2 (R + h^T h)`.
Without process noise the result is the batch's.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.jit import jit

GATE = 4.0
"""Standard deviations within which measurements are used and parameters stay; by chance one in 16,000 is beyond."""


def correlation(spacing: float, time_constant: float) -> float:
    """Correlation a of parameters with themselves ``spacing`` later, both times in [s]."""
    return float(np.exp(-spacing / time_constant))


@jit()
def predict(mean: Array, covariance: Array, correlation: float) -> None:
    """Advances mean and covariance of the parameters in time, by their process noise.

    Args:
        mean, covariance: of the parameters ``(p,)`` and ``(p, p)``, both written to.
        correlation: a, over that time.
    """
    square = correlation * correlation
    for a in range(len(mean)):
        mean[a] *= correlation
        for b in range(len(mean)):
            covariance[a, b] *= square
        covariance[a, a] += 1.0 - square


@jit()
def update(mean: Array, covariance: Array, h: Array, y: float, variance: float) -> bool:
    """Fuses one measurement; returns False, and changes nothing, where it contradicts the prior.

    Args:
        mean, covariance: of the parameters ``(p,)``, within ``GATE``, and ``(p, p)``; both are written to.
        h, y: columns ``(p,)`` and measurement.
        variance: of the measurement's noise.
    """
    expected, innovation, spread, gain = variance, y, variance, np.zeros(len(h))
    for a in range(len(h)):
        expected += h[a] * h[a]
    if not y * y < GATE * GATE * expected:
        return False
    for b in range(len(h)):
        if h[b] != 0.0:  # few of all parameters appear in one measurement
            innovation -= h[b] * mean[b]
            for a in range(len(h)):
                gain[a] += covariance[b, a] * h[b]
    for a in range(len(h)):
        spread += h[a] * gain[a]
    for a in range(len(h)):
        mean[a] = min(max(mean[a] + gain[a] * innovation / spread, -GATE), GATE)
        for b in range(len(h)):
            covariance[a, b] -= gain[a] * gain[b] / spread
    return True


def marginal(mean: Array, covariance: Array, places: Array) -> tuple[Array, Array]:
    """Mean and covariance with some parameters kept; the others are reset to their prior.

    Args:
        mean, covariance: of the parameters ``(n, p)`` and ``(n, p, p)``.
        places: of the parameters that are kept ``(k,)``.
    """
    values, uncertain = np.zeros_like(mean), np.tile(np.eye(mean.shape[1]), (len(mean), 1, 1))
    values[:, places] = mean[:, places]
    uncertain[:, places[:, None], places] = covariance[:, places[:, None], places]
    return values, uncertain
