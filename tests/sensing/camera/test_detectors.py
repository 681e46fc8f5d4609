"""Laws of all line detectors, and lines in whole pictures of which nothing is known."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import DETECTORS, LineDetector
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows
from sensing.camera.opencv_detector import OpenCVProfiles
from sensing.camera.picture_line import detect_in_picture
from tests.sensing.camera.pictures import drawn_line
from tests.sensing.camera.synthetic import NORMAL, make_field, stroke

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
