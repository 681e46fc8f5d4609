"""Laws of all line detectors, and lines in whole pictures of which nothing is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from sensing import SensingError
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import DETECTORS, LineDetector
from sensing.camera.line_detection import LineField
from sensing.camera.line_polynomial import Polyline, fit_line_polynomial, fit_of_lowest_order
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows
from sensing.camera.opencv_detector import OpenCVProfiles
from sensing.camera.picture_line import detect_in_picture
from tests.sensing.camera.synthetic import NORMAL, drawn_line, make_field, stroke

CAMERA = CameraModel.default()
ALL = [implementation() for _, implementation in DETECTORS]
X = np.linspace(0.02, 0.11, 5)


def _predicted(offset: float) -> PredictedLine:
    y, slope = 0.02 * np.sin(12.0 * X + 0.3) - 0.006, 0.24 * np.cos(12.0 * X + 0.3)
    tangents = np.column_stack([np.ones_like(X), slope, 0.0 * X])
    return PredictedLine(np.column_stack([X, y + offset, 0.0 * X]),
                         tangents / np.linalg.norm(tangents, axis=1, keepdims=True), NORMAL, 0.001)


@pytest.mark.parametrize("detector", ALL, ids=lambda one: one.name)
def test_points_lie_on_the_line_and_sigma_is_honest(detector: LineDetector) -> None:
    line = stroke(lambda x: 0.02 * np.sin(12.0 * x + 0.3) - 0.006, lambda x: 0.24 * np.cos(12.0 * x + 0.3))
    prediction, settings = _predicted(0.0008), DetectionSettings()
    errors, sigmas = [], []
    for seed in range(30):
        field = make_field(CAMERA, search_windows(CAMERA, prediction), line, np.random.default_rng(seed), 3.0)
        found = detector.detect(field, CAMERA, prediction, settings)
        assert found.seen
        p = found.points_tcp[found.used]
        errors.append((p[:, 1] - 0.02 * np.sin(12.0 * p[:, 0] + 0.3) + 0.006) / np.hypot(1.0, 0.24))
        sigmas.append(found.sigma[found.used])
    spread = np.sqrt(np.mean(np.concatenate(errors) ** 2))
    assert spread < 4e-5
    assert 0.3 < spread / np.sqrt(np.mean(np.concatenate(sigmas) ** 2)) < 2.0


@pytest.mark.parametrize("detector", ALL, ids=lambda one: one.name)
def test_nothing_is_seen_where_nothing_is(detector: LineDetector) -> None:
    prediction = _predicted(0.0)
    field = make_field(CAMERA, search_windows(CAMERA, prediction), lambda xy: 200.0 + 0.0 * xy[:, 0],
                       np.random.default_rng(1), 5.0)
    found = detector.detect(field, CAMERA, prediction, DetectionSettings())
    assert not found.seen
    assert found.reason
    assert not found.used.any()


def test_three_points_that_agree_by_chance_are_refused_where_a_fourth_contradicts_them() -> None:
    """Edges of shadow 2.4, 0.3 and 3.3 mm beside the line; a straight line through them passes within a tolerance."""
    prediction = PredictedLine(np.column_stack([X, 0.0 * X, 0.0 * X]), np.tile([1.0, 0.0, 0.0], (5, 1)), NORMAL, 0.001)
    beside = np.array([-0.0024, np.nan, 0.0003, 0.0, 0.0033])

    def seen_of(places: np.ndarray) -> LineField:
        def gray(xy: np.ndarray) -> np.ndarray:
            place = places[np.abs(xy[:, :1] - X).argmin(axis=1)]
            return np.where(np.abs(xy[:, 1] - place) < 0.0015, 40.0, 200.0)

        field = make_field(CAMERA, search_windows(CAMERA, prediction), gray, np.random.default_rng(1), 2.0)
        return OpenCVProfiles().detect(field, CAMERA, prediction, DetectionSettings())

    contradicted = seen_of(beside)
    assert np.isfinite(contradicted.lateral).sum() == 4
    assert contradicted.used.sum() == 3
    assert not contradicted.seen
    assert "1 against" in contradicted.reason
    assert seen_of(np.array([0.0, np.nan, 0.0003, np.nan, 0.0])).seen


@pytest.mark.parametrize("detector", ALL, ids=lambda one: one.name)
@pytest.mark.parametrize(("dark", "width", "upright"), [(True, 8.0, False), (False, 8.0, True), (True, 3.0, True),
                                                        (False, 25.0, False)])
def test_width_polarity_and_place_are_found(detector: LineDetector, dark: bool, width: float, upright: bool) -> None:
    """Uneven light, a scratch across, noise; the polynomial keeps within half a pixel of the truth."""
    gray, truth = drawn_line(dark=dark, width=width, upright=upright, seed=3)
    found = detect_in_picture(gray, detector)
    assert found.found, found.reason
    assert found.rough is not None
    assert found.rough.dark == dark
    assert abs(found.rough.width - width) < 0.15 * width + 1.0
    curve = found.curve()
    s, across = (curve[:, 1], curve[:, 0]) if upright else (curve[:, 0], curve[:, 1])
    assert np.mean(np.abs(across - truth(s))) < 0.2
    assert np.max(np.abs(across - truth(s))) < 0.7


def test_a_picture_without_a_line_is_refused_with_a_reason() -> None:
    noise = np.clip(128 + 8 * np.random.default_rng(0).standard_normal((240, 320)), 0, 255).astype(np.uint8)
    blob = np.full((240, 320), 200, np.uint8)
    blob[80:160, 100:200] = 40
    for gray in (noise, blob, np.zeros((100, 100), np.uint8)):
        found = detect_in_picture(gray, ALL[0])
        assert not found.found
        assert found.reason


def test_what_is_no_picture_is_refused() -> None:
    with pytest.raises(InputError, match="gray picture"):
        detect_in_picture(np.zeros((4, 4), np.uint8), ALL[0])
    with pytest.raises(InputError, match="five points"):
        detect_in_picture(np.zeros((64, 64), np.uint8), ALL[0], points=2)


# The polynomial of a field: exact where it must be, honest covariance, outliers dropped.

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


# Nearest points on a polyline against brute force and against a circle.

UP = np.array([0.0, 0.0, 1.0])


@given(seed=st.integers(0, 2**32 - 1))
def test_distance_is_the_least_over_all_segments(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.linspace(0.0, 1.0, 400)
    points = np.column_stack([x, 0.1 * np.sin(5 * x + rng.uniform(0, 6)), 0.05 * np.cos(3 * x)])
    line = Polyline(points)
    queries = points[rng.integers(0, 400, 30)] + rng.normal(0.0, 0.02, (30, 3))
    a, d = points[:-1], np.diff(points, axis=0)
    along = np.clip(np.einsum("mkj,kj->mk", queries[:, None] - a, d) / np.sum(d**2, axis=1), 0.0, 1.0)
    brute = np.linalg.norm(queries[:, None] - a - along[..., None] * d, axis=2).min(axis=1)
    np.testing.assert_allclose(line.nearest(queries, UP).distance, brute, atol=2e-6)


def test_circle() -> None:
    angle = np.linspace(0.0, np.pi, 4000)
    line = Polyline(0.1 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]))
    assert line.length == pytest.approx(0.1 * np.pi, rel=1e-6)
    at = np.linspace(0.3, 2.8, 40)
    radius = np.where(np.arange(40) % 2, 0.103, 0.094)
    found = line.nearest(radius[:, None] * np.column_stack([np.cos(at), np.sin(at), 0.0 * at]), UP)
    # Travelled counter-clockwise, the centre is on the left.
    np.testing.assert_allclose(found.lateral, 0.1 - radius, atol=1e-7)
    np.testing.assert_allclose(found.distance, np.abs(0.1 - radius), atol=1e-7)
    # Feet stay away from a corner's inside and gather at its outside: by the offset times half the corner's angle.
    np.testing.assert_allclose(found.s, 0.1 * at, atol=0.5 * 0.006 * np.pi / 3999 * 1.01)
    points, tangents = line.at(found.s)
    np.testing.assert_allclose(points, found.foot, atol=1e-9)
    np.testing.assert_allclose(tangents[:, 0], -np.sin(at), atol=1e-3)


def test_beyond_its_ends_a_polyline_is_clipped() -> None:
    line = Polyline(np.array([[0.0, 0, 0], [1.0, 0, 0]]))
    found = line.nearest(np.array([[-0.3, 0.4, 0.0], [2.0, 0.0, 0.0]]), UP)
    np.testing.assert_allclose(found.distance, [0.5, 1.0])
    np.testing.assert_allclose(found.s, [0.0, 1.0])
    np.testing.assert_allclose(line.at(np.array([-1.0, 5.0]))[0], [[0, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize("points", [[[0, 0, 0]], [[0, 0, 0], [0, 0, 0]], [[0, 0], [1, 0]]])
def test_no_line(points: list[list[float]]) -> None:
    with pytest.raises(InputError, match=r"line\.points"):
        Polyline(np.array(points, dtype=float))
