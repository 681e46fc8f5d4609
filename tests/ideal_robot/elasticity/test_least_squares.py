"""Least squares with spreads."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.elasticity.least_squares import least_squares
from ideal_robot.errors import InputError


def test_standard_deviations_are_those_of_repeated_experiments() -> None:
    """[J] (15)–(17) on angles that vary by a milliradian about 1.6 rad, as in the paper."""
    rng = np.random.default_rng(0)
    W = np.column_stack([1.62 + 2e-3 * rng.random(200), np.ones(200)])
    true = np.array([6.9e6, -1.1e7])
    fits = [least_squares(W, W @ true + 100 * rng.standard_normal(200)) for _ in range(300)]
    spread = np.std([fit.chi for fit in fits], axis=0)
    np.testing.assert_allclose(np.mean([fit.chi for fit in fits], axis=0), true, rtol=3e-3)
    for covariance in (fits[0].covariance, fits[0].robust):
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)), spread, rtol=0.25)
    np.testing.assert_allclose(fits[0].std_percent, 100 * spread / np.abs(true), rtol=0.25)


def test_correlated_residuals_widen_the_robust_spread() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 1, 1000)
    slopes, robust, white = [], [], []
    for _ in range(200):
        noise = np.repeat(rng.standard_normal(25), 40)
        fit = least_squares(np.column_stack([x, np.ones(1000)]), 2 * x + noise, lag=40)
        slopes.append(fit.chi[0])
        robust.append(fit.robust[0, 0])
        white.append(fit.covariance[0, 0])
    assert np.sqrt(np.mean(robust)) == pytest.approx(np.std(slopes), rel=0.3)
    assert np.sqrt(np.mean(white)) < 0.3 * np.std(slopes)


def test_what_cannot_be_determined_is_said() -> None:
    with pytest.raises(InputError, match="2 samples"):
        least_squares(np.ones((2, 2)), np.ones(2))
    with pytest.raises(InputError, match="does not excite"):
        least_squares(np.ones((9, 2)), np.ones(9))
