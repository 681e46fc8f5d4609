"""The camera model against OpenCV, its own inverse, and what a small misalignment must do."""

from __future__ import annotations

import cv2
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from sensing.camera.camera_model import CalibrationError, CameraModel, default_mount

lens = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01),
                 st.floats(-0.05, 0.05))
DOWN = np.array([0.0, 0.0, 1.0])


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
        seen = camera.on_plane(camera.perturbed(**error).project_tool(point), DOWN, 0.0)
        np.testing.assert_allclose(seen[0] - axis, scale * (point[0] - axis), atol=1e-9)


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
