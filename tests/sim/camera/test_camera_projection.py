"""The rendered picture obeys OpenCV's projection to a hundredth of a pixel, in whole images and in crops of them."""

from __future__ import annotations

import cv2
import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from sensing.camera.camera_model import CameraModel, default_mount
from sensing.camera.field import Window
from sim.camera.camera import RenderedCamera
from sim.camera.camera_settings import CameraSettings
from sim.camera.surface import DrawnLine
from sim.camera.texture import Texture
from tests.sensing.camera.synthetic import tool_over

RESOLUTION = 0.0002
RADIUS = 0.005
MARKS = np.array([[x, y] for x in (-0.06, -0.02, 0.03, 0.07) for y in (-0.08, -0.03, 0.04, 0.09)])
QUIET = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0, supersampling=4, sub_exposures=4)


def marks() -> Texture:
    """Dark round spots with the smooth profile (1 - r²/R²)², centres at ``MARKS``."""
    n = 1300
    image = np.full((n, n), 220.0)
    at = (np.arange(n) + 0.5 - n / 2) * RESOLUTION
    for x, y in MARKS:
        r2 = (at[None, :] - x) ** 2 + (-at[:, None] - y) ** 2
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
        at = expected_centroid(camera, T_camera_plane, mark)
        u, v = (int(i) - half for i in np.rint(at))
        if u >= 0 and v >= 0 and u + 2 * half < size[0] and v + 2 * half < size[1]:
            windows.append(Window(u, v, 2 * half + 1, 2 * half + 1))
            expected.append(at)
    assert len(windows) >= 7
    with RenderedCamera(camera, surface, QUIET, np.random.default_rng(0), marks()) as rendered:
        field = rendered.windows(0.1, lambda t: tool, windows)
        found = np.array([centroid(p.astype(float), w) for p, w in zip(field.patches, windows, strict=True)])
        frame = rendered.frame(tool)
    off = np.linalg.norm(found - np.array(expected), axis=1)
    assert off.max() < 0.01
    # The whole image holds the same, to what two samples a pixel can do.
    for window, patch in zip(windows, field.patches, strict=True):
        part = frame[window.v : window.v + window.height, window.u : window.u + window.width]
        assert np.abs(part.astype(float) - patch).mean() < 2.0
