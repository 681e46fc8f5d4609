"""Sampling the drawn plane and rendering it as a mesh by PyBullet are two ways to the same picture."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from sensing.camera.camera_model import CameraModel, default_mount
from sensing.camera.field import Window
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import RenderedCamera
from sim.camera.camera_settings import CameraSettings
from sim.camera.surface import DrawnLine, Feature
from tests.sensing.camera.synthetic import tool_over

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
