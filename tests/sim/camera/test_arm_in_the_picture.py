"""The arm's links are in the camera's picture where they come into view, and only then; the shadow is theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from scenes import load_scene
from scenes.line.cell import Cell, set_up
from sensing.camera.camera_device import Window
from sensing.camera.camera_model import CameraModel
from sim.camera import arm_bodies
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.lamp import ArmShape, Lamp, covered, light, mirrored
from sim.camera.surface import DrawnLine
from tests.sensing.camera.synthetic import tool_over

QUIET = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0, resolution=0.0005)
PLAIN = CameraModel.default(distortion=(0.0,) * 5)
WHOLE = [Window(0, 0, 320, 240)]
LINES = ("line", "corner", "gap", "cluttered", "svg", "straight")
BRACKET = (np.array([0.17, 0.0, 0.02]), np.array([0.01, 0.025, 0.08]))
"""Middle and half sides of the plate on the KR 6-like arm's link 6, in its frame (``kr6.urdf``) [m]."""


def over_the_line(robot: Robot) -> tuple[Array, pin.SE3, DrawnLine]:
    """Home, the TCP there, and a line that lies under it."""
    pose = robot.fk()(robot.home)
    plane = pin.SE3(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.zeros(3))
    return robot.home, pose, DrawnLine.from_plane_points(np.array([[-0.1, 0.0], [0.3, 0.0]]), pose * plane)


def picture(camera: BulletCamera, pose: pin.SE3, q: Array | None, shape: Sequence[Array] = ()) -> Array:
    return camera.windows(0.005, lambda t: pose, WHOLE, shape, q).patches[0].astype(float)


def test_a_link_in_view_covers_what_its_corners_enclose() -> None:
    robot = Robot.load("kr6").with_tool(0.2)
    q, pose, line = over_the_line(robot)
    with BulletCamera(PLAIN, line, QUIET, np.random.default_rng(0), arm=robot) as camera:
        share, shown = covered_by_arm(camera, q, pose), picture(camera, pose, q)
    with BulletCamera(PLAIN, line, QUIET, np.random.default_rng(0)) as camera:
        bare = picture(camera, pose, q)
    beside = cv2.dilate((share > 0.0).astype(np.uint8), np.ones((5, 5))) == 0
    np.testing.assert_array_equal(shown[beside], bare[beside])
    data = robot.pinocchio.createData()
    pin.forwardKinematics(robot.pinocchio, data, q)
    middle, half = BRACKET
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = np.array([(pose.inverse() * data.oMi[6]).act(middle + sign * half) for sign in signs])
    mask = np.zeros((240, 320), dtype=np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(PLAIN.project_tool(corners).astype(np.float32)).astype(np.int32), 1)
    assert share[cv2.erode(mask, np.ones((7, 7))) > 0].min() == 1.0
    # Above the plate there is nothing of the arm.
    assert not share[: np.flatnonzero(mask.any(axis=1))[0] - 2].any()


def test_no_shadow_and_no_mirror_image_fall_on_the_arm_in_the_picture() -> None:
    robot = Robot.load("kr6").with_tool(0.2)
    q, pose, line = over_the_line(robot)
    lamp = Lamp(pose.translation + np.array([0.3, 0.2, 1.5]), falloff=0.0, shadow=0.5, glare=60.0)
    everywhere = (np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]]) + lamp.place - np.array([0.0, 0.0, 0.7]),
                  np.array([0.6]))
    with BulletCamera(PLAIN, line, QUIET, np.random.default_rng(0), arm=robot, lamp=lamp) as camera:
        lit, dark = picture(camera, pose, q), picture(camera, pose, q, everywhere)
    share = dark / lit
    assert share[:100].max() < 0.7
    np.testing.assert_allclose(share[200:, 120:200], 1.0, atol=1e-9)


def along(cell: Cell) -> Sequence[tuple[Array, pin.SE3]]:
    """Angles and TCP every 50 mm of the reference."""
    kinematics, pose, q = InverseKinematics(cell.known.robot), cell.known.robot.fk(), cell.known.robot.home
    postures: list[tuple[Array, pin.SE3]] = []
    for s in np.arange(0.0, cell.known.reference.length, 0.05):
        q = kinematics.search(cell.known.reference.pose(s), q)
        postures.append((q, pose(q)))
    return postures


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name == "corner" else pytest.mark.slow)
                                  for name in LINES])
def test_behind_a_tool_of_300_mm_no_link_comes_into_view_on_any_line(name: str) -> None:
    cell = set_up(load_scene(name).changed(tool_mm=300.0))
    line = DrawnLine.from_plane_points(np.array([[0.0, 0.0], [0.1, 0.0]]), cell.geometry.plane)
    with BulletCamera(cell.true_camera, line, QUIET, np.random.default_rng(0), arm=cell.known.robot) as camera:
        assert not any(covered_by_arm(camera, q, pose).any() for q, pose in along(cell))


def test_without_a_tool_the_wrist_would_be_all_that_the_camera_sees() -> None:
    """Why the arm is in the picture only with a tool: the default cell has camera and wrist in the same place."""
    cell = set_up(load_scene("line"))
    with BulletCamera(cell.true_camera, cell.line, QUIET, np.random.default_rng(0), arm=cell.known.robot) as camera:
        assert np.mean([covered_by_arm(camera, q, pose) for q, pose in along(cell)]) > 0.7


def test_what_a_window_cannot_show_is_left_out_without_a_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows all over the picture, with wrist, tool and hose in it, drawn with what each may show and with all."""
    robot = Robot.load("kr6").with_tool(0.2)
    q, pose, line = over_the_line(robot)
    rng = np.random.default_rng(4)
    windows = [Window(int(u), int(v), int(w), int(h)) for u, v, w, h in
               zip(*(rng.integers(*span, 60) for span in ((0, 280), (0, 225), (1, 40), (1, 15))), strict=True)]
    poses = [pose * pin.SE3(pin.exp3(np.array([0.0, 0.0, a])), np.array([a, 0.0, 0.0])) for a in (-1e-3, 0.0, 1e-3)]

    def drawn(all_of_it: bool) -> tuple[list[bool], Array, Array]:
        with BulletCamera(CameraModel.default(), line, replace(QUIET, sub_exposures=3), np.random.default_rng(0),
                          arm=robot, tool=True) as camera:
            if all_of_it:
                monkeypatch.setattr(arm_bodies, "_in_front", lambda seen, *_: np.ones((len(windows), len(seen)), bool))
                monkeypatch.setattr(camera, "_tool_in", lambda *_: True)
            camera._stand(q, pose)
            gray, bare = camera._sampled(windows, poses, 2)
            by_window = camera.arm.shown(windows) if camera.arm is not None else []
            return [bool(bodies) for bodies in by_window], gray, np.asarray(bare)

    shown, gray, bare = drawn(False)
    _, gray_all, bare_all = drawn(True)
    assert 5 < sum(shown) < 55
    assert 0.0 < (bare < 0.5).mean() < 0.9
    np.testing.assert_array_equal(gray, gray_all)
    np.testing.assert_allclose(bare, bare_all, atol=1e-12)


def test_a_tool_behind_the_camera_is_in_no_picture() -> None:
    """A camera below the tool's tip, which looks down like any other."""
    below = PLAIN.T_tool_camera.copy()
    below.translation = np.array([0.0, 0.0, 0.01])
    model = replace(PLAIN, T_tool_camera=below)
    _, pose, line = over_the_line(Robot.load("kr6"))
    higher = pin.SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, 0.2]))
    with BulletCamera(model, line, QUIET, np.random.default_rng(0), tool=True) as camera:
        frame = camera.frame(higher)
    with BulletCamera(model, line, QUIET, np.random.default_rng(0)) as camera:
        np.testing.assert_array_equal(frame, camera.frame(higher))


def covered_by_arm(camera: BulletCamera, q: Array, pose: pin.SE3) -> Array:
    """Share of each pixel ``(240, 320)`` that links cover."""
    camera._stand(q, pose)
    return (1.0 - np.broadcast_to(camera._sampled(WHOLE, [pose], 1)[1], (240 * 320,))).reshape(240, 320)


def test_the_shadow_of_a_tool_reaches_the_tcp() -> None:
    bare = Robot.load("kr6")
    robot = bare.with_tool(0.25)
    tip, flange = robot.fk()(robot.home), bare.fk()(bare.home)
    assert robot.tool_length == pytest.approx(0.25)
    np.testing.assert_allclose(flange.actInv(tip.translation), [0.0, 0.0, 0.25], atol=1e-12)
    ends = ArmShape(robot).at(robot.home)[-1]
    np.testing.assert_allclose(ends, [flange.translation, tip.translation], atol=1e-12)
    assert len(ArmShape(robot).radii) == len(ArmShape(bare).radii) + 1


# A lamp's light and the arm's shadow on the surface are where geometry puts them.

LINE = DrawnLine.from_plane_points(np.array([[-0.1, 0.0], [0.3, 0.0]]), pin.SE3.Identity())
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
        glare = mirrored(LAMP, points, UP, np.array([eye, 0.0, 2.0]), np.zeros(len(x)))
        assert x[np.argmax(glare)] == pytest.approx(0.5 * eye, abs=0.006)
        assert glare.max() == pytest.approx(LAMP.glare, rel=1e-3)
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
