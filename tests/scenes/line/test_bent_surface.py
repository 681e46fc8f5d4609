"""A surface that is bent along the line: nothing at the line's ends, the bow in its middle, up or down by the seed."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from scenes import load_scene
from scenes.drawn_line import geometry
from scenes.line.bent_surface import bent_surface
from scenes.line.cell import STRIPS
from scenes.line.scene import LineScene
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_detection import PredictedLine, detect_line, search_windows
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera_settings import CameraSettings
from sim.camera.surface import DrawnLine
from tests.sensing.camera.synthetic import tool_over


def scene(**displacement: float) -> LineScene:
    return load_scene("line").changed(displacement=displacement)  # type: ignore[return-value]


def test_the_middle_is_out_of_the_plane_of_the_ends_by_the_bow() -> None:
    bent = scene(bow_mm=1.0)
    where = geometry(bent, np.random.default_rng(3))
    middles = set()
    for seed in range(8):
        surface = bent_surface(bent, where, np.random.default_rng(seed))
        assert surface is not None
        height = surface.height(where.drawn_xy[:, 0], where.drawn_xy[:, 1])
        assert np.abs(height).max() == pytest.approx(1e-3, rel=1e-4)
        assert np.abs(height[[0, -1]]).max() < 1e-4
        middles.add(round(1e3 * float(height[len(height) // 2])))
    assert middles == {-1, 1}


def test_a_flat_surface_has_no_relief_and_a_bent_one_needs_a_renderer() -> None:
    where = geometry(scene(), np.random.default_rng(3))
    assert bent_surface(scene(), where, np.random.default_rng(0)) is None
    with pytest.raises(InputError, match="renderer"):
        bent_surface(scene(bow_mm=1.0).changed(camera={"renderer": "sampled"}),  # type: ignore[arg-type]
                     where, np.random.default_rng(0))


def test_the_camera_sees_the_line_where_the_bent_surface_lifts_it() -> None:
    """Seen from aside, a place 2 mm higher looks nearer to the point below the camera by 2 mm of 250."""
    bent = scene(bow_mm=2.0)
    where = geometry(bent, np.random.default_rng(3))
    surface = next(one for one in (bent_surface(bent, where, np.random.default_rng(k)) for k in range(9))
                   if one is not None and one.waves[0].amplitude > 0)
    line, model = DrawnLine(where.drawn, where.plane), CameraModel.default()
    s = 0.5 * line.length + np.linspace(-0.03, 0.03, 5)
    points, tangents = line.at(s)
    up = where.plane.rotation[:, 2]
    xy = where.plane.actInv(points[2])
    heading = where.plane.rotation.T @ tangents[2]
    yaw = float(np.arctan2(heading[1], heading[0]))
    aside, lift = 0.025, 0.002
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    foot = xy[:2] - 0.065 * ahead + aside * np.array([-ahead[1], ahead[0]])
    tool = tool_over(*foot, yaw, plane=where.plane)
    prediction = PredictedLine.from_base(points, tangents, up, tool, 0.001)
    settings = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0)
    with BulletCamera(model, line, settings, np.random.default_rng(0), relief=surface, strips=STRIPS) as camera:
        field = camera.windows(0.025, lambda t: tool, search_windows(model, prediction))
    found = detect_line(field, model, prediction)
    assert found.used.all()
    assert np.abs(found.lateral[2]) == pytest.approx(aside * lift / (0.25 - lift), rel=0.15)
