"""A rolling readout: rows are exposed one after the other, and whoever is told of it loses nothing by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning.line.line_view import LineAhead
from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Window
from sensing.camera.hand_eye import Observation, calibrate, calibration_poses
from sensing.camera.line_detection import detect_line, search_windows
from sensing.camera.rolling_readout import at_middle_row
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import RenderedCamera
from sim.camera.camera_settings import CameraSettings
from sim.camera.surface import DrawnLine
from tests.sensing.camera.synthetic import tool_over
from tests.sensing.camera.test_hand_eye import DRAWN, ORIGIN, REFERENCE
from tests.sensing.camera.test_hand_eye import UP as NORMAL

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
    seen = at_middle_row(detect_line(field, model, prediction), model, moving)
    pose = moving(field.t_stamp)
    return np.where(seen.used, READ_LINE.distance(seen.points_tcp @ pose.rotation.T + pose.translation), np.nan)


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
    for one, other in zip(*patches, strict=True):
        np.testing.assert_array_equal(one, other)


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
    asked: list[float] = []

    def pose_at(t: float) -> pin.SE3:
        asked.append(t)
        return tool_over(0.0)

    with RenderedCamera(CameraModel.default(), READ_LINE, ROLLING, np.random.default_rng(0)) as camera:
        for k in range(20):
            for t in camera.due(0.012 * k, 0.012 * (k + 1)):
                field = camera.windows(t, pose_at, [Window(0, 0, 20, 3), Window(0, 237, 20, 3)])
                assert max(asked) <= 0.012 * (k + 1)
                assert field.t_arrival >= max(asked)
    assert min(asked) >= 0.0
    assert np.ptp(asked[-6:]) > 0.9 * READOUT


def test_calibration_by_moving_takes_each_point_at_its_own_time() -> None:
    rng = np.random.default_rng(5)
    true = replace(CameraModel.default(), readout=READOUT)
    found = []
    for pose in calibration_poses(ORIGIN, np.array([1.0, 0.3, 0.0]) / np.hypot(1.0, 0.3), NORMAL, 0.065):
        velocity = 0.3 * pin.exp3(rng.uniform(0, 2 * np.pi) * NORMAL)[:, 0]
        middle = DRAWN.nearest(pose.act(np.array([0.065, 0.0, 0.0]))[None], NORMAL).s
        points = DRAWN.at(middle + np.linspace(-0.07, 0.07, 9))[0]
        pixels = true.project_tool((points - pose.translation) @ pose.rotation)
        for _ in range(6):
            late = pose.translation + true.row_delay(pixels)[:, None] * velocity
            pixels = true.project_tool((points - late) @ pose.rotation)
        inside = np.all((pixels > 5) & (pixels < (true.width - 5, true.height - 5)), axis=1)
        found.append(Observation(pose, pixels[inside], np.full(inside.sum(), 2e-5), velocity))
    told, untold = (calibrate(replace(true, readout=one), found, REFERENCE, NORMAL) for one in (READOUT, 0.0))
    assert told.residual_after < 5e-6
    assert untold.residual_after > 1e-4


def test_a_readout_slower_than_the_fields_is_refused() -> None:
    with pytest.raises(InputError, match=r"camera\.rolling_ms"):
        CameraSettings(rate=50.0, rolling=0.021)
