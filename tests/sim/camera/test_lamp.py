"""A lamp's light and the arm's shadow on the surface are where geometry puts them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.robots.robot import Robot
from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Window
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import RenderedCamera
from sim.camera.camera_settings import CameraSettings
from sim.camera.lamp import ArmShape, Lamp, covered, light, mirrored
from sim.camera.surface import DrawnLine
from tests.sensing.camera.synthetic import tool_over

LINE = DrawnLine.from_plane_points(np.array([[-0.1, 0.0], [0.3, 0.0]]), pin.SE3.Identity())
QUIET = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0, resolution=0.0005)
UP = np.array([0.0, 0.0, 1.0])
LAMP = Lamp(np.array([0.0, 0.0, 2.0]), radius=0.02)
ROD = (np.array([[[0.0, -1.0, 1.0], [0.0, 1.0, 1.0]]]), np.array([0.05]))
"""Half way to the lamp: its shadow on the surface is twice as wide."""


def test_a_rod_half_way_to_the_lamp_casts_a_shadow_of_twice_its_width() -> None:
    x = np.linspace(-0.3, 0.3, 2001)
    points = np.column_stack([x, np.full_like(x, 0.1), np.zeros_like(x)])
    hidden = covered(points, LAMP.place, LAMP.radius, *ROD)
    edge = float(np.interp(-0.5, -hidden[x > 0], x[x > 0]))
    # The ray that touches the rod: sin(angle) = r / distance, of a rod 1 m below the lamp.
    assert edge == pytest.approx(2.0 * np.tan(np.arcsin(0.05)), rel=2e-3)
    assert hidden[np.abs(x) < 0.08].min() == 1.0
    assert hidden[np.abs(x) > 0.13].max() == 0.0


def test_light_fades_by_lamberts_law_and_is_one_where_it_is_measured() -> None:
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    lit = light(replace(LAMP, falloff=1.0, shadow=0.0), points, UP, points[0], np.zeros(2))
    # 45° and sqrt(2) times as far: cos 45° / 2.
    np.testing.assert_allclose(lit, [1.0, np.sqrt(0.5) / 2.0], rtol=1e-12)


def test_the_lamp_is_mirrored_half_way_to_an_eye_of_the_same_height_and_moves_with_it() -> None:
    x = np.linspace(-1.0, 1.0, 401)
    points = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    for eye in (0.4, 0.8):
        seen = mirrored(LAMP, points, UP, np.array([eye, 0.0, 2.0]), np.zeros(len(x)))
        assert x[np.argmax(seen)] == pytest.approx(0.5 * eye, abs=0.006)
        assert seen.max() == pytest.approx(LAMP.glare, rel=1e-3)
    assert not mirrored(LAMP, points, UP, np.array([0.4, 0.0, 2.0]), np.ones(len(x))).any()


def test_an_arm_of_primitives_and_one_of_rods_have_a_shape() -> None:
    robot = Robot.load("kr6")
    shape = ArmShape(robot)
    ends = shape.at(robot.home)
    tool = robot.fk()(robot.home).translation
    assert ends.shape == (len(shape.radii), 2, 3)
    assert np.linalg.norm(ends.reshape(-1, 3) - tool, axis=1).min() < 0.2
    assert np.abs(shape.at(robot.home + 0.3) - ends).max() > 0.05


def test_the_arms_shadow_darkens_the_picture_where_it_falls() -> None:
    lamp = Lamp(np.array([0.1, 0.0, 2.0]), falloff=0.0, shadow=0.5, glare=0.0)
    rod = (np.array([[[0.065, -1.0, 1.0], [0.065, 1.0, 1.0]]]), np.array([0.02]))
    whole = Window(0, 0, 320, 240)
    with RenderedCamera(CameraModel.default(), LINE, QUIET, np.random.default_rng(0), lamp=lamp) as camera:
        free, shaded = (camera.windows(0.005, lambda t: tool_over(0.0), [whole], shape).patches[0].astype(float)
                        for shape in ((), rod))
    share = (shaded / free)[:, 40]
    assert share.min() == pytest.approx(0.5, abs=0.01)
    assert share.max() == pytest.approx(1.0, abs=0.01)
    rows = np.flatnonzero(share < 0.75)
    camera_model = CameraModel.default()
    x = camera_model.on_plane(np.array([[40.0, rows[0]], [40.0, rows[-1]]]), UP, 0.0)[:, 0]
    # Half way down the shadow lies as far on the other side of the rod as the lamp on this one, and is 80 mm wide.
    assert x.mean() == pytest.approx(0.03, abs=0.003)
    assert np.ptp(x) == pytest.approx(0.08, abs=0.004)


def test_the_exposure_follows_the_light_with_its_lag() -> None:
    lamp = Lamp(np.array([0.0, 0.0, 2.0]), falloff=0.0, shadow=0.5, glare=0.0)
    all_dark = (np.array([[[0.0, -1.0, 1.0], [0.0, 1.0, 1.0]]]), np.array([0.9]))
    settings = replace(QUIET, auto_exposure=0.1)
    window = [Window(10, 10, 8, 8)]
    with RenderedCamera(CameraModel.default(), LINE, settings, np.random.default_rng(0), lamp=lamp) as camera:
        def gray(t: float, shape: tuple[np.ndarray, ...]) -> float:
            return float(camera.windows(t, lambda t: tool_over(0.0), window, shape).patches[0].mean())

        light_before = gray(0.005, ())
        dark = [gray(0.005 + 0.02 * k, all_dark) for k in range(1, 40)]
        camera.restart()
        anew = gray(0.005, all_dark)
    # After the first step in the shadow the gain is 1 + (1 - exp(-0.2)) of the way to 2.
    assert dark[0] == pytest.approx(0.5 * light_before * (2.0 - np.exp(-0.2)), abs=1.0)
    assert dark[-1] == pytest.approx(light_before, abs=1.0)
    assert anew == pytest.approx(light_before, abs=1.0)


def test_pybullet_shows_the_tool_and_its_hose_in_the_edge_of_the_picture_only() -> None:
    with (BulletCamera(CameraModel.default(), LINE, QUIET, np.random.default_rng(0)) as bare,
          BulletCamera(CameraModel.default(), LINE, QUIET, np.random.default_rng(0), tool=True) as tooled):
        changed = np.abs(tooled.frame(tool_over(0.1)).astype(float) - bare.frame(tool_over(0.1))) > 20
    model = CameraModel.default()
    ahead = model.on_plane(np.array([[160.0, float(np.flatnonzero(changed.any(axis=1))[0])]]), UP, 0.0)[0, 0]
    assert 0.02 < changed.mean() < 0.12
    assert ahead < 0.02


def test_a_field_may_come_twice_and_always_the_same_ones_do() -> None:
    with RenderedCamera(CameraModel.default(), LINE, replace(QUIET, doubled=0.3), np.random.default_rng(0)) as camera:
        times = camera.due(0.0, 20.0)
        twice = [camera.comes_twice(t) for t in times]
        assert 0.25 < np.mean(twice) < 0.35
        assert [camera.comes_twice(t) for t in reversed(times)] == twice[::-1]


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_shadow_on_a_place_does_not_depend_on_its_neighbours(seed: int) -> None:
    """Capsules that a group of places cannot see are left out for all of them at once."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.3, 0.3, (90, 2)), np.zeros(90)])
    points[:45] = 0.02 * points[:45] + rng.uniform(-0.3, 0.3, 3)
    ends = rng.uniform(-0.4, 0.4, (7, 2, 3)) + np.array([0.0, 0.0, 0.9])
    radii = rng.uniform(0.005, 0.15, 7)
    lamp, size = np.array([0.1, -0.2, 1.8]), float(rng.choice([0.0, 0.02, 0.2]))
    alone = [covered(point[None], lamp, size, ends, radii)[0] for point in points]
    np.testing.assert_array_equal(covered(points, lamp, size, ends, radii), alone)
    one_by_one = [covered(points, lamp, size, ends[k : k + 1], radii[k : k + 1]) for k in range(7)]
    np.testing.assert_array_equal(covered(points, lamp, size, ends, radii), np.max(one_by_one, axis=0))
