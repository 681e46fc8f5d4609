"""Pictures with what photographs have: noise of the light, mosaic, defocus, vignetting, compression."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from sensing.camera.camera_device import Window
from sensing.camera.camera_model import CameraModel
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.image_chain import ImageChain, disc
from sim.camera.lamp import Lamp
from sim.camera.live_camera import LiveCamera
from sim.camera.surface import DrawnLine
from tests.sensing.camera.synthetic import tool_over

LINE = DrawnLine.from_plane_points(np.array([[-0.1, 0.0], [0.3, 0.0]]), pin.SE3.Identity())
QUIET = CameraSettings(noise=0.0)
ALL = replace(QUIET, mosaic=True, defocus_px=1.3, vignetting=0.3, jpeg_quality=85)
WHOLE = Window(0, 0, 320, 240)


def flat(level: float, **settings: Any) -> np.ndarray:
    """Gray values of an even surface."""
    chain = ImageChain(320, 240, replace(QUIET, **settings))
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
    with RenderedCamera(CameraModel.default(), LINE, settings, np.random.default_rng(1)) as camera:
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
    seen = disc(radius)
    x = np.arange(len(seen)) - len(seen) // 2
    assert seen.sum() == pytest.approx(1.0)
    np.testing.assert_array_equal(seen, seen.T)
    # An even disc's mean square distance along one direction is a quarter of its radius squared; pixels add a twelfth.
    assert seen.sum(axis=0) @ x**2 == pytest.approx(radius**2 / 4 + 1 / 12, abs=0.15)


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
    with RenderedCamera(CameraModel.default(), LINE, settings, np.random.default_rng(1), lamp=lamp) as camera:
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
    with RenderedCamera(model, LINE, ALL, rng) as camera:
        one = camera.frame(tool).astype(float)
    other = LiveCamera(model, LINE, ALL, rng).picture([tool]).astype(float)
    assert np.abs(one - other).mean() < 2.0


@pytest.mark.parametrize("change", [{"vignetting": 1.0}, {"jpeg_quality": 101}, {"full_well": -1.0},
                                    {"defocus_px": float("nan")}])
def test_impossible_settings_are_named(change: dict[str, float]) -> None:
    with pytest.raises(InputError, match=rf"camera\.{next(iter(change))}"):
        CameraSettings(**change)  # type: ignore[arg-type]
