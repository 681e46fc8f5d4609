"""A field as one measurement: value and slope of its polynomial, unbiased whatever its order, as sure as they say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from ideal_robot.errors import InputError
from planning.line.deviation_model import PathDeviation
from planning.line.fusion import DeviationFilter
from planning.line.measurement import Measurement, polynomial_measurement
from tests.planning.cell import reference

NOISE, COMMON, YAW = 3e-5, 4e-5, 0.002
AHEAD = np.linspace(0.03, 0.12, 5)


def field(t: float, s: np.ndarray, value: np.ndarray, sigma: float = NOISE) -> Measurement:
    covariance = sigma**2 * np.eye(len(s)) + COMMON**2
    return Measurement(t, s, value, covariance, bias=np.column_stack([s - s.mean() + 0.07]))


def model() -> PathDeviation:
    # All of the path lies in the window, so that the state to compare with stays the same one.
    return PathDeviation(reference(), ahead=0.5, behind=0.05, knot=0.04)


def test_value_and_slope_in_the_middle_of_the_field() -> None:
    s = 0.2 + AHEAD
    measured, polynomial = polynomial_measurement(field(0.0, s, 0.004 - 0.03 * (s - 0.275)))
    assert polynomial.centre == pytest.approx(0.275)
    np.testing.assert_allclose(measured.value, [0.004, -0.03], atol=1e-12)
    # Five even points: a fifth of the variance for the mean, σ²/Σ(s - s_0)² for the slope; what they share adds to
    # the mean.
    expected = np.diag([NOISE**2 / 5 + COMMON**2, NOISE**2 / np.sum((s - 0.275) ** 2)])
    np.testing.assert_allclose(measured.covariance, expected, rtol=1e-9, atol=1e-16)
    np.testing.assert_allclose(measured.bias, [[0.07], [1.0]], atol=1e-12)


def test_an_order_too_low_for_the_line_leaves_no_bias_in_the_map() -> None:
    """A bend that single fields cannot tell from noise, and all of them together can."""
    rng = np.random.default_rng(1)
    fusion = DeviationFilter(model())

    def bent(s: np.ndarray) -> np.ndarray:
        return 0.003 + 0.05 * (s - 0.25) ** 2

    orders = []
    for k in range(400):
        s = 0.3 * (k % 50) / 50 + AHEAD
        measured, polynomial = polynomial_measurement(field(0.02 * k, s, bent(s) + 1e-4 * rng.standard_normal(5), 1e-4))
        orders.append(len(polynomial.coefficients) - 1)
        fusion.update(measured)
    assert orders.count(1) > 380
    where = np.linspace(0.08, 0.35, 28)
    # A straight line through the points passes 0.05 mm beside the bend in their middle, in every field the same way.
    assert abs(np.mean(fusion.mean(where)[:, 0] - bent(where))) < 1e-5


def test_innovations_and_errors_are_as_large_as_the_filter_says() -> None:
    """Late and unordered fields of 60 lines drawn from the prior, with a camera turned by an unknown angle."""
    nis = dof = nees = count = 0.0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        deviation, fusion = model(), DeviationFilter(model(), biases={"camera": (YAW,)}, gate=20.0, significance=1e-9)
        x, P = deviation.prior()
        truth = rng.multivariate_normal(x, P)
        yaw = YAW * rng.standard_normal()
        for k in rng.permutation(20):
            s = 0.014 * k + AHEAD + rng.normal(0.0, 1e-3, 5)
            exact = field(0.02 * float(k), s, deviation.basis(s)[:, 0] @ truth)
            value = exact.value + yaw * exact.bias[:, 0] + NOISE * rng.normal(size=5) + COMMON * rng.normal()  # type: ignore[index]
            fused = fusion.update(polynomial_measurement(field(exact.t, s, value))[0])
            assert fused.dof == 2
            nis, dof = nis + fused.nis, dof + fused.dof
        where = np.array([0.05, 0.2, 0.35])
        H = deviation.basis(where)[:, 0]
        error = H @ (fusion.state - truth)
        spread = H @ fusion._track.kf.P[: deviation.size, : deviation.size] @ H.T
        nees, count = nees + float(error @ np.linalg.solve(spread, error)), count + 3
    assert chi2.ppf(0.025, dof) < nis < chi2.ppf(0.975, dof)
    assert chi2.ppf(0.025, count) < nees < chi2.ppf(0.975, count)


def test_order_of_fields_does_not_matter() -> None:
    rng = np.random.default_rng(2)
    fields = [polynomial_measurement(field(0.02 * k, 0.014 * k + AHEAD, 0.004 + NOISE * rng.normal(size=5)))[0]
              for k in range(8)]
    straight, mixed = DeviationFilter(model()), DeviationFilter(model())
    for k in range(8):
        straight.update(fields[k])
        mixed.update(fields[(5 * k + 3) % 8])
    where = np.linspace(0.0, 0.3, 20)
    np.testing.assert_allclose(straight.mean(where), mixed.mean(where), rtol=1e-5, atol=1e-10)


def test_value_and_slope_count_together_or_not_at_all() -> None:
    fusion = DeviationFilter(model(), confirm=0)
    for k in range(8):
        s = 0.014 * k + AHEAD
        fusion.update(polynomial_measurement(field(0.02 * k, s, np.full(5, 0.004)))[0])
    wrong = polynomial_measurement(field(0.2, AHEAD + 0.1, 0.004 + 0.05 * (AHEAD - 0.075)))[0]
    before = fusion.state.copy()
    fused = fusion.update(wrong)
    assert fused.dof == 0
    assert fused.used.tolist() == [False, False]
    np.testing.assert_array_equal(fusion.state, before)


def test_a_combination_of_another_shape_is_refused() -> None:
    measured = Measurement(0.0, AHEAD, np.zeros(2), np.eye(2), combination=np.ones((2, 4)))
    with pytest.raises(InputError, match="combination"):
        DeviationFilter(model()).update(measured)
