"""Signs of life: what is dead, leaps or contradicts is noticed, and what is alive is not suspected."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensing.life_signs import LifeSigns

NOISE = np.repeat([0.3, 0.02], 3)


def alive(seed: int = 0) -> tuple[LifeSigns, np.random.Generator]:
    rng, signs = np.random.default_rng(seed), LifeSigns(1e5, ["a", "b", "c", "d", "e", "f"])
    signs.learn([NOISE * rng.standard_normal((80, 6)) + 5.0 * rng.standard_normal(6) for _ in range(7)])
    return signs, rng


@settings(max_examples=20)
@given(st.integers(0, 1000))
def test_a_live_sensor_is_believed_whatever_it_feels(seed: int) -> None:
    signs, rng = alive(seed)
    np.testing.assert_allclose(signs.noise, NOISE, rtol=0.15)
    reach = np.repeat([8.0, np.inf], 3)
    force = np.cumsum(rng.uniform(-3.0, 3.0, (1000, 6)), axis=0)
    assert all(signs.check(row + NOISE * rng.standard_normal(6), reach) for row in force)
    for innovation in rng.chisquare(3, 1000) / 3:
        signs.fits(float(innovation))
    assert signs.fault is None
    assert signs.missing == []


@pytest.mark.parametrize("values", [np.full(6, np.nan), np.full(6, -1e9), np.array([0.0, 0, 0, 0, 0, np.inf])])
def test_readings_that_cannot_be_are_left_out(values: np.ndarray) -> None:
    signs, _ = alive()
    assert not signs.check(values)
    assert signs.impossible == 1
    assert signs.fault is None


@pytest.mark.parametrize("channel", range(6))
def test_one_channel_that_has_lost_its_noise_is_named_within_ten_readings(channel: int) -> None:
    signs, rng = alive()
    lives = np.arange(6) != channel
    taken = [signs.check(NOISE * lives * rng.standard_normal(6)) for _ in range(10)]
    assert not all(taken)
    assert f"{'abcdef'[channel]} has lost the noise" in str(signs.fault)


def test_a_leap_that_passes_is_left_out_and_one_that_stays_is_a_fault() -> None:
    signs, rng = alive()
    leap = np.eye(6)[2] * 15.0
    for k in range(200):
        assert signs.check(NOISE * rng.standard_normal(6) + leap * (k % 50 == 49), 8.0) == (k % 50 != 49)
    assert signs.leapt == 4
    assert signs.fault is None
    assert not any(signs.check(NOISE * rng.standard_normal(6) - leap, 8.0) for _ in range(3))
    assert "c leaps by" in str(signs.fault)


def test_what_contradicts_the_motion_is_a_fault_and_single_outliers_are_none() -> None:
    signs, rng = alive()
    for k in range(300):
        signs.fits(float("nan") if k % 20 == 0 else float(rng.chisquare(3) / 3))
    assert signs.fault is None
    for _ in range(16):
        signs.fits(3.0)
    assert "does not change as the arm moves" in str(signs.fault)


@given(st.integers(0, 500), st.floats(0.0, 0.005), st.floats(0.0, 0.1))
@settings(max_examples=30)
def test_even_stamps_are_believed_however_late_messages_are(seed: int, late: float, lost: float) -> None:
    rng, (signs, _) = np.random.default_rng(seed), alive()
    for t in 0.02 * np.flatnonzero(rng.random(400) >= lost):
        signs.stamped(float(t) + 2e-4 * rng.standard_normal(), float(t) + 0.04 + rng.exponential(late))
    assert signs.fault is None


@pytest.mark.parametrize("width", [0.01, 0.05])
def test_stamps_that_wander_more_than_their_messages_are_a_fault(width: float) -> None:
    signs, rng = alive()
    for t in 0.02 * np.arange(30):
        signs.stamped(float(t) + width * rng.uniform(-0.5, 0.5), float(t) + 0.04 + rng.exponential(0.0005))
    assert "time stamps wander" in str(signs.fault)
