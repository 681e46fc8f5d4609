"""The quick camera shows what the rendered one shows."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Window
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import RenderedCamera
from sim.camera.camera_settings import CameraSettings
from sim.camera.lamp import Lamp
from sim.camera.live_camera import LiveCamera
from sim.camera.surface import DrawnLine
from sim.contact.contact import HeightSurface, Wave


def cell(relief: bool) -> tuple[RenderedCamera, LiveCamera]:
    plane = pin.SE3(pin.rpy.rpyToMatrix(0.02, -0.03, 0.4), np.array([0.9, 0.1, 0.3]))
    x = np.linspace(-0.3, 0.3, 1201)
    line = DrawnLine.from_plane_points(np.column_stack([x, 0.02 * np.sin(12 * x)]), plane)
    model, settings, rng = CameraModel.default(), CameraSettings(noise=0.0), np.random.default_rng(1)
    height = HeightSurface(plane, (Wave(0.003, 0.3),), 0.3, 0.1, 0.002, (0.01, 0.02)) if relief else None
    rendered = (RenderedCamera(model, line, settings, rng) if height is None else
                BulletCamera(model, line, settings, rng, relief=height))
    return rendered, LiveCamera(model, line, settings, rng, relief=height)


def middle(image: np.ndarray) -> np.ndarray:
    """Column of the line's centre of darkness in every row [px]."""
    dark = np.clip(200.0 - image.astype(float), 0.0, None)
    return dark @ np.arange(image.shape[1]) / dark.sum(axis=1)


@pytest.mark.parametrize("relief", [False, True])
def test_both_cameras_see_the_line_in_the_same_place(relief: bool) -> None:
    rendered, live = cell(relief)
    with rendered:
        for turn, x in ((0.0, -0.1), (0.05, 0.0), (-0.05, 0.1)):
            pose = rendered.surface.plane * pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.03, turn), np.array([x, 0.0, 0.003]))
            one, other = rendered.frame(pose), live.picture([pose])
            rows = slice(20, -20)
            assert np.abs(middle(one)[rows] - middle(other)[rows]).max() < 0.15
            assert np.abs(one.astype(float) - other.astype(float))[rows].mean() < 1.0


def test_lamp_shadow_and_tool_are_in_the_same_places() -> None:
    rendered, _ = cell(False)
    plane, settings = rendered.surface.plane, CameraSettings(noise=0.0)
    lamp = Lamp(plane.act(np.array([0.3, 0.4, 0.8])))
    ends = np.array([[plane.act(np.array([0.05, 0.1, 0.2])), plane.act(np.array([0.15, 0.1, 0.25]))]])
    shape = (ends, np.array([0.03]))
    pose = plane * pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, 0.05), np.array([0.0, 0.0, 0.003]))
    rng = np.random.default_rng(1)
    live = LiveCamera(rendered.model, rendered.surface, settings, rng, lamp=lamp, tool=True)
    with BulletCamera(rendered.model, rendered.surface, settings, rng, tool=True, lamp=lamp) as full:
        whole = [Window(0, 0, full.model.width, full.model.height)]
        lit = full._lit(*full._sampled(whole, [pose], 2), whole, pose, shape).reshape(full.model.height, -1)
    picture = live.picture([pose], 0.0, shape).astype(float)
    off = np.abs(np.clip(lit, 0, 255) - picture)
    # Outlines of tool and shadow are a pixel or two apart at most; everything else is alike.
    assert np.median(off) < 1.0
    assert (off > 12.0).mean() < 0.02
    assert picture.min() < 60.0
