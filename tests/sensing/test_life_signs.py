"""Signs of life: what is dead, leaps or contradicts is noticed, and what is alive is not suspected."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from sensing.life_signs import LifeSigns

NOISE = np.repeat([0.3, 0.02], 3)


def alive(seed: int = 0) -> tuple[LifeSigns, np.random.Generator]:
    rng, signs = np.random.default_rng(seed), LifeSigns(1e5, ["a", "b", "c", "d", "e", "f"])
    signs.learn([NOISE * rng.standard_normal((80, 6)) + 5.0 * rng.standard_normal(6) for _ in range(7)])
    return signs, rng


@settings(max_examples=8)
@given(st.integers(0, 1000))
def test_a_live_sensor_is_believed_whatever_it_feels(seed: int) -> None:
    signs, rng = alive(seed)
    np.testing.assert_allclose(signs.noise, NOISE, rtol=0.15)
    reach = np.repeat([8.0, np.inf], 3)
    force = np.cumsum(rng.uniform(-3.0, 3.0, (1000, 6)), axis=0)
    assert all(signs.check(row + NOISE * rng.standard_normal(6), reach) for row in force)
    # However many values come at a time: of few the mean scatters more.
    for values in (1, 3, 12):
        for innovation in rng.chisquare(values, 1000) / values:
            signs.fits(float(innovation), values)
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
    accepted = [signs.check(NOISE * lives * rng.standard_normal(6)) for _ in range(10)]
    assert not all(accepted)
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
        signs.fits(float("nan") if k % 20 == 0 else float(rng.chisquare(3) / 3), 3)
    assert signs.fault is None
    for _ in range(16):
        signs.fits(3.0, 3)
    assert "does not change as the arm moves" in str(signs.fault)


def coloured(rng: np.random.Generator, count: int, colour: float) -> np.ndarray:
    """Noise of variance 1 that keeps this share of itself from one reading to the next."""
    fresh = np.sqrt(1.0 - colour**2) * rng.standard_normal(count)
    fresh[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -colour], fresh))


def swung(seed: int, lives: float, noise: float, roughness: float, lost: int = 0, colour: float = 0.0) -> LifeSigns:
    """Two seconds at 250 Hz on 4 N/mm: a tip that swings by 0.5 N, and a surface under it that goes by millimetres.

    Each quarter of a second ``lost`` cycles of 12 ms are lost: the arm goes on, the path's time does not. The sensor's
    noise is heard at rest before.
    """
    rng, signs = np.random.default_rng(seed), LifeSigns(1e5, ["a"])
    signs.learn([noise * coloured(rng, 80, colour)[:, None] for _ in range(7)])
    t = np.arange(500) * 0.004
    place = 0.2 * t
    surface = 5e-3 * np.sin(2.0 * np.pi * 5.0 * place + seed)
    height = surface - 1.25e-4 * np.sin(2.0 * np.pi * 10.0 * t)
    surface = surface + roughness * rng.standard_normal(500)
    force = 20.0 + lives * 4000.0 * (surface - height) + noise * coloured(rng, 500, colour)
    gone = np.where(t % 0.25 < 0.012 * (lost + 1), 0.004 / (lost + 1), 0.004)
    felt = np.column_stack([np.cumsum(gone), place, height, force])
    for k in range(0, 500, 3):
        signs.swings(felt[k : k + 3])
        signs.answers(4000.0, 10.0)
    return signs


@settings(max_examples=20)
@given(st.integers(0, 1000), st.floats(0.1, 1.0), st.floats(0.0, 1e-4), st.integers(0, 4))
def test_a_live_sensor_answers_whatever_surface_it_is_on(seed: int, noise: float, roughness: float, lost: int) -> None:
    assert swung(seed, 1.0, noise, roughness, lost).fault is None
    assert swung(seed, 0.75, 0.4 * noise, 0.4 * roughness, lost).fault is None


@settings(max_examples=30)
@given(st.integers(0, 1000), st.floats(0.1, 1.5), st.floats(0.0, 0.97), st.integers(0, 4))
def test_noise_of_any_colour_is_no_missing_answer(seed: int, noise: float, colour: float, lost: int) -> None:
    assert swung(seed, 1.0, noise, 0.0, lost, colour).fault is None


@pytest.mark.parametrize(("noise", "colour"), [(0.3, 0.0), (1.0, 0.0), (0.6, 0.8)])
def test_a_swing_as_loud_as_the_noise_asks_for_is_heard_in_time(noise: float, colour: float) -> None:
    """Of a dead sensor: one twice as loud nearly always within the time of one asking, one half as loud hardly ever."""
    for times, least, most in ((2.0, 27, 30), (0.5, 0, 3)):
        heard = 0
        for seed in range(30):
            rng, signs = np.random.default_rng(seed), LifeSigns(1e5, ["a"])
            signs.learn([noise * coloured(rng, 80, colour)[:, None] for _ in range(20)])
            assert signs.noise is not None
            t, loud = 0.004 * np.arange(50), signs.loudness(float(signs.noise[0]), 10.0, 0.004)
            height = -times * loud / 4000.0 * np.sin(2.0 * np.pi * 10.0 * t)
            signs.swings(np.column_stack([t, 0.2 * t, height, 20.0 + noise * coloured(rng, 50, colour)]))
            signs.answers(4000.0, 10.0)
            heard += signs.fault is not None
        assert least <= heard <= most


@pytest.mark.parametrize("colour", [0.3, 0.9])
def test_the_colour_of_the_noise_is_learned_at_rest(colour: float) -> None:
    rng, signs = np.random.default_rng(4), LifeSigns(1e5, ["a", "b"])
    signs.learn([5.0 + np.column_stack([coloured(rng, 80, colour), coloured(rng, 80, colour)]) for _ in range(20)])
    assert signs.colour == pytest.approx(colour, abs=0.1)


@settings(max_examples=20)
@given(st.integers(0, 1000), st.floats(0.0, 0.3), st.integers(0, 4))
def test_a_sensor_that_does_not_answer_is_named(seed: int, noise: float, lost: int) -> None:
    assert "% of what the tip's swing" in str(swung(seed, 0.0, noise, 0.0, lost).fault)


@given(st.integers(0, 500), st.floats(0.0, 0.005), st.floats(0.0, 0.1))
@settings(max_examples=30)
def test_even_stamps_are_believed_however_late_messages_are(seed: int, late: float, lost: float) -> None:
    rng, (signs, _) = np.random.default_rng(seed), alive()
    for t in 0.02 * np.flatnonzero(rng.random(400) >= lost):
        signs.stamped(float(t) + 2e-4 * rng.standard_normal(), float(t) + 0.04 + rng.exponential(late))
    assert signs.fault is None


@given(st.integers(0, 500), st.floats(0.03, 0.3), st.integers(0, 8))
@settings(max_examples=30)
def test_messages_that_are_lost_behind_a_delay_do_not_make_stamps_wander(seed: int, delay: float, lost: int) -> None:
    """A computer that stood still for 50 ms: what waited came together, and what did not fit was left out."""
    rng, (signs, _) = np.random.default_rng(seed), alive()
    stands, ends = 2.0, 2.0 + delay
    for k, t in enumerate(0.02 * np.arange(400)):
        if not 0 <= k - round(ends / 0.02) < lost:
            came = max(float(t) + 0.02 + rng.exponential(0.0005), ends if t >= stands else 0.0)
            signs.stamped(float(t) + 2e-4 * rng.standard_normal(), came)
    assert signs.fault is None


@pytest.mark.parametrize("width", [0.01, 0.05])
def test_stamps_that_wander_more_than_their_messages_are_a_fault(width: float) -> None:
    signs, rng = alive()
    for t in 0.02 * np.arange(30):
        signs.stamped(float(t) + width * rng.uniform(-0.5, 0.5), float(t) + 0.04 + rng.exponential(0.0005))
    assert "time stamps wander" in str(signs.fault)


def test_a_sensor_that_repeats_itself_is_stuck_and_one_whose_other_channels_move_is_not() -> None:
    """Without its noise known: 25 readings in a row that are the same, bit by bit, are one too many."""
    rng, signs = np.random.default_rng(3), LifeSigns(1e5, ["a", "b"])
    same = np.array([1.0, 2.0])
    assert [signs.check(same) for _ in range(30)] == [True] * 25 + [False] * 5
    assert signs.stuck == 5
    assert signs.missing == ["5 stuck"]
    # It comes back by one change, however small; a channel that never changes is no reason while another does.
    assert all(signs.check(same + np.array([1e-9 * rng.standard_normal(), 0.0])) for _ in range(100))
    assert signs.fault is None


def test_what_is_left_out_is_told_by_its_cause() -> None:
    signs, rng = alive()
    # Eight changes of nothing are too few of a channel's noise.
    assert [signs.check(np.zeros(6)) for _ in range(12)] == [True] * 8 + [False] * 4
    signs.check(np.full(6, np.nan))
    assert signs.missing == ["1 impossible", "4 without noise"]
    leaping, rng = alive(1)
    for k in range(20):
        leaping.check(NOISE * rng.standard_normal(6) + 50.0 * (k == 10), 1.0)
    assert leaping.missing == ["1 leapt"]


@pytest.mark.parametrize("reach", [0.0, 4.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_leap_is_what_goes_beyond_the_reach_by_more_than_noise(reach: float, sign: float) -> None:
    """One channel changes by what it may and 7 of its standard deviations, or 9: eight of them are the bound."""
    for channel in range(6):
        for deviations, sound in ((7.0, True), (9.0, False)):
            signs, _ = alive()
            assert signs.noise is not None
            assert signs.check(np.zeros(6), reach)
            step = sign * (reach + deviations * signs.noise[channel]) * np.eye(6)[channel]
            assert signs.check(step, reach) == sound
            # Compared is with the last sound one.
            assert signs.check(np.zeros(6), reach)


def test_a_new_beginning_forgets_what_was_felt_and_keeps_what_was_learned() -> None:
    signs, rng = alive()
    assert signs.check(NOISE * rng.standard_normal(6), 1.0)
    signs.begin()
    assert signs.check(NOISE * rng.standard_normal(6) + 500.0, 1.0)
    np.testing.assert_allclose(signs.noise, NOISE, rtol=0.15)


@pytest.mark.parametrize(("values", "limit"), [(1, 4.014), (3, 2.443), (12, 1.624)])
def test_innovations_contradict_where_noise_comes_so_far_once_in_ten_million(values: int, limit: float) -> None:
    for mean, fault in ((limit - 0.01, False), (limit + 0.01, True)):
        signs, _ = alive()
        for _ in range(16):
            assert signs.fault is None
            signs.fits(mean, values)
        assert (signs.fault is not None) == fault
        # One that was refused counts as ten, however far off it was.
        for wrong in (float("nan"), 1e9):
            signs, _ = alive()
            for value in [(16 * mean - 10.0) / 15] * 15 + [wrong]:
                signs.fits(value, values)
            assert (signs.fault is not None) == fault



def _stamped(seed: int, wander: float, lost: float, count: int = 50) -> LifeSigns:
    rng, (signs, _) = np.random.default_rng(seed), alive()
    for t in 0.02 * np.flatnonzero(rng.random(round(count / (1.0 - lost))) >= lost):
        signs.stamped(float(t) + wander * rng.standard_normal(), float(t) + 0.04 + rng.exponential(0.0003))
    return signs


@pytest.mark.parametrize("lost", [0.0, 0.1])
def test_of_stamps_that_wander_by_some_milliseconds_nearly_all_are_found(lost: float) -> None:
    """Standard deviation 0.7 ms is allowed; four times the bound is found where fields are lost as well."""
    assert sum(_stamped(seed, 0.0007, lost).fault is None for seed in range(40)) >= 38
    assert sum(_stamped(seed, 0.004, lost).fault is not None for seed in range(40)) >= 38


@pytest.mark.slow
def test_messages_that_are_lost_are_nothing_uneven() -> None:
    """Where a tenth was lost and the rest came 5 ms sooner or later, every fifth sound sensor was refused."""
    refused = 0
    for seed in range(40):
        rng, (signs, _) = np.random.default_rng(seed), alive()
        for t in 0.02 * np.flatnonzero(rng.random(600) >= 0.1):
            signs.stamped(float(t) + 1e-4 * rng.standard_normal(), float(t) + 0.04 + 0.005 * rng.standard_normal())
        refused += signs.fault is not None
    assert refused <= 1


def test_stamps_are_judged_from_twenty_messages_on_and_by_how_far_they_wander() -> None:
    assert _stamped(1, 0.02, 0.0, 19).fault is None
    fault = str(_stamped(1, 0.02, 0.0, 20).fault)
    spread = float(fault.partition("wander by ")[2].partition(" ms")[0])
    assert spread == pytest.approx(20.0, rel=0.4)
