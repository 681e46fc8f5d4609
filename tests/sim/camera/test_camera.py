"""What the rendered camera does in time and gray values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning.line.measurement import LineAhead
from sensing.camera.camera_device import Window
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import Observation, calibrate, calibration_poses
from sensing.camera.line_detection import PredictedLine, at_middle_row, detect_line, search_windows
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.lamp import Lamp
from sim.camera.live_camera import LiveCamera
from sim.camera.surface import DrawnLine, Texture, paint
from sim.contact.contact import HeightSurface, Wave
from tests.sensing.camera.synthetic import tool_over
from tests.sensing.camera.test_hand_eye import DRAWN, ORIGIN, REFERENCE
from tests.sensing.camera.test_hand_eye import UP as NORMAL

LINE = DrawnLine.from_plane_points(np.array([[-0.1, 0.0], [0.3, 0.0]]), pin.SE3.Identity())
QUIET = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0)
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def texture() -> Texture:
    return paint(LINE)


def camera(texture: Texture, settings: CameraSettings, seed: int = 0) -> RenderedCamera:
    return RenderedCamera(CameraModel.default(), LINE, settings, np.random.default_rng(seed), texture)


def noted() -> tuple[list[float], Callable[[float], pin.SE3]]:
    """Times at which the pose of a tool at rest was asked for, and what tells it."""
    instants: list[float] = []
    return instants, lambda t: (instants.append(t), tool_over(0.0))[1]


def test_fields_are_due_when_their_exposure_ends(texture: Texture) -> None:
    with camera(texture, CameraSettings(rate=50.0, exposure=0.004, phase=0.005)) as cam:
        cycles = [cam.due(0.012 * k, 0.012 * (k + 1)) for k in range(1000)]
        times = [t for due in cycles for t in due]
        np.testing.assert_allclose(times, 0.005 + 0.02 * np.arange(600), atol=1e-9)
        assert all(0.012 * k <= t + 0.002 + 1e-9 and t + 0.002 < 0.012 * (k + 1) + 1e-9
                   for k, due in enumerate(cycles) for t in due)
        assert cam.due(0.0, 0.0069) == []
        assert cam.due(0.0, 0.0071) == pytest.approx([0.005])


def test_lost_fields_are_lost_once_and_for_all(texture: Texture) -> None:
    with camera(texture, replace(QUIET, loss=0.2)) as cam:
        times = cam.due(0.0, 20.0)
        assert 720 < len(times) < 880
        again = [t for k in range(200) for t in cam.due(0.1 * k, 0.1 * (k + 1))]
        assert again == times


def test_time_stamp_latency_and_jitter(texture: Texture) -> None:
    settings = CameraSettings(latency=0.04, jitter=0.002, stamp_offset=0.0005, stamp_noise=0.0001)
    with camera(texture, settings) as cam:
        times = np.array(cam.due(0.0, 8.0))
        fields = [cam.windows(t, lambda t: tool_over(0.0), []) for t in times]
    stamp = np.array([f.t_stamp for f in fields]) - times
    late = np.array([f.t_arrival for f in fields]) - times
    assert stamp.mean() == pytest.approx(0.0005, abs=2e-5)
    assert stamp.std() == pytest.approx(0.0001, rel=0.15)
    assert late.mean() == pytest.approx(0.04, abs=4e-4)
    assert late.std() == pytest.approx(0.002, rel=0.15)


def test_no_field_arrives_before_its_exposure_ends(texture: Texture) -> None:
    with camera(texture, CameraSettings(latency=0.0, jitter=0.01)) as cam:
        for t in cam.due(0.0, 1.0):
            assert cam.windows(t, lambda t: tool_over(0.0), []).t_arrival >= t + 0.001


def test_same_seed_same_field_whatever_was_asked_before(texture: Texture) -> None:
    window = [Window(150, 100, 21, 3)]
    with camera(texture, CameraSettings(loss=0.1), seed=3) as a, camera(texture, CameraSettings(loss=0.1), seed=3) as b:
        times = a.due(0.0, 0.5)
        for t in times:
            a.windows(t, lambda t: tool_over(0.0), window)
        last_a = a.windows(times[-1], lambda t: tool_over(0.0), window)
        last_b = b.windows(times[-1], lambda t: tool_over(0.0), window)
    assert last_a.t_stamp == last_b.t_stamp
    assert last_a.t_arrival == last_b.t_arrival
    np.testing.assert_array_equal(last_a.patches[0], last_b.patches[0])
    with camera(texture, CameraSettings(loss=0.1), seed=4) as c:
        assert c.windows(times[-1], lambda t: tool_over(0.0), window).t_stamp != last_a.t_stamp


def test_gray_noise(texture: Texture) -> None:
    with camera(texture, replace(QUIET, noise=5.0)) as cam:
        patch = cam.windows(0.005, lambda t: tool_over(0.0), [Window(20, 20, 60, 40)]).patches[0]
    assert patch.mean() == pytest.approx(200.0, abs=0.5)
    assert patch.std() == pytest.approx(5.0, rel=0.08)


def test_windows_are_crops_of_the_whole_image(texture: Texture) -> None:
    tool = tool_over(0.0, 0.004, 0.3)
    with camera(texture, QUIET) as cam:
        frame = cam.frame(tool).astype(float)
        windows = [Window(0, 0, 30, 20), Window(140, 100, 41, 3), Window(150, 60, 3, 41), Window(290, 220, 30, 20)]
        for window, patch in zip(windows, cam.windows(0.005, lambda t: tool, windows).patches, strict=True):
            part = frame[window.v : window.v + window.height, window.u : window.u + window.width]
            # Both alias on the soft edge, each on its own grid of samples.
            assert np.abs(part - patch).mean() < 3.0
    assert frame.min() < 60


def test_motion_blurs_along_the_motion_only(texture: Texture) -> None:
    """4 mm of motion across the line in one exposure make it wider and shallower; along the line nothing changes."""
    settings = replace(QUIET, exposure=0.004, sub_exposures=12)
    window = [Window(130, 118, 60, 1)]
    depth = {}
    with camera(texture, settings) as cam:
        for name, vx, vy in (("still", 0.0, 0.0), ("along", 1.0, 0.0), ("across", 0.0, 1.0)):
            field = cam.windows(1.005, lambda t, vx=vx, vy=vy: tool_over(vx * (t - 1.005), vy * (t - 1.005)), window)
            depth[name] = 200.0 - field.patches[0].astype(float)[0]
    np.testing.assert_allclose(depth["along"], depth["still"], atol=3)
    assert depth["across"].max() < 0.85 * depth["still"].max()
    assert depth["across"].sum() == pytest.approx(depth["still"].sum(), rel=0.02)
    middle = {name: d @ np.arange(60) / d.sum() for name, d in depth.items()}
    assert middle["across"] == pytest.approx(middle["still"], abs=0.02)


def test_poses_are_asked_for_within_the_exposure_only(texture: Texture) -> None:
    instants, pose_at = noted()
    with camera(texture, CameraSettings(exposure=0.006, sub_exposures=5)) as cam:
        cam.windows(0.105, pose_at, [Window(0, 0, 3, 3)])
    assert len(instants) == 5
    assert min(instants) >= 0.102
    assert max(instants) <= 0.108
    assert np.mean(instants) == pytest.approx(0.105)


def test_empty_windows_give_empty_patches_and_wrong_ones_are_refused(texture: Texture) -> None:
    with camera(texture, QUIET) as cam:
        assert cam.windows(0.005, lambda t: tool_over(0.0), [Window(0, 0, 0, 0)]).patches[0].shape == (0, 0)
        for window in (Window(-1, 0, 5, 5), Window(318, 0, 3, 3), Window(0, 238, 3, 3), Window(0, 0, -2, 3)):
            with pytest.raises(InputError, match="outside the image"):
                cam.windows(0.005, lambda t: tool_over(0.0), [window])


@pytest.mark.parametrize(("name", "value"), [
    ("latency", -0.01), ("rate", 0.0), ("exposure", 0.03), ("loss", 1.0), ("noise", float("nan")), ("supersampling", 0),
    ("vignetting", 1.0), ("jpeg_quality", 101), ("full_well", -1.0), ("defocus_px", float("nan"))])
def test_impossible_settings_are_named(name: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"camera\.{name}"):
        CameraSettings(**{name: value})  # type: ignore[arg-type]


def test_a_lens_that_cannot_be_drawn_is_refused(texture: Texture) -> None:
    folded = CameraModel.default(distortion=(-1.5, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"camera\.distortion"):
        RenderedCamera(folded, LINE, QUIET, np.random.default_rng(0), texture)


@pytest.mark.parametrize("yaw", [0.0, 0.4, 1.2, -1.5])
def test_rendered_and_detected_line_points_lie_on_the_analytic_line(texture: Texture, yaw: float) -> None:
    """The whole chain without disturbances: true pose, rendering, detection, back-projection."""
    rng = np.random.default_rng(1)
    model = CameraModel.default()
    errors = []
    with camera(texture, QUIET) as cam:
        for _ in range(10):
            # The view's middle on the line near x = 0.1, the tool wherever that puts it.
            view = np.array([0.1, 0.0]) + rng.uniform(-0.01, 0.01, 2)
            tool = tool_over(view[0] - 0.065 * np.cos(yaw), view[1] - 0.065 * np.sin(yaw), yaw)
            points, tangents = LINE.at(0.2 + np.linspace(-0.04, 0.04, 5))
            aside = points + np.array([0.0, 0.0005, 0.0])
            prediction = PredictedLine.from_base(aside, tangents, UP, tool, 0.001)
            field = cam.windows(0.005, lambda t, tool=tool: tool, search_windows(model, prediction))
            detection = detect_line(field, model, prediction)
            assert detection.used.all()
            errors.append(LINE.distance(detection.points_tcp @ tool.rotation.T + tool.translation))
    assert np.mean(errors) < 15e-6
    assert np.max(errors) < 60e-6


# A rolling readout: rows are exposed one after the other, and whoever is told of it loses nothing by it.

READOUT = 0.02
X = np.linspace(-0.1, 0.4, 1001)
READ_LINE = DrawnLine.from_plane_points(np.column_stack([X, 0.02 * np.sin(12.0 * X)]), pin.SE3.Identity())
READ_QUIET = CameraSettings(noise=0.0, jitter=0.0, stamp_noise=0.0)
ROLLING = replace(READ_QUIET, rolling=READOUT)
T0 = 0.205


def moving(t: float) -> pin.SE3:
    """0.7 m/s along x, 0.2 m/s aside, and turning by 2 rad/s."""
    return tool_over(0.05 + 0.7 * (t - T0), 0.2 * (t - T0), 0.3 + 2.0 * (t - T0))


def errors(settings: CameraSettings, told: float) -> Array:
    """Distance of the points from the drawn line in the base frame ``(5,)`` [m], NaN where none is used."""
    model = replace(CameraModel.default(), readout=told)
    points, tangents = READ_LINE.at(0.15 + np.linspace(0.02, 0.10, 5))
    aside = points + np.array([0.0, 0.0005, 0.0])
    ahead = LineAhead(np.arange(5.0), aside, tangents, np.tile(NORMAL, (5, 1)), np.full(5, 0.001))
    prediction = ahead.seen_by(model, T0, moving)
    with RenderedCamera(model, READ_LINE, settings, np.random.default_rng(0)) as camera:
        field = camera.windows(T0, moving, search_windows(model, prediction))
    detected = at_middle_row(detect_line(field, model, prediction), model, moving)
    pose = moving(field.t_stamp)
    return np.where(detected.used, READ_LINE.distance(detected.points_tcp @ pose.rotation.T + pose.translation), np.nan)


def test_points_seen_on_the_way_are_as_exact_as_those_of_one_instant_where_the_readout_is_told() -> None:
    at_once, told, untold = errors(READ_QUIET, 0.0), errors(ROLLING, READOUT), errors(ROLLING, 0.0)
    assert np.isfinite(at_once).all()
    assert np.isfinite(told).all()
    assert told.max() < at_once.max() + 4e-5
    # The tool goes aside by 2 mm in half a readout.
    assert np.nanmax(untold) > 5e-4 or np.isnan(untold).all()


@pytest.mark.parametrize("kind", [RenderedCamera, BulletCamera])
def test_what_does_not_move_looks_the_same(kind: type[RenderedCamera]) -> None:
    windows, gray = [Window(140, 40, 41, 3), Window(140, 200, 41, 3)], CameraSettings()
    tall = [Window(150, 60, 3, 61)] if kind is RenderedCamera else []
    patches = []
    for settings in (gray, replace(gray, rolling=READOUT)):
        with kind(CameraModel.default(), READ_LINE, settings, np.random.default_rng(0)) as camera:
            patches.append(camera.windows(0.025, lambda t: tool_over(0.05), windows + tall).patches)
    for at_once, rolling in zip(*patches, strict=True):
        np.testing.assert_array_equal(at_once, rolling)


@pytest.mark.parametrize("kind", [RenderedCamera, BulletCamera])
def test_each_row_shows_the_arm_where_it_is_then(kind: type[RenderedCamera]) -> None:
    """A row of the rolling picture is that row of the picture taken at once from where the tool is by then."""
    with (kind(CameraModel.default(), READ_LINE, READ_QUIET, np.random.default_rng(0)) as at_once,
          kind(CameraModel.default(), READ_LINE, ROLLING, np.random.default_rng(0)) as rolling):
        for row in (20, 118, 215):
            window = [Window(60, row, 200, 3)]
            delay = READOUT * ((row + 1) / 239 - 0.5)
            np.testing.assert_array_equal(
                rolling.windows(T0, moving, window).patches[0],
                at_once.windows(T0, lambda t, delay=delay: moving(t + delay), window).patches[0])


def test_no_pose_is_asked_for_before_the_start_or_behind_the_end_of_the_readout() -> None:
    instants, pose_at = noted()
    with RenderedCamera(CameraModel.default(), READ_LINE, ROLLING, np.random.default_rng(0)) as camera:
        for k in range(20):
            for t in camera.due(0.012 * k, 0.012 * (k + 1)):
                field = camera.windows(t, pose_at, [Window(0, 0, 20, 3), Window(0, 237, 20, 3)])
                assert max(instants) <= 0.012 * (k + 1)
                assert field.t_arrival >= max(instants)
    assert min(instants) >= 0.0
    assert np.ptp(instants[-6:]) > 0.9 * READOUT


def test_calibration_by_moving_takes_each_point_at_its_own_time() -> None:
    rng = np.random.default_rng(5)
    true = replace(CameraModel.default(), readout=READOUT)
    views = []
    for pose in calibration_poses(ORIGIN, np.array([1.0, 0.3, 0.0]) / np.hypot(1.0, 0.3), NORMAL, 0.065):
        velocity = 0.3 * pin.exp3(rng.uniform(0, 2 * np.pi) * NORMAL)[:, 0]
        middle = DRAWN.nearest(pose.act(np.array([0.065, 0.0, 0.0]))[None], NORMAL).s
        points = DRAWN.at(middle + np.linspace(-0.07, 0.07, 9))[0]
        pixels = true.project_tool((points - pose.translation) @ pose.rotation)
        for _ in range(6):
            late = pose.translation + true.row_delay(pixels)[:, None] * velocity
            pixels = true.project_tool((points - late) @ pose.rotation)
        inside = np.all((pixels > 5) & (pixels < (true.width - 5, true.height - 5)), axis=1)
        views.append(Observation(pose, pixels[inside], np.full(inside.sum(), 2e-5), velocity))
    told, untold = (calibrate(replace(true, readout=readout), views, REFERENCE, NORMAL) for readout in (READOUT, 0.0))
    assert told.residual_after < 5e-6
    assert untold.residual_after > 1e-4


def test_a_readout_slower_than_the_fields_is_refused() -> None:
    with pytest.raises(InputError, match=r"camera\.rolling_ms"):
        CameraSettings(rate=50.0, rolling=0.021)


# The quick camera shows what the rendered one shows.

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
            frame, picture = rendered.frame(pose), live.picture([pose])
            rows = slice(20, -20)
            assert np.abs(middle(frame)[rows] - middle(picture)[rows]).max() < 0.15
            assert np.abs(frame.astype(float) - picture.astype(float))[rows].mean() < 1.0


def test_a_relief_looks_as_if_it_were_in_one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever the camera is, what it takes out of the picture is not in the picture."""
    pieces, _ = cell(True)
    monkeypatch.setattr("sim.camera.bullet_camera.PIECE", 10.0)
    whole, _ = cell(True)
    rng = np.random.default_rng(0)
    assert isinstance(pieces, BulletCamera)
    assert isinstance(whole, BulletCamera)
    with pieces, whole:
        assert (len(whole._pieces), len(pieces._pieces)) == (1, 20)
        for x, y, lean, turn in rng.uniform([-0.4, -0.1, -0.3, -3.0], [0.4, 0.1, 0.3, 3.0], (4, 4)):
            pose = whole.surface.plane * pin.SE3(pin.rpy.rpyToMatrix(np.pi + lean, 0.03, turn), np.array([x, y, 0.01]))
            in_pieces, in_one = pieces.frame(pose).astype(int), whole.frame(pose).astype(int)
            # A texel's edge is rounded otherwise where the texture is cut.
            assert (np.abs(in_pieces - in_one) > 1).mean() < 2e-3
        assert 0 < sum(piece._shown for piece in pieces._pieces) < 20


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
