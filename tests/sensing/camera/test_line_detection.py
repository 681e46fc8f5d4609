"""Line points of a field: accurate on a clean line, none or rejected where something is in the way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import norm

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning.line.deviation_model import matern
from sensing.camera.camera_device import Field
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_appearance import _ahead_of_the_tool
from sensing.camera.line_detection import (
    DetectionSettings,
    LineField,
    PredictedLine,
    confirmed_points,
    detect_line,
    search_windows,
)
from sensing.camera.line_profile import _edges, _fit_section, find_sections
from tests.sensing.camera.synthetic import CLEAN, GrayAt, X, make_field, predicted, slope, stroke, y

CAMERA = CameraModel.default()
LOOK = DetectionSettings().look


def error(found: LineField) -> Array:
    """Distance of the points from the line ``(m,)`` [m], to first order."""
    p = found.points_tcp
    return np.asarray(np.abs(p[:, 1] - y(p[:, 0])) / np.hypot(1.0, slope(p[:, 0])))


def look(gray: GrayAt, prediction: PredictedLine | None = None, noise: float = 0.0, seed: int = 0,
         settings: DetectionSettings | None = None) -> LineField:
    prediction = predicted(0.0008, 0.01) if prediction is None else prediction
    field = make_field(CAMERA, search_windows(CAMERA, prediction, settings), gray, np.random.default_rng(seed), noise)
    return detect_line(field, CAMERA, prediction, settings)


def with_stroke(second: GrayAt, where: Array | None = None) -> GrayAt:
    """The line and something dark on top of it."""
    return lambda xy: np.minimum(CLEAN(xy), second(xy))


def test_clean_line_to_ten_micrometres() -> None:
    errors = []
    for i in range(20):
        detection = look(CLEAN, predicted(0.0003 * (i % 7 - 3), 0.003 * (i % 5 - 2)))
        assert detection.seen
        assert detection.used.all()
        assert detection.reason == ""
        assert detection.quality.min() > 0.9
        errors.append(error(detection))
    assert np.mean(errors) < 10e-6
    assert np.max(errors) < 40e-6


def test_lateral_is_the_distance_from_the_prediction() -> None:
    detection = look(CLEAN, predicted(0.0007))
    # normal × tangent points to the tool's -y here; the line lies 0.7 mm beside its prediction.
    expected = 0.0007 / np.hypot(1.0, slope(X))
    np.testing.assert_allclose(detection.lateral, expected, atol=3e-5)


def test_line_across_the_image_is_scanned_along_columns() -> None:
    """The tool turned by 90°: the same points, from windows that stand upright."""
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 2), np.array([0.065, -0.065, 0.0]))
    camera = replace(CAMERA, T_tool_camera=turn * CAMERA.T_tool_camera)
    prediction = predicted(0.0005)
    windows = search_windows(camera, prediction)
    assert all(w.height > w.width for w in windows)
    detection = detect_line(make_field(camera, windows, CLEAN), camera, prediction)
    assert detection.used.all()
    assert error(detection).max() < 30e-6


@pytest.mark.parametrize("noise", [3.0, 5.0, 10.0])
def test_gray_noise_and_stated_sigma(noise: float) -> None:
    settings = DetectionSettings(noise=noise)
    lateral, sigma = [], []
    for seed in range(60):
        detection = look(CLEAN, predicted(0.0004), noise, seed, settings)
        lateral.append(error(detection)[detection.used])
        sigma.append(detection.sigma[detection.used])
    scaled = np.concatenate(lateral) / np.concatenate(sigma)
    # Sigma holds a hundredth of a pixel for sampling, which this renderer does not have: it may be too large, by less
    # than a factor of two.
    assert 0.5 < np.sqrt(np.mean(scaled**2)) < 1.3
    assert len(scaled) > 0.97 * 300


def test_gap_leaves_out_its_points() -> None:
    detection = look(lambda xy: np.where(np.abs(xy[:, 0] - X[2]) < 0.006, 200.0, CLEAN(xy)))
    assert detection.used.tolist() == [True, True, False, True, True]
    assert np.isnan(detection.points_tcp[2]).all()
    assert detection.quality[2] == 0.0
    assert detection.seen


@pytest.mark.parametrize("angle", [0.5, 0.9, 1.57, 2.2, 2.7])
def test_crossing_line_harms_no_point_that_is_used(angle: float) -> None:
    worst = 0.0
    for shift in np.linspace(-0.004, 0.004, 9):
        def crossing(xy: Array, shift: float = shift) -> Array:
            d = np.abs((xy[:, 0] - X[2] - shift) * np.sin(angle) - (xy[:, 1] - y(X[2:3])) * np.cos(angle))
            return np.asarray(200.0 - 160.0 * np.clip(0.5 + (0.0015 - d) / 0.001, 0.0, 1.0))

        detection = look(with_stroke(crossing))
        assert detection.seen
        assert detection.used.sum() >= 4 or angle in (0.5, 2.7)
        worst = max(worst, float(error(detection)[detection.used].max()))
    assert worst < 0.25e-3


@pytest.mark.parametrize("offset", [-0.012, -0.009, 0.009, 0.012])
def test_parallel_line_is_not_taken_for_the_line(offset: float) -> None:
    detection = look(with_stroke(stroke(lambda x: y(x) + offset, slope)), predicted(0.0008, 0.01, sigma=0.003))
    assert detection.used.all()
    assert error(detection).max() < 50e-6


def test_a_wrong_line_in_one_window_is_outvoted() -> None:
    """Window 1 shows only a decoy, a short parallel piece 2.5 mm beside the line."""
    decoy = stroke(lambda x: y(x) + 0.0025, slope)
    detection = look(lambda xy: np.where(np.abs(xy[:, 0] - X[1]) < 0.006, decoy(xy), CLEAN(xy)), predicted(sigma=0.002))
    assert detection.used.tolist() == [True, False, True, True, True]
    assert error(detection)[1] == pytest.approx(0.0025 / np.hypot(1.0, slope(X[1])), rel=0.1)
    assert detection.quality[1] > 0.8


def test_scratch_glare_and_shade() -> None:
    def spoiled(xy: Array) -> Array:
        bump = np.clip(1.0 - ((xy[:, 0] - X[1]) ** 2 + (xy[:, 1] - y(X[1:2]) - 0.006) ** 2) / 0.012**2, 0.0, None) ** 2
        shade = np.clip(1.0 - ((xy[:, 0] - X[3]) ** 2 + (xy[:, 1] - y(X[3:4])) ** 2) / 0.03**2, 0.0, None) ** 2
        scratch = np.abs(xy[:, 1] - y(X[4:5]) - 0.5 * (xy[:, 0] - X[4] + 0.01)) < 0.0004
        return np.asarray(np.where(scratch, 240.0, CLEAN(xy) * (1.0 - 0.6 * shade)) + 120.0 * bump)

    detection = look(spoiled, noise=3.0)
    assert detection.seen
    assert detection.used.sum() >= 4
    assert error(detection)[detection.used].max() < 0.2e-3


@pytest.mark.parametrize(("gray", "reason"), [
    (lambda xy: np.full(len(xy), 200.0), "no line of the expected width and contrast"),
    (stroke(y, slope, gray=185.0), "no line of the expected width and contrast"),
    (stroke(y, slope, width=0.008), "no line of the expected width and contrast"),
    (lambda xy: np.where(xy[:, 0] > 0.05, 200.0, CLEAN(xy)), "only 2 of 5 points agree, 3 are needed"),
])  # fmt: skip
def test_too_little_is_no_measurement_and_says_why(gray: GrayAt, reason: str) -> None:
    detection = look(gray, noise=3.0)
    assert not detection.seen
    assert reason in detection.reason


@pytest.mark.parametrize("prediction", [predicted(0.3), replace(predicted(), points=np.column_stack(
    [X, 0.0 * X, 0.0 * X - 0.5]))], ids=["beside", "behind the camera"])
def test_line_outside_the_image(prediction: PredictedLine) -> None:
    windows = search_windows(CAMERA, prediction)
    assert all(w.width == 0 and w.height == 0 for w in windows)
    detection = detect_line(make_field(CAMERA, windows, CLEAN), CAMERA, prediction)
    assert not detection.seen
    assert "outside the image" in detection.reason


def test_partly_outside_the_image() -> None:
    x = np.array([0.03, 0.09, 0.15, 0.2, 0.3])
    detection = look(CLEAN, predicted(x=x))
    assert detection.used.tolist() == [True, True, True, False, False]


def test_windows_grow_with_the_uncertainty() -> None:
    widths = [search_windows(CAMERA, predicted(sigma=s))[0].width for s in (0.0003, 0.002, 0.005, 0.1)]
    assert widths == sorted(widths)
    assert widths[0] < 22
    assert widths[3] == 2 * DetectionSettings().max_half_width + 1


def test_a_better_prediction_than_the_windows_is_allowed() -> None:
    windows = search_windows(CAMERA, predicted(0.003, sigma=0.002))
    detection = detect_line(make_field(CAMERA, windows, CLEAN), CAMERA, predicted(0.0, sigma=0.0005))
    assert detection.used.all()
    assert error(detection).max() < 40e-6


def test_bright_line() -> None:
    detection = look(lambda xy: 240.0 - CLEAN(xy), settings=DetectionSettings(dark=False))
    assert detection.used.all()
    assert error(detection).max() < 40e-6


def test_field_and_prediction_must_match() -> None:
    field = make_field(CAMERA, search_windows(CAMERA, predicted())[:3], CLEAN)
    with pytest.raises(InputError, match="one window per predicted point"):
        detect_line(field, CAMERA, predicted())


def test_settings_are_checked() -> None:
    with pytest.raises(InputError, match=r"detection\.line_width"):
        DetectionSettings(line_width=0.0)


@given(seed=st.integers(0, 2**32 - 1))
def test_whatever_the_picture_shows_the_answer_is_sound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    prediction = predicted(rng.uniform(-0.1, 0.1), rng.uniform(-3, 3), sigma=10 ** rng.uniform(-5, -1))
    windows = search_windows(CAMERA, prediction)
    kinds = (lambda shape: rng.integers(0, 256, shape), lambda shape: np.full(shape, rng.integers(0, 256)),
             lambda shape: 255 * (rng.random(shape) < 0.5),
             lambda shape: 255 * (np.arange(shape[1]) % 5 < 2) + np.zeros(shape))
    patches = tuple(np.asarray(kinds[rng.integers(4)]((w.height, w.width))).astype(np.uint8) for w in windows)
    detection = detect_line(Field(0.0, 0.04, windows, patches), CAMERA, prediction)
    assert detection.seen == (detection.used.sum() >= 3) == (detection.reason == "")
    assert np.isfinite(detection.points_tcp[detection.used]).all()
    assert (detection.sigma[detection.used] > 0).all()
    assert ((detection.quality >= 0) & (detection.quality <= 1)).all()


# A point is held against the line of the other points, not against one that it has drawn itself.

ALONG = np.linspace(0.0, 0.09, 5)
LINE = 2e-4 + 0.01 * ALONG
TOLERANCE = 5e-4
RIGID = np.zeros((5, 5))
"""Covariance of a prediction whose shape is right."""


def test_points_on_a_line_confirm_each_other_whichever_are_there() -> None:
    noise = 1e-4 * np.array([1.0, -1.0, 0.5, -0.5, 1.0])
    for indices in ([0, 1, 2, 3, 4], [0, 3, 4], [0, 2, 4], [1, 2, 3]):
        used = np.isin(np.arange(5), indices)
        assert np.array_equal(confirmed_points(ALONG, LINE + 0.2 * noise, used, TOLERANCE, RIGID), used)


def test_a_wrong_point_far_from_the_others_leaves_no_measurement() -> None:
    """From a field of 10^4 on wood: a streak beside a scratch, alone at one end, 1.6 mm off and within 0.4 mm of the
    straight line through all three."""
    deviation = np.array([-1.324e-3, 0.0, 0.0, 0.289e-3, 0.267e-3])
    used = np.array([True, False, False, True, True])
    fitted = np.polyval(np.polyfit(ALONG[used], deviation[used], 1), ALONG[used])
    assert np.max(np.abs(deviation[used] - fitted)) < TOLERANCE
    # Which of three it is nobody can tell: two are left, too few for a measurement.
    assert confirmed_points(ALONG, deviation, used, TOLERANCE, RIGID).sum() == 2


def test_the_wrong_one_of_five_is_found_wherever_it_is() -> None:
    for i in range(5):
        deviation = LINE.copy()
        deviation[i] += 1.2e-3
        confirmed = confirmed_points(ALONG, deviation, np.ones(5, dtype=bool), TOLERANCE, RIGID)
        assert np.array_equal(np.flatnonzero(~confirmed), [i])


def test_a_line_may_bend_by_what_its_prediction_leaves_open_and_no_more() -> None:
    used = np.ones(5, dtype=bool)
    bent = LINE + 0.5 * 2.5 * ALONG**2  # 4 mm beside the chord's continuation
    assert confirmed_points(ALONG, bent, used, TOLERANCE, RIGID).sum() == 2
    moved = 0.02**2 + 0.05**2 * np.multiply.outer(ALONG, ALONG)
    # However far the whole line may be moved and turned, that says nothing of its shape.
    assert confirmed_points(ALONG, bent, used, TOLERANCE, moved).sum() == 2
    curved = moved + 0.02**2 * matern(np.abs(np.subtract.outer(ALONG, ALONG)), 0.15)
    assert confirmed_points(ALONG, bent, used, TOLERANCE, curved).all()
    bent[2] += 0.02
    assert not confirmed_points(ALONG, bent, used, TOLERANCE, curved)[2]


# One cross-section of a line: found, fitted, and its stated uncertainty honest.

def section(u0: float, width: float, slant: float = 0.0, dark: float = 160.0, tilt: float = 0.0) -> Array:
    """The box itself, blurred by half a pixel, not rounded."""
    u = np.arange(31)[None, :] - u0 - slant * (np.arange(3)[:, None] - 1.0)
    erf = np.vectorize(math.erf)
    box = 0.5 * (erf((u + width / 2) / (0.5 * math.sqrt(2))) - erf((u - width / 2) / (0.5 * math.sqrt(2))))
    return np.asarray(200.0 + tilt * u - dark * box)


def gray(image: Array) -> NDArray[np.uint8]:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@given(u0=st.floats(12.0, 18.0), width=st.floats(2.5, 7.0), slant=st.floats(-1.0, 1.0), tilt=st.floats(-1.0, 1.0))
def test_a_clean_section_is_found_to_a_hundredth_of_a_pixel(u0: float, width: float, slant: float, tilt: float) -> None:
    sections = find_sections(gray(section(u0, width, slant, tilt=tilt)), 15.0, slant, width, LOOK)
    assert len(sections) == 1
    assert sections[0, 0] == pytest.approx(u0, abs=0.01)
    assert sections[0, 1] == pytest.approx(width, abs=0.03)
    assert sections[0, 2] == pytest.approx(160.0, rel=0.02)


@given(u0=st.floats(12.0, 18.0))
def test_bright_line_on_dark_ground(u0: float) -> None:
    sections = find_sections(gray(255.0 - section(u0, 4.0)), 15.0, 0.0, 4.0, DetectionSettings(dark=False).look)
    assert sections[0, 0] == pytest.approx(u0, abs=0.01)
    assert len(find_sections(gray(255.0 - section(u0, 4.0)), 15.0, 0.0, 4.0, LOOK)) == 0


def test_width_and_contrast_gates() -> None:
    accepted = [len(find_sections(gray(section(15.2, w)), 15.0, 0.0, 4.0, LOOK))
                for w in (1.5, 2.4, 2.8, 4.0, 5.2, 5.8, 8.0)]
    assert accepted == [0, 0, 1, 1, 1, 0, 0]
    assert len(find_sections(gray(section(15.2, 4.0, dark=25.0)), 15.0, 0.0, 4.0, LOOK)) == 0
    assert len(find_sections(gray(section(15.2, 4.0, dark=40.0)), 15.0, 0.0, 4.0, LOOK)) == 1


def test_two_lines_give_two_candidates_nearest_to_the_prediction_first() -> None:
    image = section(9.3, 4.0) + section(21.6, 4.0) - 200.0
    for near, order in ((11.0, [9.3, 21.6]), (20.0, [21.6, 9.3])):
        sections = find_sections(gray(image), near, 0.0, 4.0, LOOK)
        np.testing.assert_allclose(sections[:, 0], order, atol=0.02)


@pytest.mark.parametrize("image", [np.full((3, 31), 90), np.zeros((3, 31)), np.full((3, 4), 7), np.zeros((1, 1))])
def test_nothing_to_find(image: Array) -> None:
    assert len(find_sections(gray(image), 1.0, 0.0, 4.0, LOOK)) == 0


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_pure_noise_is_rarely_a_line_and_never_a_crash(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hits = sum(len(find_sections(gray(120 + 10 * rng.standard_normal((3, 31))), 15.0, 0.0, 4.0, LOOK))
               for _ in range(20))
    assert hits <= 1
    find_sections(rng.integers(0, 256, (3, 31)).astype(np.uint8), 15.0, 0.3, 4.0, LOOK)


@pytest.mark.parametrize("noise", [2.0, 5.0, 10.0])
def test_stated_standard_deviation_is_the_true_one(noise: float) -> None:
    rng = np.random.default_rng(1)
    scaled = []
    for _ in range(400):
        u0 = rng.uniform(14.0, 16.0)
        image = section(u0, 4.0, 0.2) + noise * rng.standard_normal((3, 31))
        middle, _, _, residual, spread = _fit_section(gray(image), u0 + rng.uniform(-0.5, 0.5), 0.2, 4.0, 0.5, 1.0)
        scaled.append((middle - u0) / (spread * residual))
    assert np.std(scaled) == pytest.approx(1.0, abs=0.12)
    assert abs(np.mean(scaled)) < 0.2


@settings(max_examples=30, deadline=None)
@given(st.floats(30.0, 31.0), st.floats(12.0, 20.0), st.floats(1.0, 2.0))
def test_edges_are_found_to_a_fraction_of_a_pixel(at: float, width: float, blur: float) -> None:
    x = np.arange(80.0)
    profile = 200.0 - 120.0 * (norm.cdf((x - at) / blur) - norm.cdf((x - at - width) / blur))
    falling, rising = _edges(profile, 3.0)
    assert (len(falling), len(rising)) == (1, 1)
    assert abs(falling[0] - at) < 0.1
    assert abs(rising[0] - at - width) < 0.1


def test_a_picture_that_shows_little_ahead_of_the_tool_is_looked_at_whole() -> None:
    """Little in one direction is enough: a strip has no room for a line that leads across it."""
    rows, columns = _ahead_of_the_tool(CAMERA)
    assert (rows.start, columns) == (0, slice(0, CAMERA.width))
    assert rows.stop < CAMERA.height
    tall = replace(CAMERA, height=1000)
    assert _ahead_of_the_tool(tall) == (slice(0, 1000), slice(0, CAMERA.width))
