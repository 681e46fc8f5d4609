"""Filtering keeps what the motion says, and treats torque and regressor alike."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.signals.channels import alone, segments
from ideal_robot.signals.cutoff import CutoffChoice, choose_cutoff
from ideal_robot.signals.error_budget import error_budget
from ideal_robot.signals.filters import decimated, decimation_taps, filtered_at, forwards_and_backwards, lowpass
from ideal_robot.signals.preprocess import FilteredSignals, chosen_cutoff, preprocess
from ideal_robot.signals.recording import Recording


def sines(t: np.ndarray, hertz: np.ndarray = np.array([0.5, 1.3])) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    w = 2 * np.pi * hertz
    return np.sin(np.outer(t, w)), w * np.cos(np.outer(t, w)), -(w**2) * np.sin(np.outer(t, w))


def test_derivatives_of_irregular_samples() -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(0.008, 0.012, 2000))
    q, _, _ = sines(t)
    s = preprocess(Recording.from_arrays(t, q=q, tau=q))
    inside = slice(100, -100)
    _, qd, qdd = sines(s.t)
    np.testing.assert_allclose(s.qd[inside], qd[inside], atol=0.02 * np.abs(qd).max())
    np.testing.assert_allclose(s.qdd[inside], qdd[inside], atol=0.03 * np.abs(qdd).max())
    assert np.allclose(np.diff(s.t), s.dt)


def test_filters_have_no_phase() -> None:
    x = np.sin(2 * np.pi * 1.0 * np.arange(0, 10, 0.002))[:, None]
    np.testing.assert_allclose(lowpass(x, 0.002, 10.0)[500:-500], x[500:-500], atol=1e-3)
    np.testing.assert_allclose(decimated(x, 10)[50:-50], x[::10][50:-50], atol=1e-2)


def test_torque_and_columns_are_decimated_alike() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0, 20, 0.002)
    q, _, qdd = sines(t)
    s = preprocess(Recording.from_arrays(t, q=q, tau=3.0 * qdd + rng.normal(size=q.shape)))
    a, y = s.decimate(s.qdd), s.decimate(s.tau)
    assert len(a) == len(y) == s.keep.sum() == len(s.t_decimated)
    np.testing.assert_allclose(np.sum(a * y, axis=0) / np.sum(a * a, axis=0), 3.0, rtol=0.02)


def test_piecewise_decimation_is_the_same() -> None:
    t = np.arange(0, 60, 0.002)
    q, _, _ = sines(t)
    s = preprocess(Recording.from_arrays(t, q=q, tau=q))
    whole, scale = s.decimate(s.qdd), np.max(np.abs(s.qdd))
    at_once = s.decimate_motion(lambda rows: s.qdd[rows], block=10**9)
    np.testing.assert_allclose(s.decimate_motion(lambda rows: s.qdd[rows], block=3000), at_once, atol=1e-9)
    assert s.stride > 1
    np.testing.assert_allclose(at_once[5:-5], whole[5:-5], atol=1e-5 * scale)


def test_cutoff_follows_the_motion_not_the_noise() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(0, 20, 0.002)
    slow, fast = (np.sin(2 * np.pi * f * t)[:, None] for f in (0.5, 4.0))
    noise = 1e-5 * rng.normal(size=slow.shape)
    assert 3.0 < chosen_cutoff(slow + noise, 0.002) < 15.0
    assert 30.0 < chosen_cutoff(fast + noise, 0.002) < 60.0


def test_holes_are_not_trusted() -> None:
    t = np.arange(0, 20, 0.01)
    q, _, _ = sines(t)
    recorded = (t < 8) | (t > 9)
    s = preprocess(Recording.from_arrays(t[recorded], q=q[recorded], tau=q[recorded]))
    assert not np.any((s.t_decimated > 8.0) & (s.t_decimated < 9.0))


def test_bad_cutoff_and_short_recordings_are_refused() -> None:
    t = np.arange(0, 5, 0.01)
    recording = Recording.from_arrays(t, q=sines(t)[0], tau=sines(t)[0])
    with pytest.raises(InputError, match="half the sampling rate"):
        preprocess(recording, cutoff=60.0)
    with pytest.raises(InputError, match="one oscillation"):
        preprocess(recording, cutoff=20.0, cutoff_decimation=0.0)
    with pytest.raises(InputError, match="too short"):
        preprocess(Recording.from_arrays(t[:50], q=sines(t)[0][:50], tau=sines(t)[0][:50]))


def test_segments_of_a_trapezoidal_motion() -> None:
    dt = 0.002
    v = np.concatenate([np.zeros(500), np.linspace(0, 0.5, 100), np.full(1000, 0.5), np.linspace(0.5, -0.5, 200),
                        np.full(1000, -0.5), np.linspace(-0.5, 0, 100), np.zeros(500)])
    q = np.column_stack([np.cumsum(v) * dt, 1e-9 * np.arange(len(v))])
    s = preprocess(Recording.from_arrays(np.arange(len(v)) * dt, q=q, tau=q), cutoff=20.0)
    parts = [x for x in segments(s) if x.joint == 0]
    constant = [x for x in parts if x.kind == "constant"]
    assert len(constant) == 2
    assert constant[0].velocity == pytest.approx(0.5, rel=0.02)
    assert constant[1].velocity == pytest.approx(-0.5, rel=0.02)
    assert sum(x.kind == "reversal" for x in parts) == 1
    assert sum(x.kind == "rest" for x in parts) == 2
    assert len(alone(s, 0)) == 1
    assert alone(s, 1) == []


@pytest.mark.parametrize(("count", "factor"), [(3000, 12), (1001, 7), (50, 3), (1000, 2), (9, 5)])
def test_decimation_is_scipys_polyphase_filter_column_by_column(count: int, factor: int) -> None:
    x = np.random.default_rng(0).normal(size=(count, 2, 3))
    x[:, 1, 2] = 0.0
    expected = signal.resample_poly(x, 1, factor, axis=0, window=decimation_taps(factor))
    np.testing.assert_allclose(decimated(x, factor), expected, atol=1e-12)
    np.testing.assert_allclose(decimated(x[:, 0, 0], factor), expected[:, 0, 0], atol=1e-12)
    assert decimated(x[:, :, :0], factor).shape == (len(expected), 2, 0)
    np.testing.assert_array_equal(lowpass(x, 0.002, 20.0)[:, 1, 2], 0.0)


# The cut-off is chosen by what it predicts, not by how the spectrum looks.

T = np.arange(0.0, 40.0, 0.002)


def columns(s: FilteredSignals, stride: int) -> Array:
    return np.stack([s.qdd, s.qd, s.q], axis=-1)[::stride]


def swung(t: np.ndarray, hertz: np.ndarray, rng: np.random.Generator, scale: float = 0.0) -> Recording:
    """A mass, damper and spring, with positions that are off by ``scale``."""
    q, qd, qdd = (np.sum(values, axis=1)[:, None] for values in sines(t, hertz))
    tau = 3.0 * qdd + 5.0 * qd + 2.0 * q + 0.1 * rng.normal(size=q.shape)
    return Recording.from_arrays(t, q=q + scale * rng.normal(size=q.shape), tau=tau)


def choice_of(*recordings: Recording) -> CutoffChoice:
    return choose_cutoff(recordings, columns, start=np.zeros(3), information=np.zeros((3, 3)))


def chosen(scale: float, frequency: float, rng: np.random.Generator) -> CutoffChoice:
    return choice_of(swung(T, frequency * np.array([1.0, 1.37, 2.3]), rng, scale))


def test_noise_of_the_position_lowers_it_and_motion_raises_it() -> None:
    rng = np.random.default_rng(1)
    noisy, quick = chosen(3e-3, 0.4, rng), chosen(1e-5, 2.0, rng)
    assert noisy.cutoff <= 10.0
    assert quick.cutoff >= 15.0
    assert noisy.errors[max(noisy.errors)] > 1.05 * noisy.errors[noisy.cutoff]


def test_all_candidates_are_judged_in_one_band_and_a_limit_is_named() -> None:
    choice = chosen(1e-5, 2.0, np.random.default_rng(2))
    assert 2.0 <= choice.band <= 10.0
    assert choice.cutoff_decimation == 0.5 * choice.cutoff
    stopped = CutoffChoice(4.0, 2.0, 2.5, {4.0: 0.1, 5.0: 0.2}, "lower")
    assert stopped.warning.startswith("cutoff-at-limit: the position filter of 4 Hz")


def test_many_recordings_with_holes_leave_each_filter_its_seconds() -> None:
    """Ten stretches of a long recording, each with the logger's pause in its first seconds, failed as too short."""
    rng = np.random.default_rng(3)
    t = np.concatenate([np.arange(0.0, 3.0, 0.002), np.arange(3.5, 30.0, 0.002)])
    parts = [swung(t + 30.0 * k, 0.4 * np.array([1.0, 1.37, 2.3]), rng) for k in range(10)]
    assert min(choice_of(*parts).errors) == 4.0


def test_a_recording_too_short_for_slow_filters_is_left_the_quicker_ones() -> None:
    choice = choice_of(swung(np.arange(0.0, 4.0, 0.002), np.array([0.7, 1.6]), np.random.default_rng(4)))
    assert 4.0 < min(choice.errors) <= choice.cutoff


# The error budget says how far velocity and acceleration are from the truth.

TIMES = np.arange(0.0, 60.0, 0.004)


def path(t: np.ndarray) -> np.ndarray:
    return np.column_stack([np.sin(1.1 * t), 0.7 * np.cos(1.7 * t)])


def errors(recording: Recording) -> tuple[FilteredSignals, np.ndarray, np.ndarray]:
    """Decimated errors of velocity and acceleration against the same filters without an error."""
    s = preprocess(recording, cutoff=10.0)
    exact = preprocess(Recording.from_arrays(TIMES, q=path(TIMES), tau=path(TIMES)), cutoff=10.0)
    return s, s.decimate(s.qd - exact.qd), s.decimate(s.qdd - exact.qdd)


@pytest.mark.parametrize("kind", ["noise", "steps"])
def test_it_is_as_large_as_the_error(kind: str) -> None:
    rng = np.random.default_rng(1)
    q = path(TIMES)
    q = q + 2e-4 * rng.normal(size=q.shape) if kind == "noise" else 1e-3 * np.round(q / 1e-3)
    recording = Recording.from_arrays(TIMES, q=q, tau=q)
    s, velocity, acceleration = errors(recording)
    budget = error_budget(recording, s)
    # Steps are not quite white: slow passages repeat them.
    spread = 0.15 if kind == "noise" else 0.4
    np.testing.assert_allclose(np.mean(budget.velocity, axis=0), np.std(velocity, axis=0), rtol=spread)
    np.testing.assert_allclose(np.mean(budget.acceleration, axis=0), np.std(acceleration, axis=0), rtol=spread)
    np.testing.assert_allclose(budget.step, 1e-3 if kind == "steps" else 0.0, rtol=1e-6)


# A filter at few instants gives what the filter of all samples gives there.

STEP = 0.004
SMOOTH = lowpass(np.random.default_rng(0).normal(size=(3000, 4, 2)), STEP, 6.0)
SMOOTH[:, 1, 0] = 0.0


@pytest.mark.parametrize("stride", [1, 3, 7])
def test_decimation_of_every_few_samples(stride: int) -> None:
    factor = 40
    expected = decimated(SMOOTH, factor)[12:-12]
    places = factor * np.arange(12, 63)
    filtered = filtered_at(SMOOTH[::stride], places / stride, decimation_taps(factor), fine=stride)
    np.testing.assert_allclose(filtered, expected, atol=1e-4 * np.abs(SMOOTH).max())
    np.testing.assert_array_equal(filtered[:, 1, 0], 0.0)


@pytest.mark.parametrize("stride", [1, 4])
def test_low_pass_between_samples_and_near_the_ends(stride: int) -> None:
    band, reach = 2.0, 500
    kernel = lowpass(np.eye(1, 2 * reach + 1, reach)[0], STEP, band)
    place = np.concatenate([[100.0, 130.25, 131.0], np.arange(150.0, 2800.0, 61.7)])
    filtered = filtered_at(SMOOTH[::stride], place / stride, kernel, fine=stride, odd=True)
    whole = signal.sosfiltfilt(signal.butter(4, 2 * band * STEP, output="sos"), SMOOTH, axis=0, padlen=1000)
    index = place.astype(int)
    share = (place - index)[:, None, None]
    expected = (1.0 - share) * whole[index] + share * whole[index + 1]
    np.testing.assert_allclose(filtered, expected, atol=2e-3 * np.abs(SMOOTH).max())


def test_a_constant_stays_what_it_is_everywhere() -> None:
    kernel = np.hanning(61)
    np.testing.assert_allclose(filtered_at(np.full((50, 1), 3.0), np.linspace(0.0, 49.0, 33), kernel, odd=True), 3.0)


# The filter over all columns at once gives what SciPy gives column by column.

@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.3), (4, 0.02), (5, 0.4)])
def test_as_scipy_has_it(order: int, cutoff: float) -> None:
    values = np.cumsum(np.random.default_rng(1).standard_normal((500, 7)), axis=0)
    sections = signal.butter(order, cutoff, output="sos")
    expected = signal.sosfiltfilt(sections, values, axis=0, padlen=120)
    np.testing.assert_allclose(forwards_and_backwards(sections, values, 120), expected, rtol=0.0, atol=1e-12)


def test_any_shape_and_columns_of_numbers_that_are_none() -> None:
    values = np.random.default_rng(2).standard_normal((300, 2, 3))
    values[:, 1, 2] = np.nan
    filtered = lowpass(values, 0.01, 5.0)
    assert filtered.shape == values.shape
    assert np.isnan(filtered[:, 1, 2]).all()
    np.testing.assert_array_equal(filtered[:, 0, 1], lowpass(values[:, 0, 1], 0.01, 5.0))
