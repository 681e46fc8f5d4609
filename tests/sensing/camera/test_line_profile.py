"""One cross-section of a line: found, fitted, and its stated uncertainty honest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from sensing.camera.line_profile import find_sections, fit_section


def section(u0: float, width: float, slant: float = 0.0, columns: int = 31, rows: int = 3, dark: float = 160.0,
            tilt: float = 0.0, blur: float = 0.5) -> Array:
    """The blurred box itself, not rounded."""
    u = np.arange(columns)[None, :] - u0 - slant * (np.arange(rows)[:, None] - 0.5 * (rows - 1))
    erf = np.vectorize(math.erf)
    box = 0.5 * (erf((u + width / 2) / (blur * math.sqrt(2))) - erf((u - width / 2) / (blur * math.sqrt(2))))
    return np.asarray(200.0 + tilt * u - dark * box)


def gray(image: Array) -> NDArray[np.uint8]:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@given(u0=st.floats(12.0, 18.0), width=st.floats(2.5, 7.0), slant=st.floats(-1.0, 1.0), tilt=st.floats(-1.0, 1.0))
def test_a_clean_section_is_found_to_a_hundredth_of_a_pixel(u0: float, width: float, slant: float, tilt: float) -> None:
    found = find_sections(gray(section(u0, width, slant, tilt=tilt)), 15.0, slant, width, 0.5, 1.0, 30.0, 0.35)
    assert len(found) == 1
    assert found[0, 0] == pytest.approx(u0, abs=0.01)
    assert found[0, 1] == pytest.approx(width, abs=0.03)
    assert found[0, 2] == pytest.approx(160.0, rel=0.02)


@given(u0=st.floats(12.0, 18.0))
def test_bright_line_on_dark_ground(u0: float) -> None:
    found = find_sections(gray(255.0 - section(u0, 4.0)), 15.0, 0.0, 4.0, 0.5, -1.0, 30.0, 0.35)
    assert found[0, 0] == pytest.approx(u0, abs=0.01)
    assert len(find_sections(gray(255.0 - section(u0, 4.0)), 15.0, 0.0, 4.0, 0.5, 1.0, 30.0, 0.35)) == 0


def test_width_and_contrast_gates() -> None:
    accepted = [len(find_sections(gray(section(15.2, w)), 15.0, 0.0, 4.0, 0.5, 1.0, 30.0, 0.35))
                for w in (1.5, 2.4, 2.8, 4.0, 5.2, 5.8, 8.0)]
    assert accepted == [0, 0, 1, 1, 1, 0, 0]
    assert len(find_sections(gray(section(15.2, 4.0, dark=25.0)), 15.0, 0.0, 4.0, 0.5, 1.0, 30.0, 0.35)) == 0
    assert len(find_sections(gray(section(15.2, 4.0, dark=40.0)), 15.0, 0.0, 4.0, 0.5, 1.0, 30.0, 0.35)) == 1


def test_two_lines_give_two_candidates_nearest_to_the_prediction_first() -> None:
    image = section(9.3, 4.0) + section(21.6, 4.0) - 200.0
    for predicted, order in ((11.0, [9.3, 21.6]), (20.0, [21.6, 9.3])):
        found = find_sections(gray(image), predicted, 0.0, 4.0, 0.5, 1.0, 30.0, 0.35)
        np.testing.assert_allclose(found[:, 0], order, atol=0.02)


@pytest.mark.parametrize("image", [np.full((3, 31), 90), np.zeros((3, 31)), np.full((3, 4), 7), np.zeros((1, 1))])
def test_nothing_to_find(image: Array) -> None:
    assert len(find_sections(gray(image), 1.0, 0.0, 4.0, 0.5, 1.0, 30.0, 0.35)) == 0


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_pure_noise_is_rarely_a_line_and_never_a_crash(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hits = sum(len(find_sections(gray(120 + 10 * rng.standard_normal((3, 31))), 15.0, 0.0, 4.0, 0.5, 1.0, 30.0, 0.35))
               for _ in range(20))
    assert hits <= 1
    find_sections(rng.integers(0, 256, (3, 31)).astype(np.uint8), 15.0, 0.3, 4.0, 0.5, 1.0, 30.0, 0.35)


@pytest.mark.parametrize("noise", [2.0, 5.0, 10.0])
def test_stated_standard_deviation_is_the_true_one(noise: float) -> None:
    rng = np.random.default_rng(1)
    scaled = []
    for _ in range(400):
        u0 = rng.uniform(14.0, 16.0)
        image = section(u0, 4.0, 0.2) + noise * rng.standard_normal((3, 31))
        found, _, _, residual, spread = fit_section(gray(image), u0 + rng.uniform(-0.5, 0.5), 0.2, 4.0, 0.5, 1.0)
        scaled.append((found - u0) / (spread * residual))
    assert np.std(scaled) == pytest.approx(1.0, abs=0.12)
    assert abs(np.mean(scaled)) < 0.2
