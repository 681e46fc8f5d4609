"""The polynomial of a field: exact where it must be, honest covariance, outliers dropped."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sensing.camera.line_polynomial import fit_line_polynomial, fit_of_lowest_order
from sensing.sensing_error import SensingError

S = np.linspace(0.42, 0.51, 5)
SIGMA = np.full(5, 2e-5)


@given(c=st.tuples(st.floats(-0.01, 0.01), st.floats(-0.1, 0.1), st.floats(-1.0, 1.0)))
def test_exact_points_give_the_exact_polynomial(c: tuple[float, float, float]) -> None:
    def truth(s: np.ndarray) -> np.ndarray:
        return c[0] + c[1] * (s - 0.4) + c[2] * (s - 0.4) ** 2

    fit = fit_line_polynomial(S, truth(S), SIGMA)
    at = np.linspace(0.40, 0.53, 30)
    np.testing.assert_allclose(fit.deviation(at)[0], truth(at), atol=1e-9)
    np.testing.assert_allclose(fit.slope(at), c[1] + 2 * c[2] * (at - 0.4), atol=1e-7)
    assert fit.used.all()


def test_covariance_is_that_of_repeated_fits() -> None:
    rng = np.random.default_rng(4)
    sigma = np.array([1, 2, 1, 3, 1]) * 2e-5
    at = np.array([0.40, 0.45, 0.50, 0.55])
    values = []
    for _ in range(2000):
        fit = fit_line_polynomial(S, 0.003 + sigma * rng.standard_normal(5), sigma, outlier=100.0, shape_noise=0.0)
        values.append(fit.deviation(at)[0])
    np.testing.assert_allclose(np.std(values, axis=0), fit.deviation(at)[1], rtol=0.06)
    # Extrapolating costs.
    assert fit.deviation(at)[1][3] > 3 * fit.deviation(at)[1][1]


@pytest.mark.parametrize("bad", range(5))
def test_one_wrong_point_is_dropped(bad: int) -> None:
    rng = np.random.default_rng(bad)
    d = 0.002 + 0.02 * (S - 0.45) + SIGMA * rng.standard_normal(5)
    d[bad] += 0.0008
    fit = fit_line_polynomial(S, d, SIGMA, degree=1)
    assert fit.used.tolist() == [i != bad for i in range(5)]
    assert fit.deviation(np.array([0.45]))[0][0] == pytest.approx(0.002, abs=6e-5)


def test_missing_points_lower_the_degree() -> None:
    d = np.array([np.nan, 0.001, np.nan, 0.002, np.nan])
    fit = fit_line_polynomial(S, d, SIGMA)
    assert len(fit.coefficients) == 2
    assert fit.span == pytest.approx((S[1], S[3]))
    np.testing.assert_allclose(fit.deviation(S[[1, 3]])[0], [0.001, 0.002], atol=1e-12)


def test_order_does_not_matter() -> None:
    order = np.array([3, 0, 4, 1, 2])
    d = np.array([1.0, 1.2, 0.9, 1.1, 1.05]) * 1e-3
    a, b = fit_line_polynomial(S, d, SIGMA), fit_line_polynomial(S[order], d[order], SIGMA)
    np.testing.assert_allclose(a.coefficients, b.coefficients, atol=1e-12)
    assert a.used[order].tolist() == b.used.tolist()


def test_one_point_is_no_line() -> None:
    with pytest.raises(SensingError, match="two points"):
        fit_line_polynomial(S, np.array([0.001, *[np.nan] * 4]), SIGMA)


def test_a_cubic_through_the_line_itself_misses_it_and_the_deviation_does_not() -> None:
    """Why the deviation is fitted: five exact points of a curve of 81 mm least radius, over 167 mm."""
    def curve(s: np.ndarray) -> np.ndarray:
        return 0.05 * np.sin(2 * np.pi * s / 0.4)

    s, at = np.linspace(0.0, 0.167, 5), np.linspace(0.0, 0.167, 100)
    direct = fit_line_polynomial(s, curve(s), np.full(5, 1e-6), degree=3, outlier=1e9, shape_noise=0.0)
    reference = 1.02 * curve(at)
    deviation = fit_line_polynomial(s, -0.02 * curve(s), np.full(5, 1e-6), degree=3, outlier=1e9, shape_noise=0.0)
    missed = np.abs(direct.deviation(at)[0] - curve(at)).mean()
    kept = np.abs(reference + deviation.deviation(at)[0] - curve(at)).mean()
    assert missed > 1e-4
    assert kept < 0.03 * missed


def test_the_order_is_the_lowest_whose_residual_is_noise() -> None:
    rng = np.random.default_rng(5)
    straight = [fit_of_lowest_order(S, 0.002 + 0.03 * (S - 0.46) + SIGMA * rng.standard_normal(5), SIGMA)
                for _ in range(300)]
    # One in a hundred is refused by chance; the sigma assumed is a little larger than the noise.
    assert sum(len(fit.coefficients) == 2 for fit in straight) >= 294
    bent = [fit_of_lowest_order(S, 0.002 + 0.5 * (S - 0.46) ** 2 + SIGMA * rng.standard_normal(5), SIGMA)
            for _ in range(300)]
    assert sum(len(fit.coefficients) >= 3 for fit in bent) >= 294


def test_coefficients_are_the_stated_combination_of_the_points() -> None:
    d = 0.002 + SIGMA * np.random.default_rng(6).standard_normal(5)
    d[3] += 0.002
    fit = fit_line_polynomial(S, d, SIGMA, degree=1)
    assert not fit.used[3]
    np.testing.assert_allclose(fit.combination @ d, fit.coefficients, rtol=1e-12)
    assert not fit.combination[:, 3].any()
