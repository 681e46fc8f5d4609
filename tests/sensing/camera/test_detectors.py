"""Laws of all line detectors, and lines in whole pictures of which nothing is known."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from sensing import SensingError
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import DETECTORS, LineDetector
from sensing.camera.line_detection import LineField
from sensing.camera.line_evidence import evidence
from sensing.camera.line_paths import _traced
from sensing.camera.line_polynomial import fit_line_polynomial, fit_of_lowest_order
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows
from sensing.camera.line_track import PATIENCE, _same, track
from sensing.camera.opencv_detector import OpenCVProfiles
from sensing.camera.picture_line import detect_in_picture, find_lines
from tests.sensing.camera.synthetic import CLEAN, NORMAL, X, drawn_line, make_field, predicted, y

CAMERA = CameraModel.default()
ALL = [implementation() for _, implementation in DETECTORS]


@pytest.mark.parametrize("detector", ALL, ids=lambda detector: detector.name)
def test_points_lie_on_the_line_and_sigma_is_honest(detector: LineDetector) -> None:
    prediction, settings = predicted(0.0008), DetectionSettings()
    errors, sigmas = [], []
    for seed in range(30):
        field = make_field(CAMERA, search_windows(CAMERA, prediction), CLEAN, np.random.default_rng(seed), 3.0)
        detection = detector.detect(field, CAMERA, prediction, settings)
        assert detection.seen
        p = detection.points_tcp[detection.used]
        errors.append((p[:, 1] - y(p[:, 0])) / np.hypot(1.0, 0.24))
        sigmas.append(detection.sigma[detection.used])
    spread = np.sqrt(np.mean(np.concatenate(errors) ** 2))
    assert spread < 4e-5
    assert 0.3 < spread / np.sqrt(np.mean(np.concatenate(sigmas) ** 2)) < 2.0


@pytest.mark.parametrize("detector", ALL, ids=lambda detector: detector.name)
def test_nothing_is_seen_where_nothing_is(detector: LineDetector) -> None:
    prediction = predicted()
    field = make_field(CAMERA, search_windows(CAMERA, prediction), lambda xy: 200.0 + 0.0 * xy[:, 0],
                       np.random.default_rng(1), 5.0)
    detection = detector.detect(field, CAMERA, prediction, DetectionSettings())
    assert not detection.seen
    assert detection.reason
    assert not detection.used.any()


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


@pytest.mark.parametrize(("dark", "width", "upright"), [(True, 8.0, False), (False, 8.0, True), (True, 3.0, True),
                                                        (False, 25.0, False), (True, 60.0, False)])
def test_width_polarity_and_place_are_found(dark: bool, width: float, upright: bool) -> None:
    """Uneven light, a scratch across, noise; the points keep within half a pixel of the truth."""
    gray, truth = drawn_line(dark=dark, width=width, upright=upright, seed=3)
    detection = detect_in_picture(gray)
    assert detection.found, detection.reason
    assert detection.dark == dark
    assert abs(detection.width - width) < 0.1 * width + 1.0
    s, across = detection.points.T[::-1] if upright else detection.points.T
    assert np.ptp(s) > 0.8 * gray.shape[0 if upright else 1]
    assert np.median(np.abs(across - truth(s))) < 0.3
    assert np.mean(np.abs(across - truth(s)) < 1.0) > 0.8


def _taped(angle: float, size: float, ink: tuple[int, int, int], ground: tuple[int, int, int]
           ) -> tuple[np.ndarray, np.ndarray]:
    """A bent, tapering tape (BGR) turned by an angle; its middle ``(100, 2)`` [px]."""
    rng = np.random.default_rng(7)
    x = np.linspace(-260.0, 260.0, 100)
    middle = np.column_stack([x, 30.0 * np.sin(x / 110.0)]) @ np.array([[np.cos(angle), np.sin(angle)],
                                                                       [-np.sin(angle), np.cos(angle)]]) * 0.8
    middle += [320.0, 240.0]
    picture = np.full((480, 640, 3), ground, np.uint8)
    for a, b, w in zip(middle[:-1], middle[1:], np.linspace(0.7, 1.4, 99), strict=True):
        cv2.line(picture, tuple(np.rint(16 * a).astype(int).tolist()), tuple(np.rint(16 * b).astype(int).tolist()),
                 ink, max(2, round(size * w)), cv2.LINE_AA, 4)
    blurred = cv2.GaussianBlur(picture, (0, 0), 1.0).astype(float) + rng.normal(0.0, 3.0, picture.shape)
    return np.clip(blurred, 0, 255).astype(np.uint8), middle


def _missed(points: np.ndarray, middle: np.ndarray) -> float:
    """Median distance of points from the middle of a tape [px]."""
    return float(np.median(np.linalg.norm(points[:, None] - middle, axis=2).min(axis=1)))


@settings(max_examples=12, deadline=None)
@given(angle=st.floats(-np.pi, np.pi), size=st.floats(4.0, 40.0))
def test_a_tape_is_found_however_it_is_turned_and_however_wide(angle: float, size: float) -> None:
    picture, middle = _taped(angle, size, (40, 90, 40), (170, 175, 180))
    detection = detect_in_picture(picture)
    assert detection.found, detection.reason
    assert _missed(detection.points, middle) < 3.0


def test_colours_decide_where_gray_values_are_equal() -> None:
    """Red on green of the same gray value, and the colours exchanged."""
    for ink, ground in (((60, 60, 190), (60, 115, 60)), ((60, 115, 60), (60, 60, 190))):
        picture, middle = _taped(0.3, 10.0, ink, ground)
        gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        assert abs(int(np.median(gray[230:250, 318:322])) - int(np.median(gray))) < 15
        detection = detect_in_picture(picture)
        assert detection.found, detection.reason
        assert _missed(detection.points, middle) < 3.0


def test_of_two_lines_the_middle_one_is_taken_and_the_other_where_it_is_told() -> None:
    picture = np.full((480, 640, 3), 200, np.uint8)
    for v in (90, 250):
        cv2.line(picture, (0, v), (640, v + 10), (40, 40, 40), 9, cv2.LINE_AA)
    first, second = detect_in_picture(picture), detect_in_picture(picture, near=(300.0, 95.0))
    assert abs(np.median(first.points[:, 1]) - 255.0) < 2.0
    assert abs(np.median(second.points[:, 1]) - 95.0) < 2.0
    assert first.others >= 1


@pytest.mark.parametrize("seed", range(6))
def test_a_line_passes_the_pixel_that_is_told_or_is_none(seed: int) -> None:
    picture, *_ = drawn_line(seed=seed)
    found = detect_in_picture(picture)
    assert found.found
    middle, normal = found.strip.points[len(found.strip.points) // 2], found.strip.normals[len(found.strip.points) // 2]
    assert detect_in_picture(picture, near=tuple(middle)).found
    beside = middle + normal * (found.width + 0.06 * min(picture.shape[:2]))
    assert not detect_in_picture(picture, near=tuple(beside)).found


def test_twigs_of_a_path_do_not_stand_before_another_one() -> None:
    """Twigs inherit the score of the path that they stand on; another path is worth more than what they add."""
    columns, nodes = 40, np.zeros((40, 48, 9), np.float32)
    nodes[:, :12, 0] = 20.0 * np.arange(12)
    counts, sums, came = np.full(columns, 12), np.zeros((columns, 48)), np.full((columns, 48, 2), -1)
    for k in range(1, columns):
        sums[k, :2] = 3.0 * k, 2.0 * k
        came[k, :2] = (k - 1, 0), (k - 1, 1)
        sums[k, 2:12], came[k, 2:12] = sums[k - 1, 0] + 1.0, (k - 1, 0)
    taken = np.zeros_like(sums, bool)
    for path, most in ((0, 117.0), (1, 78.0)):
        trace, score = _traced(nodes, counts, sums, came, taken)
        assert (trace[:, 1].tolist(), score) == ([path] * columns, most)


def test_an_edge_is_no_stripe_and_a_laser_is_bright_and_narrow() -> None:
    rng = np.random.default_rng(4)
    step = np.full((480, 640), 70.0)
    step[:, 300:] = 170.0
    edge = np.clip(cv2.GaussianBlur(step, (0, 0), 1.0) + rng.normal(0.0, 3.0, step.shape), 0, 255).astype(np.uint8)
    assert not detect_in_picture(edge).found
    detection = detect_in_picture(edge, kind="edge")
    assert detection.found, detection.reason
    assert np.abs(detection.points[:, 0] - 299.5).max() < 0.5
    stripe = _taped(0.2, 5.0, (60, 60, 250), (60, 70, 70))[0]
    assert detect_in_picture(stripe, kind="laser").found
    assert not detect_in_picture(_taped(0.2, 5.0, (30, 30, 40), (160, 170, 170))[0], kind="laser").found


def test_pictures_without_a_line_are_refused_with_a_reason() -> None:
    rng = np.random.default_rng(0)
    noise = np.clip(128 + 8 * rng.standard_normal((240, 320)), 0, 255).astype(np.uint8)
    texture = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (480, 640, 3)), (0, 0), 3.0)
    texture = np.clip(128.0 + 8.0 * (texture - 128.0), 0, 255).astype(np.uint8)
    gradient = np.repeat(np.linspace(0, 255, 320).astype(np.uint8)[None], 240, axis=0)
    for picture in (noise, texture, gradient, np.zeros((100, 100), np.uint8)):
        detection = detect_in_picture(picture)
        assert not detection.found
        assert detection.reason


def test_a_drawn_rectangle_is_no_line() -> None:
    blob = np.full((240, 320), 200, np.uint8)
    blob[80:160, 100:200] = 40
    assert not detect_in_picture(blob).found


def test_a_pixel_that_is_told_is_a_condition() -> None:
    """A weak line beside a strong one: the weak one where its pixel is told, none where a pixel of neither is."""
    picture = np.full((480, 640, 3), 120, np.uint8)
    cv2.line(picture, (60, 20), (90, 460), (250, 250, 250), 14, cv2.LINE_AA)
    cv2.line(picture, (150, 300), (600, 330), (100, 100, 150), 7, cv2.LINE_AA)
    noisy = np.clip(picture + np.random.default_rng(2).normal(0.0, 3.0, picture.shape), 0, 255).astype(np.uint8)
    weak = detect_in_picture(noisy, near=(300.0, 310.0))
    assert weak.found, weak.reason
    assert np.abs(weak.points[:, 1] - 300.0 - (weak.points[:, 0] - 150.0) / 15.0).max() < 3.0
    strong = detect_in_picture(noisy, near=(75.0, 240.0))
    assert np.abs(strong.points[:, 0] - 60.0 - (strong.points[:, 1] - 20.0) * 30.0 / 440.0).max() < 3.0
    assert not detect_in_picture(noisy, near=(400.0, 120.0)).found


@pytest.mark.parametrize("seed", range(4))
def test_all_pieces_of_a_line_that_steps_are_given(seed: int) -> None:
    rng = np.random.default_rng(seed)
    step, gap, at = rng.uniform(25.0, 70.0), rng.uniform(0.0, 25.0), rng.uniform(230.0, 400.0)
    picture = np.full((480, 640, 3), 70, np.uint8)
    ends = ((0.0, 200.0), (at - gap / 2, 205.0), (at + gap / 2, 205.0 + step), (640.0, 212.0 + step))
    for one, other in (ends[:2], ends[2:]):
        cv2.line(picture, *(tuple(np.rint(end).astype(int).tolist()) for end in (one, other)), (90, 90, 250), 7,
                 cv2.LINE_AA)
    blurred = cv2.GaussianBlur(picture, (0, 0), 1.2) + rng.normal(0.0, 3.0, picture.shape)
    found = detect_in_picture(np.clip(blurred, 0, 255).astype(np.uint8), kind="laser")
    assert len(found.pieces) == 2, found.reason
    ((end, begin),) = found.breaks
    if end[0] > begin[0]:
        end, begin = begin, end
    np.testing.assert_allclose(end, ends[1], atol=12.0)
    np.testing.assert_allclose(begin, ends[2], atol=12.0)


@pytest.mark.parametrize("shape", ["groove", "box"])
@pytest.mark.parametrize("seed", range(2))
def test_a_stripe_over_a_groove_or_a_box_is_given_whole(shape: str, seed: int) -> None:
    """Each leg of the stripe, a bright core in a red halo, is in a piece, and where one ends is told."""
    rng = np.random.default_rng(seed)
    at, deep = rng.uniform(260.0, 380.0), rng.uniform(60.0, 100.0)
    picture = np.full((480, 640, 3), 60.0)
    if shape == "groove":
        legs = [[(-9, 230), (at - 50, 225), (at, 225 + deep), (at + 50, 225), (649, 228)]]
    else:
        picture[250:400, 100:300] = (110, 130, 150)
        legs = [[(430, -9), (432, 190)], [(190, 250), (188, 400)], [(185, 402), (20, 440)]]
    for width, ink in ((13, (60, 60, 235)), (5, (225, 220, 255))):
        for leg in legs:
            cv2.polylines(picture, [np.rint(leg).astype(np.int32)], False, ink, width, cv2.LINE_AA)
    noisy = cv2.GaussianBlur(picture, (0, 0), 1.2) + rng.normal(0.0, 3.0, picture.shape)
    found = detect_in_picture(np.clip(noisy, 0, 255).astype(np.uint8), kind="laser")
    truth = np.concatenate([np.linspace(one, other, 100) for leg in legs for one, other in pairwise(leg)])
    truth = truth[(truth > 0.0).all(axis=1) & (truth < [639.0, 479.0]).all(axis=1)]
    points = np.concatenate([piece.points for piece in found.pieces])
    assert np.mean(np.linalg.norm(truth[:, None] - points, axis=2).min(axis=1) < 15.0) > 0.9
    assert _missed(points, truth) < 2.0
    assert len(found.breaks) == len(found.pieces) - 1
    assert len(found.pieces) >= len(legs)


def test_a_joint_between_two_plates_is_found() -> None:
    """Six pixels wide and black, shorter than the picture, the plates unlike each other."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        v, u = np.mgrid[:480, :640] - np.array([240.0, rng.uniform(260.0, 380.0)])[:, None, None]
        across = u - rng.uniform(-0.25, 0.25) * v
        one, other = rng.uniform(140.0, 200.0, 2)
        plates = np.where(across < 0.0, one, other) * (np.abs(across) > 3.0)
        picture = np.where((np.abs(across) < 160.0) & (np.abs(v) < 140.0), plates, rng.uniform(60.0, 100.0))
        noisy = cv2.GaussianBlur(picture, (0, 0), 1.0) + rng.normal(0.0, 4.0, picture.shape)
        found = detect_in_picture(np.clip(noisy, 0, 255).astype(np.uint8), kind="seam")
        assert found.found, found.reason
        assert abs(found.width - 6.0) < 1.5
        places = np.rint(found.points).astype(int)
        assert np.abs(across[places[:, 1], places[:, 0]]).max() < 2.0


def test_two_lines_beside_each_other_are_no_pieces_of_one() -> None:
    picture = np.full((480, 640, 3), 200, np.uint8)
    for v in (190, 290):
        cv2.line(picture, (0, v), (640, v + 10), (40, 40, 40), 9, cv2.LINE_AA)
    found = detect_in_picture(picture)
    assert len(found.pieces) == 1
    assert found.others >= 1


def test_a_cable_that_turns_back_is_followed_round_its_bend() -> None:
    t = np.linspace(0.0, np.pi, 200)
    bend = np.column_stack([420.0 + 110.0 * np.sin(t), 240.0 - 110.0 * np.cos(t)])
    way = np.concatenate([[[80.0, 130.0]], bend, [[80.0, 350.0]]])
    picture = np.full((480, 640, 3), 185, np.uint8)
    cv2.polylines(picture, [np.rint(way).astype(np.int32)], False, (60, 40, 30), 8, cv2.LINE_AA)
    noisy = np.clip(picture + np.random.default_rng(3).normal(0.0, 3.0, picture.shape), 0, 255).astype(np.uint8)
    found = detect_in_picture(noisy, points=60)
    assert found.found, found.reason
    assert np.linalg.norm(np.diff(found.points, axis=0), axis=1).sum() > 0.9 * (2 * 340.0 + np.pi * 110.0)
    even = np.concatenate([np.linspace(one, other, 300) for one, other in pairwise(way)])
    assert _missed(found.points, even) < 1.0


@pytest.mark.parametrize("grain", [0.0, 12.0])
def test_sigma_of_a_picture_knows_grain(grain: float) -> None:
    """White noise alone, and streaks such as wood has: the points scatter as much as they are said to."""
    z = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        picture = np.full((480, 640), 190.0)
        mask = np.zeros((480, 640), np.uint8)
        cv2.line(mask, (0, 16 * 200), (640 * 16, 16 * 260), 255, 11, cv2.LINE_AA, 4)
        streaks = cv2.GaussianBlur(rng.normal(0.0, 1.0, picture.shape), (0, 0), sigmaX=1.5, sigmaY=6.0)
        picture += grain * streaks / streaks.std()
        share = cv2.GaussianBlur(mask.astype(float) / 255.0, (0, 0), 1.0)
        picture = picture * (1.0 - share) + 60.0 * share + rng.normal(0.0, 3.0, picture.shape)
        found = detect_in_picture(np.clip(picture, 0, 255).astype(np.uint8), points=40)
        assert found.found, found.reason
        off = (found.points[:, 1] - 200.0 - found.points[:, 0] * 60.0 / 640.0) / np.hypot(1.0, 60.0 / 640.0)
        assert found.strip is not None
        z.append((off - np.median(off)) / found.strip.sigmas)
    assert 0.4 < float(np.sqrt(np.mean(np.concatenate(z) ** 2))) < 1.6


def _film(frame: int, *, hidden: bool = False, other: bool = False) -> np.ndarray:
    """A dark line that moves by 6 px a frame over a paler one that rests; noise."""
    picture = np.full((240, 320, 3), 190, np.uint8)
    if other:
        cv2.line(picture, (0, 200), (320, 205), (60, 120, 60), 7, cv2.LINE_AA)
    if not hidden:
        v = 60 + 6 * frame
        cv2.line(picture, (0, v), (320, v - 30), (40, 40, 40), 7, cv2.LINE_AA)
    noisy = picture + np.random.default_rng(frame).normal(0.0, 3.0, picture.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def test_a_line_is_followed_lost_and_found_again_and_another_is_not_taken_for_it() -> None:
    last, states, places = None, [], []
    for frame in range(14):
        last = track(_film(frame, hidden=5 <= frame < 8, other=True), last, near=(160.0, 45.0))
        states.append(last.state)
        places.append(float(np.median(last.line.points[:, 1])) if last.line.found else np.nan)
    assert states == ["found", *["followed"] * 4, *["lost"] * 3, "found again", *["followed"] * 5]
    expected = np.array([45.0 + 6.0 * frame if not 5 <= frame < 8 else np.nan for frame in range(14)])
    np.testing.assert_allclose(places, expected, atol=2.0)


def test_a_look_that_stays_counts_for_the_line_that_is_known_and_another_against_it() -> None:
    known = find_lines(_film(0))[0][1]
    for value, share, same in ((-6.0, 1.0, True), (-6.0, -0.2, False), (20.0, -0.5, False), (-12.0, 1.0, False)):
        assert (_same(value, replace(known, color=share * known.color), known) > 0.0) == same


def test_what_is_unevenly_wide_is_less_likely_a_line() -> None:
    strips = []
    for ragged in (0, 3):
        picture = np.full((240, 320), 180, np.uint8)
        for u in range(320):
            half = 8 + ragged * round(np.sin(u / 6.0) + np.sin(u / 17.0))
            picture[120 - half : 120 + half, u] = 60
        strips.append(find_lines(picture)[0][1])
    assert evidence(strips[1]) < evidence(strips[0]) - 1.0


def test_one_of_many_slats_is_less_likely_a_line() -> None:
    values = []
    for slats in ((230,), (230, 260), range(20, 480, 30)):
        picture = np.full((480, 640, 3), 190, np.uint8)
        for v in slats:
            cv2.line(picture, (0, v), (640, v + 20), (60, 70, 80), 9, cv2.LINE_AA)
        noisy = picture + np.random.default_rng(0).normal(0.0, 3.0, picture.shape)
        values.append(find_lines(np.clip(noisy, 0, 255).astype(np.uint8))[0][0])
    assert values[2] < values[1] - 1.0 < values[0] - 2.0


def test_another_line_is_taken_late_and_said() -> None:
    last, states = None, []
    for frame in range(16):
        last = track(_film(frame, hidden=frame > 1, other=True), last, near=(160.0, 45.0))
        states.append(last.state)
    assert states == ["found", "followed", *["lost"] * PATIENCE, "another line", *["followed"] * 3]
    assert abs(np.median(last.line.points[:, 1]) - 202.5) < 2.0


def test_what_is_no_picture_is_refused() -> None:
    picture = np.zeros((64, 64), np.uint8)
    with pytest.raises(InputError, match="gray or BGR"):
        detect_in_picture(np.zeros((4, 4), np.uint8))
    with pytest.raises(InputError, match="five points"):
        detect_in_picture(picture, points=2)
    with pytest.raises(InputError, match="line, tape, laser, seam, edge"):
        detect_in_picture(picture, kind="rope")


# The polynomial of a field: exact where it must be, honest covariance, outliers dropped.

S = np.linspace(0.42, 0.51, 5)
SIGMA = np.full(5, 2e-5)


@given(c=st.tuples(st.floats(-0.01, 0.01), st.floats(-0.1, 0.1), st.floats(-1.0, 1.0)))
def test_exact_points_give_the_exact_polynomial(c: tuple[float, float, float]) -> None:
    def truth(s: np.ndarray) -> np.ndarray:
        return c[0] + c[1] * (s - 0.4) + c[2] * (s - 0.4) ** 2

    fit = fit_line_polynomial(S, truth(S), SIGMA)
    places = np.linspace(0.40, 0.53, 30)
    np.testing.assert_allclose(fit.deviation(places)[0], truth(places), atol=1e-9)
    assert fit.used.all()


def test_covariance_is_that_of_repeated_fits() -> None:
    rng = np.random.default_rng(4)
    sigma = np.array([1, 2, 1, 3, 1]) * 2e-5
    places = np.array([0.40, 0.45, 0.50, 0.55])
    values = []
    for _ in range(2000):
        fit = fit_line_polynomial(S, 0.003 + sigma * rng.standard_normal(5), sigma, outlier=100.0, shape_noise=0.0)
        values.append(fit.deviation(places)[0])
    np.testing.assert_allclose(np.std(values, axis=0), fit.deviation(places)[1], rtol=0.06)
    # Extrapolating costs.
    assert fit.deviation(places)[1][3] > 3 * fit.deviation(places)[1][1]


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

    s, places = np.linspace(0.0, 0.167, 5), np.linspace(0.0, 0.167, 100)
    direct = fit_line_polynomial(s, curve(s), np.full(5, 1e-6), degree=3, outlier=1e9, shape_noise=0.0)
    reference = 1.02 * curve(places)
    deviation = fit_line_polynomial(s, -0.02 * curve(s), np.full(5, 1e-6), degree=3, outlier=1e9, shape_noise=0.0)
    missed = np.abs(direct.deviation(places)[0] - curve(places)).mean()
    by_deviation = np.abs(reference + deviation.deviation(places)[0] - curve(places)).mean()
    assert missed > 1e-4
    assert by_deviation < 0.03 * missed


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
