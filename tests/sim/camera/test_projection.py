"""The rendered picture obeys OpenCV's projection to a hundredth of a pixel, in whole images and in crops of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sensing.camera.camera_device import Window
from sensing.camera.camera_model import CameraModel, default_mount
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.image_chain import ImageChain, disc
from sim.camera.lamp import Lamp
from sim.camera.live_camera import LiveCamera
from sim.camera.surface import DrawnLine, Feature, Texture, paint
from tests.sensing.camera.synthetic import tool_over

RESOLUTION = 0.0002
RADIUS = 0.005
MARKS = np.array([[x, y] for x in (-0.06, -0.02, 0.03, 0.07) for y in (-0.08, -0.03, 0.04, 0.09)])
QUIET = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0, supersampling=4, sub_exposures=4)


def marks() -> Texture:
    """Dark round spots with the smooth profile (1 - r²/R²)², centres at ``MARKS``."""
    n = 1300
    image = np.full((n, n), 220.0)
    places = (np.arange(n) + 0.5 - n / 2) * RESOLUTION
    for x, y in MARKS:
        r2 = (places[None, :] - x) ** 2 + (-places[:, None] - y) ** 2
        image -= 200.0 * np.clip(1.0 - r2 / RADIUS**2, 0.0, None) ** 2
    return Texture(np.rint(image).astype(np.uint8), -n / 2 * RESOLUTION, n / 2 * RESOLUTION, RESOLUTION)


def expected_centroid(camera: CameraModel, T_camera_plane: pin.SE3, mark: Array) -> Array:
    """Centroid of the spot's image by OpenCV alone: its points projected, each with weight and image area."""
    grid = np.linspace(-RADIUS, RADIUS, 41)
    dx, dy = (a.ravel() for a in np.meshgrid(grid, grid))
    weight = np.clip(1.0 - (dx**2 + dy**2) / RADIUS**2, 0.0, None) ** 2
    points = np.column_stack([mark[0] + dx, mark[1] + dy, 0.0 * dx])
    rotation = cv2.Rodrigues(T_camera_plane.rotation)[0]

    def project(p: Array) -> Array:
        return np.asarray(
            cv2.projectPoints(p, rotation, T_camera_plane.translation, camera.K, camera.distortion)[0][:, 0])

    ex, ey = np.array([1e-5, 0.0, 0.0]), np.array([0.0, 1e-5, 0.0])
    a, b = (project(points + e) - project(points - e) for e in (ex, ey))
    weight = weight * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return np.asarray(weight @ project(points) / weight.sum())


def centroid(patch: Array, window: Window) -> Array:
    weight = np.clip(219.0 - patch, 0.0, None)
    u, v = window.u + np.arange(window.width), window.v + np.arange(window.height)
    return np.array([weight.sum(axis=0) @ u, weight.sum(axis=1) @ v]) / weight.sum()


@pytest.mark.parametrize(("lens", "tilt", "size"), [
    ((0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0), (320, 240)),
    ((-0.2, 0.05, 0.0, 0.0, 0.0), (0.03, -0.05), (320, 240)),
    ((-0.25, 0.1, 0.004, -0.006, 0.01), (-0.2, 0.15), (320, 240)),
    ((-0.2, 0.05, 0.0, 0.0, 0.0), (0.1, 0.1), (640, 480)),
])  # fmt: skip
def test_rendered_marks_lie_where_opencv_projects_them(
    lens: tuple[float, ...], tilt: tuple[float, float], size: tuple[int, int]
) -> None:
    # A camera whose principal point is not the middle and whose mount is tilted, over a tilted surface.
    mount = default_mount() * pin.SE3(pin.rpy.rpyToMatrix(tilt[0], tilt[1], 0.1), np.array([0.004, -0.007, 0.01]))
    camera = CameraModel.default(*size, distortion=lens, mount=mount).perturbed(principal_u=3.3, principal_v=-2.7)
    plane = pin.SE3(pin.rpy.rpyToMatrix(0.05, 0.02, 0.4), np.array([0.7, -0.1, 0.3]))
    tool = tool_over(-0.05, 0.01, yaw=0.2, plane=plane)
    T_camera_plane = (tool * mount).inverse() * plane
    surface = DrawnLine.from_plane_points(np.array([[0.0, 0.0], [0.1, 0.0]]), plane)
    half = int(1.35 * RADIUS / 0.24 * camera.K[0, 0]) + 2
    windows, expected = [], []
    for mark in MARKS:
        centre = expected_centroid(camera, T_camera_plane, mark)
        u, v = (int(i) - half for i in np.rint(centre))
        if u >= 0 and v >= 0 and u + 2 * half < size[0] and v + 2 * half < size[1]:
            windows.append(Window(u, v, 2 * half + 1, 2 * half + 1))
            expected.append(centre)
    assert len(windows) >= 7
    with RenderedCamera(camera, surface, QUIET, np.random.default_rng(0), marks()) as rendered:
        field = rendered.windows(0.1, lambda t: tool, windows)
        centroids = np.array([centroid(p.astype(float), w) for p, w in zip(field.patches, windows, strict=True)])
        frame = rendered.frame(tool)
    off = np.linalg.norm(centroids - np.array(expected), axis=1)
    assert off.max() < 0.01
    # The whole image holds the same, to what two samples a pixel can do.
    for window, patch in zip(windows, field.patches, strict=True):
        part = frame[window.v : window.v + window.height, window.u : window.u + window.width]
        assert np.abs(part.astype(float) - patch).mean() < 2.0


# Sampling the drawn plane and rendering it as a mesh by PyBullet are two ways to the same picture.

SEEN_PLANE = pin.SE3(pin.rpy.rpyToMatrix(0.05, -0.03, 0.4), np.array([0.6, -0.1, 0.3]))
LINE = DrawnLine.from_plane_points(np.array([[-0.1, 0.0], [0.1, 0.02], [0.3, 0.0]]), SEEN_PLANE,
                                   features=(Feature("crossing", 0.15, length=0.1), Feature("glare", 0.2)))
SETTINGS = CameraSettings(noise=0.0, jitter=0.0, stamp_noise=0.0, resolution=0.0005)
WINDOWS = [Window(0, 0, 40, 30), Window(120, 100, 60, 3), Window(150, 60, 3, 60), Window(60, 40, 200, 160)]


def test_the_plane_is_seen_as_pybullet_renders_it() -> None:
    camera = CameraModel.default(mount=default_mount() * pin.SE3(pin.rpy.rpyToMatrix(0.06, -0.04, 0.1), np.zeros(3)))
    with (RenderedCamera(camera, LINE, SETTINGS, np.random.default_rng(0)) as sampled,
          BulletCamera(camera, LINE, SETTINGS, np.random.default_rng(0)) as rendered):
        for aside, yaw in ((0.0, 0.0), (0.01, 0.6), (-0.02, -1.2)):
            def pose_at(t: float, aside: float = aside, yaw: float = yaw) -> pin.SE3:
                return tool_over(0.05 + 0.5 * (t - 0.005), aside, yaw, plane=SEEN_PLANE)

            for a, b in zip(sampled.windows(0.005, pose_at, WINDOWS).patches,
                            rendered.windows(0.005, pose_at, WINDOWS).patches, strict=True):
                off = np.abs(a.astype(float) - b)
                # TinyRenderer takes the nearest texel, which roughens the line's edges.
                assert off.mean() < 2.0
                assert np.quantile(off, 0.999) < 25.0
                assert abs(a.astype(float).mean() - b.astype(float).mean()) < 0.5


def test_beyond_the_surface_all_is_white_and_from_below_nothing_is_seen() -> None:
    with RenderedCamera(CameraModel.default(), LINE, SETTINGS, np.random.default_rng(0)) as camera:
        away = camera.frame(tool_over(3.0, 0.0, plane=SEEN_PLANE))
        below = camera.frame(SEEN_PLANE * pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3])))
    assert np.all(away == 255)
    assert np.all(below == 255)


# The drawn line: geometry, features, and what is painted of it.

X = np.arange(0.0, 0.3, 0.0005)
XY = np.column_stack([X, 0.02 * np.sin(15 * X)])
PLANE = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.05, 0.7), np.array([0.8, 0.1, 0.4]))


def gray_at(texture: Texture, x: float, y: float) -> int:
    row, column = (texture.y_max - y) / texture.resolution, (x - texture.x_min) / texture.resolution
    return int(texture.image[int(row), int(column)])


def beside(line: DrawnLine, s: float, offset: float) -> tuple[float, float]:
    """A place in the plane, to the left of the line."""
    point, tangent = (a[0] for a in line.at(np.array([s])))
    point = point + offset * np.cross(line.plane.rotation[:, 2], tangent)
    x, y, _ = line.plane.actInv(point)
    return float(x), float(y)


def test_distance_in_space_and_in_the_plane() -> None:
    line = DrawnLine.from_plane_points(XY, PLANE)
    points, tangents = line.at(np.array([0.1, 0.2]))
    left = np.cross(PLANE.rotation[:, 2], tangents)
    queries = points + 0.004 * left + 0.003 * PLANE.rotation[:, 2]
    np.testing.assert_allclose(line.distance(queries), 0.005, atol=1e-6)
    np.testing.assert_allclose(line.nearest(queries).lateral, 0.004, atol=1e-6)
    np.testing.assert_allclose(line.nearest(queries).s, [0.1, 0.2], atol=1e-5)


def test_painted_line_has_its_width_and_a_soft_edge() -> None:
    line = DrawnLine.from_plane_points(np.array([[0.0, 0.0], [0.2, 0.0]]), pin.SE3.Identity(), width=0.003, edge=0.001)
    texture = paint(line, resolution=0.0001, margin=0.02)
    across = [gray_at(texture, 0.1, y) for y in (0.0, 0.0009, 0.00125, 0.00175, 0.0021, 0.01)]
    assert across[0] == across[1] == 40
    assert across[4] == across[5] == 200
    # A quarter and three quarters up the edge, to a texel's half.
    assert across[2] == pytest.approx(80, abs=16)
    assert across[3] == pytest.approx(160, abs=16)
    assert texture.size == pytest.approx((0.24, 0.04), abs=2e-4)


def test_painted_where_the_geometry_says() -> None:
    line = DrawnLine.from_plane_points(XY, PLANE)
    texture = paint(line, margin=0.02)
    for s in np.linspace(0.01, line.length - 0.01, 30):
        assert gray_at(texture, *beside(line, s, 0.0)) == 40
        assert gray_at(texture, *beside(line, s, 0.003)) == 200
        assert gray_at(texture, *beside(line, s, -0.003)) == 200


@pytest.mark.parametrize(("feature", "where", "gray"), [
    (Feature("gap", 0.15, length=0.02), (0.15, 0.0), 200),
    (Feature("gap", 0.15, length=0.02), (0.17, 0.0), 40),
    (Feature("crossing", 0.15, length=0.04), (0.15, 0.015), 40),
    (Feature("crossing", 0.15, length=0.04), (0.15, 0.025), 200),
    (Feature("parallel", 0.15, length=0.04, offset=0.01), (0.16, 0.01), 40),
    (Feature("parallel", 0.15, length=0.04, offset=0.01), (0.16, -0.01), 200),
    (Feature("scratch", 0.15, offset=0.008, width=0.002, angle=0.0), (0.15, 0.008), 235),
    (Feature("glare", 0.15, offset=0.01), (0.15, 0.01), 255),
    (Feature("glare", 0.15, offset=0.01), (0.15, -0.01), 200),
    (Feature("shade", 0.15, offset=0.01, gray=50.0), (0.15, 0.01), 100),
])  # fmt: skip
def test_features(feature: Feature, where: tuple[float, float], gray: int) -> None:
    line = DrawnLine.from_plane_points(XY, PLANE, features=(feature,))
    assert gray_at(paint(line, margin=0.05), *beside(line, *where)) == pytest.approx(gray, abs=2)


def test_a_patch_beyond_the_surface_is_harmless() -> None:
    line = DrawnLine.from_plane_points(XY, PLANE, features=(Feature("glare", 0.0, offset=5.0),))
    assert paint(line, margin=0.02).image.max() == 200


@pytest.mark.parametrize(("table", "field"), [
    ({"kind": "hole", "at": 0.1}, "kind"), ({"kind": "gap", "at": 0.1, "length": 0.0}, "gap")])
def test_wrong_features_are_named(table: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError, match=field):
        Feature(**table)


def test_wrong_lines_are_refused() -> None:
    with pytest.raises(InputError, match="must lie on its plane"):
        DrawnLine(np.array([[0.0, 0, 0], [1, 0, 0.1]]), pin.SE3.Identity())
    with pytest.raises(InputError, match="coincide"):
        DrawnLine.from_plane_points(np.zeros((3, 2)), pin.SE3.Identity())
    with pytest.raises(InputError, match="width"):
        DrawnLine.from_plane_points(XY, PLANE, width=-1.0)
    with pytest.raises(InputError, match="texels"):
        paint(DrawnLine.from_plane_points(XY, PLANE), resolution=1e-5)
    with pytest.raises(InputError, match="inf × inf texels"):
        paint(DrawnLine.from_plane_points(XY, PLANE), resolution=1e-320)
    with pytest.raises(InputError, match="resolution"):
        paint(DrawnLine.from_plane_points(XY, PLANE), resolution=0.0)


# Pictures with what photographs have: noise of the light, mosaic, defocus, vignetting, compression.

STRAIGHT = DrawnLine.from_plane_points(np.array([[-0.1, 0.0], [0.3, 0.0]]), pin.SE3.Identity())
CLEAN = CameraSettings(noise=0.0)
ALL = replace(CLEAN, mosaic=True, defocus_px=1.3, vignetting=0.3, jpeg_quality=85)
WHOLE = Window(0, 0, 320, 240)


def flat(level: float, **settings: Any) -> np.ndarray:
    """Gray values of an even surface."""
    chain = ImageChain(320, 240, replace(CLEAN, **settings))
    return chain.developed(np.full((240, 320), level), WHOLE, np.random.default_rng(1)).astype(float)


def neighbours(gray: np.ndarray) -> float:
    rest = gray - gray.mean()
    return float(np.mean(rest[:, 1:] * rest[:, :-1]) / rest.var())


@pytest.mark.parametrize("settings", [ALL, replace(ALL, jpeg_quality=0), replace(ALL, mosaic=False),
                                      replace(ALL, defocus_px=0.0)])
def test_the_pixels_of_a_window_are_those_of_the_whole_picture(settings: CameraSettings) -> None:
    def moving(t: float) -> pin.SE3:
        return tool_over(0.7 * t, 0.004, 0.3)

    windows = [Window(3, 5, 81, 3), Window(100, 101, 81, 3), Window(237, 236, 83, 4), Window(50, 50, 0, 3)]
    with RenderedCamera(CameraModel.default(), STRAIGHT, settings, np.random.default_rng(1)) as camera:
        (whole,) = camera.windows(0.025, moving, [WHOLE]).patches
        for window, patch in zip(windows, camera.windows(0.025, moving, windows).patches, strict=True):
            np.testing.assert_array_equal(
                patch, whole[window.v : window.v + window.height, window.u : window.u + window.width])


@pytest.mark.parametrize("level", [40.0, 200.0])
def test_noise_grows_with_the_root_of_the_light(level: float) -> None:
    # Rounding to whole gray values adds a twelfth to the variance.
    assert flat(level, noise=0.5, full_well=5000.0).var() == pytest.approx(0.25 + 255 * level / 5000 + 1 / 12, rel=0.03)


def test_a_mosaic_makes_noise_alike_in_neighbours_and_keeps_the_gray_value() -> None:
    plain, mosaic = flat(120.0, full_well=5000.0), flat(120.0, full_well=5000.0, mosaic=True)
    assert abs(neighbours(plain)) < 0.02
    assert 0.3 < neighbours(mosaic) < 0.6
    assert mosaic.mean() == pytest.approx(120.0, abs=0.1)
    assert mosaic.std() < plain.std()


@pytest.mark.parametrize("radius", [0.5, 1.0, 3.0, 7.3])
def test_a_point_out_of_focus_becomes_a_disc_of_that_radius(radius: float) -> None:
    kernel = disc(radius)
    x = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1.0)
    np.testing.assert_array_equal(kernel, kernel.T)
    # An even disc's mean square distance along one direction is a quarter of its radius squared; pixels add a twelfth.
    assert kernel.sum(axis=0) @ x**2 == pytest.approx(radius**2 / 4 + 1 / 12, abs=0.15)


def test_vignetting_takes_its_share_in_the_corners_and_nothing_in_the_middle() -> None:
    gray = flat(200.0, vignetting=0.4)
    assert gray[0, 0] == gray[-1, -1] == 120.0
    assert gray[119:121, 159:161].mean() == 200.0


def test_a_compressed_file_keeps_less_of_the_noise() -> None:
    before = np.unique(flat(120.0, noise=3.0, jpeg_quality=95))
    assert len(np.unique(flat(120.0, noise=1.0, jpeg_quality=20))) < len(before)


def test_a_whole_picture_shows_what_was_read_out_in_its_windows_under_the_same_exposure() -> None:
    lamp = Lamp(np.array([0.5, 0.3, 1.0]), falloff=0.8)
    settings = replace(ALL, noise=0.5, full_well=8000.0, auto_exposure=0.3, stamp_offset=0.002, stamp_drift=1e-3)
    window = [Window(140, 100, 41, 3)]
    with RenderedCamera(CameraModel.default(), STRAIGHT, settings, np.random.default_rng(1), lamp=lamp) as camera:
        fields = [camera.windows(t, lambda t: tool_over(0.7 * t), window) for t in camera.due(0.0, 0.4)]
        early = camera.whole(fields[3], lambda t: tool_over(0.7 * t))
        part = early[100:103, 140:181]
        np.testing.assert_array_equal(part, fields[3].patches[0])
        assert np.abs(early[97:100, 140:181].mean() - part.mean()) < 3.0
        later = camera.windows(camera.due(0.0, 0.4)[3], lambda t: tool_over(0.7 * t), window).patches[0]
        np.testing.assert_array_equal(later, part)


def test_the_quick_camera_develops_its_pictures_alike() -> None:
    model, rng = CameraModel.default(), np.random.default_rng(1)
    tool = tool_over(0.0, 0.004, 0.3)
    with RenderedCamera(model, STRAIGHT, ALL, rng) as camera:
        rendered = camera.frame(tool).astype(float)
    live = LiveCamera(model, STRAIGHT, ALL, rng).picture([tool]).astype(float)
    assert np.abs(rendered - live).mean() < 2.0
