"""The score of a model: its log predictive density for blocks of time, each given the earlier ones.

With A_b = Λ + Σ X'X over the first b blocks and Λ the prior precision of the parameters,

    ln p(y_1 … y_b) = −½ [ y'y − y'X A_b⁻¹ X'y + ln|A_b| − ln|Λ| ]        (up to a constant),

in closed form from the products of columns, and ln p(y_b | blocks before) is the share of block b. The sum does not
depend on the order. Cross-validation, each block given all others, would not do: it ignores priors that almost exclude
a parameter, so that sets could not be distinguished by their priors.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.estimate.gaussian import Posterior, posterior
from ideal_robot.tolerances import PRODUCTS

TOLD = 2.0
"""Standard deviations from which on two things are distinguished: 95 % of a normal distribution."""
CLEAR = 3.0
"""The same where no more is claimed than what is beyond doubt, 99.7 %."""


def evidence(products: Array, precision: Array) -> float:
    """Log marginal likelihood of all rows: the parameters are integrated out.

    Args:
        products: ``[X, y]' [X, y]`` of whitened rows ``(P + 1, P + 1)``.
        precision: prior precision of the parameters about zero ``(P, P)``; directions without a prior add nothing, so
            only sets with the same such directions are comparable.
    """
    return evidence_of(posterior(products, precision), products, precision)


def evidence_of(fitted: Posterior, products: Array, precision: Array) -> float:
    """Log marginal likelihood as ``evidence``, from a posterior that is already computed.

    Args:
        fitted: posterior of the parameters, given the products and the precision.
        products, precision: see ``evidence``.
    """
    left = products[-1, -1] - products[:-1, -1] @ fitted.mean
    return float(-0.5 * (left + fitted.logarithm - _log_determinant(precision)))


def _log_determinant(precision: Array) -> float:
    """Logarithm of the determinant over what is known at all."""
    own = np.diag(precision)
    known = own > 0.0
    if not known.any():
        return 0.0
    scale = 1.0 / np.sqrt(own[known])
    scaled = precision[np.ix_(known, known)] * np.outer(scale, scale)
    sign, logarithm = np.linalg.slogdet(scaled + 10.0 * PRODUCTS * np.eye(int(known.sum())))
    return float(logarithm - 2.0 * np.log(scale).sum()) if sign > 0 else 0.0


def standard_error(difference: Array) -> float:
    """Standard error of a sum over blocks ``(B,)``, from their scatter."""
    return float(np.std(difference, ddof=1) * np.sqrt(len(difference))) if len(difference) > 1 else float("inf")


BLOCKS = 20
"""Of time, by whose scatter two predictions are compared."""


def leaves_less(one: Array, other: Array) -> bool:
    """Whether a prediction's residual is smaller than another one's, by two standard errors over blocks of time.

    Args:
        one, other: residuals at the same instants, in the order of time ``(N, …)``.
    """
    gain = np.array([np.sum(part) for part in np.array_split(other**2 - one**2, BLOCKS)])
    return float(gain.sum()) > 2.0 * standard_error(gain)
