"""The camera model against OpenCV, its own inverse, and what a small misalignment must do; nearest points on a line."""

from __future__ import annotations

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from sensing.camera.camera_model import CalibrationError, CameraModel, default_mount, distort, undistort
from sensing.camera.line_polynomial import Polyline
from sensing.camera.line_search import PredictedLine, predict_image

lens = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01),
                 st.floats(-0.05, 0.05))
DOWN = UP = np.array([0.0, 0.0, 1.0])
"""The surface's normal in the tool frame, and in the base frame."""


@given(lens=lens, focal=st.floats(100.0, 1200.0), seed=st.integers(0, 2**32 - 1))
def test_projection_is_opencv_s(lens: tuple[float, ...], focal: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = CameraModel.default(focal=focal, distortion=lens)
    z = rng.uniform(0.05, 2.0, 50)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (50, 2)) * z[:, None], z])
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, camera.distortion)[0][:, 0]
    np.testing.assert_allclose(camera.project(points), expected, rtol=0, atol=1e-8)


@given(lens=lens, seed=st.integers(0, 2**32 - 1))
def test_rays_invert_the_projection(lens: tuple[float, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = CameraModel.default(distortion=lens)
    pixels = rng.uniform((0, 0), (camera.width - 1, camera.height - 1), (50, 2))
    rays = camera.rays(pixels)
    solved = np.isfinite(rays).all(axis=1)
    # Only the most extreme of these lenses fold the picture over within the image.
    assert solved.mean() > 0.9
    np.testing.assert_allclose(camera.project(rays[solved]), pixels[solved], atol=1e-8)


def test_a_camera_in_another_process_is_the_same_and_as_read_only() -> None:
    camera = CameraModel.default(distortion=(-0.2, 0.05, 1e-3, 0.0, 0.0))
    other = pickle.loads(pickle.dumps(camera))
    assert (other.K == camera.K).all()
    assert (other.distortion == camera.distortion).all()
    assert other.T_tool_camera == camera.T_tool_camera
    assert not other.K.flags.writeable
    assert not other.distortion.flags.writeable


def test_points_behind_the_camera_have_no_pixel() -> None:
    assert np.isnan(CameraModel.default().project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))).all()


def test_a_lens_without_inverse_gives_nan() -> None:
    camera = CameraModel.default(distortion=(-1.0, 0.0, 0.0, 0.0, 0.0))
    assert np.isnan(camera.rays(np.array([[319.0, 239.0]]))[0, 0])
    assert np.isfinite(camera.rays(np.array([[170.0, 120.0]]))).all()


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_points_of_the_surface_come_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mount = default_mount() * pin.SE3(pin.exp3(rng.normal(0.0, 0.1, 3)), rng.normal(0.0, 0.02, 3))
    camera = CameraModel.default(mount=mount)
    normal = pin.exp3(rng.normal(0.0, 0.05, 3)) @ -DOWN
    offset = rng.normal(0.0, 0.01)
    points = rng.uniform(-0.06, 0.06, (20, 3))
    points += (offset - points @ normal)[:, None] * normal
    np.testing.assert_allclose(camera.on_plane(camera.project_tool(points), normal, offset), points, atol=1e-10)


def test_default_mount_sees_the_line_ahead_upright() -> None:
    camera = CameraModel.default()
    pixels = camera.project_tool(np.array([[0.02, 0.0, 0.0], [0.11, 0.0, 0.0], [0.065, 0.01, 0.0]]))
    np.testing.assert_allclose(pixels[:2, 0], (camera.width - 1) / 2)
    assert pixels[1, 1] < pixels[0, 1]
    assert pixels[2, 0] > (camera.width - 1) / 2
    # 10 mm to the right, 0.83 mm a pixel.
    assert pixels[2, 0] - pixels[0, 0] == pytest.approx(10 / 0.83, rel=0.02)


@pytest.mark.parametrize(("error", "shift"), [
    ({"roll": 1e-3}, (0.0, 0.25e-3)),
    ({"pitch": 1e-3}, (-0.25e-3, 0.0)),
    ({"lateral": 1e-3}, (0.0, -1e-3)),
    ({"forward": 1e-3}, (-1e-3, 0.0)),
    ({"principal_u": 1.0}, (0.0, 0.25 / 300.0)),
    ({"principal_v": 1.0}, (-0.25 / 300.0, 0.0)),
])  # fmt: skip
def test_misalignment_shifts_the_middle_of_the_picture(error: dict[str, float], shift: tuple[float, float]) -> None:
    """What the right camera makes of a pixel, as seen by the wrong one: the error of the line point."""
    camera = CameraModel.default(distortion=(0.0,) * 5)
    point = np.array([[0.065, 0.0, 0.0]])
    wrong = camera.on_plane(camera.perturbed(**error).project_tool(point), DOWN, 0.0) - point
    np.testing.assert_allclose(wrong[0, :2], shift, rtol=1e-3, atol=1e-9)


def test_height_and_focal_length_scale_the_picture() -> None:
    camera = CameraModel.default(distortion=(0.0,) * 5)
    axis, point = np.array([0.065, 0.0, 0.0]), np.array([[0.065, 0.05, 0.0]])
    for error, scale in (({"height": 0.0025}, 0.25 / 0.2525), ({"focal": 0.01}, 1.01)):
        measured = camera.on_plane(camera.perturbed(**error).project_tool(point), DOWN, 0.0)
        np.testing.assert_allclose(measured[0] - axis, scale * (point[0] - axis), atol=1e-9)


def test_calibration_errors_keep_their_sizes_and_take_the_seed_s_signs() -> None:
    error = CalibrationError(0.001, 0.002, 0.003, 0.004, 0.005, 0.006, 0.7, 0.008)
    drawn = [error.signed(np.random.default_rng(seed)) for seed in range(20)]
    for key, size in (("roll", 0.001), ("principal_u", 0.7), ("principal_v", 0.7), ("k1", 0.008)):
        assert {round(d[key], 9) for d in drawn} == {-size, size}
    assert drawn[3] == error.signed(np.random.default_rng(3))
    assert CameraModel.default().perturbed(**drawn[0]).K[0, 2] == pytest.approx(159.5 + drawn[0]["principal_u"])


@pytest.mark.parametrize("change", [
    {"width": 0}, {"K": np.eye(2)}, {"K": np.diag([-1.0, 1.0, 1.0])}, {"distortion": np.zeros(4)},
    {"distortion": np.full(5, np.nan)},
])  # fmt: skip
def test_impossible_cameras_are_refused(change: dict[str, object]) -> None:
    values = {"width": 320, "height": 240, "K": np.diag([300.0, 300.0, 1.0]), "distortion": np.zeros(5),
              "T_tool_camera": default_mount(), **change}
    with pytest.raises(InputError, match="camera"):
        CameraModel(**values)  # type: ignore[arg-type]


# What a search goes by: where a line is in the picture, how it slants, and what a pixel is worth across it.

@pytest.mark.parametrize("turn", [0.0, 0.4, -0.6, 1.2, 2.5])
@pytest.mark.parametrize("tilt", [0.0, 0.3, -0.2])
def test_a_pixel_along_the_scan_is_worth_what_shifting_the_line_shows(turn: float, tilt: float) -> None:
    camera = CameraModel.default()
    seen_from = camera.T_tool_camera * pin.SE3(pin.rpy.rpyToMatrix(tilt, 0.5 * tilt, turn), np.zeros(3))
    camera = replace(camera, T_tool_camera=seen_from)
    middle = camera.on_plane(np.array([[0.5 * camera.width, 0.5 * camera.height]]), np.array([0.0, 0.0, 1.0]), 0.0)
    for direction in (0.3, 1.9, 2.6):
        tangent, normal = np.array([np.cos(direction), np.sin(direction), 0.0]), np.array([0.0, 0.0, 1.0])
        image = predict_image(camera, PredictedLine(middle, tangent[None], normal, 0.001))
        a = int(image.axis[0])
        np.testing.assert_allclose(image.pixels, camera.project_tool(middle), atol=1e-9)
        # The line itself, and shifted by a tenth of a millimetre to the side, cut where the scan crosses it.
        along = 2e-4 * np.linspace(-10.0, 10.0, 4001)[:, None] * tangent
        shifted = camera.project_tool(middle + along + 1e-4 * np.cross(normal, tangent))
        itself = camera.project_tool(middle + along)
        order = np.argsort(shifted[:, 1 - a])
        cut = np.interp(image.pixels[0, 1 - a], shifted[order, 1 - a], shifted[order, a])
        assert 1e-4 / (cut - image.pixels[0, a]) == pytest.approx(float(image.metres[0]), rel=5e-3)
        step = itself[2002] - itself[1998]
        assert step[a] / step[1 - a] == pytest.approx(float(image.slant[0]), abs=1e-3)
        # Along rows or columns, whichever cuts the line more squarely.
        assert abs(step[a]) <= abs(step[1 - a])


@pytest.mark.parametrize("lens", [[-0.32, 0.14, 2e-3, -1e-3, -0.03], [0.25, 0.2, -1e-3, 2e-3, 0.1]])
def test_a_strong_lens_is_inverted_up_to_the_corners(lens: list[float]) -> None:
    k = np.array(lens)
    for x in np.linspace(-0.6, 0.6, 13):
        for y in np.linspace(-0.45, 0.45, 11):
            np.testing.assert_allclose(undistort(*distort(x, y, k), k), (x, y), atol=1e-9)


# Nearest points on a polyline against brute force and against a circle.

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
    phi = np.linspace(0.3, 2.8, 40)
    radius = np.where(np.arange(40) % 2, 0.103, 0.094)
    nearest = line.nearest(radius[:, None] * np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi]), UP)
    # Travelled counter-clockwise, the centre is on the left.
    np.testing.assert_allclose(nearest.lateral, 0.1 - radius, atol=1e-7)
    np.testing.assert_allclose(nearest.distance, np.abs(0.1 - radius), atol=1e-7)
    # Feet stay away from a corner's inside and gather at its outside: by the offset times half the corner's angle.
    np.testing.assert_allclose(nearest.s, 0.1 * phi, atol=0.5 * 0.006 * np.pi / 3999 * 1.01)
    points, tangents = line.at(nearest.s)
    np.testing.assert_allclose(points, nearest.foot, atol=1e-9)
    np.testing.assert_allclose(tangents[:, 0], -np.sin(phi), atol=1e-3)


def test_beyond_its_ends_a_polyline_is_clipped() -> None:
    line = Polyline(np.array([[0.0, 0, 0], [1.0, 0, 0]]))
    nearest = line.nearest(np.array([[-0.3, 0.4, 0.0], [2.0, 0.0, 0.0]]), UP)
    np.testing.assert_allclose(nearest.distance, [0.5, 1.0])
    np.testing.assert_allclose(nearest.s, [0.0, 1.0])
    np.testing.assert_allclose(line.at(np.array([-1.0, 5.0]))[0], [[0, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize("points", [[[0, 0, 0]], [[0, 0, 0], [0, 0, 0]], [[0, 0], [1, 0]]])
def test_no_line(points: list[list[float]]) -> None:
    with pytest.raises(InputError, match=r"line\.points"):
        Polyline(np.array(points, dtype=float))
