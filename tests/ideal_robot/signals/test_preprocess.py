"""Filtering keeps what the motion says, and treats torque and regressor alike."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from ideal_robot.errors import InputError
from ideal_robot.signals.preprocess import chosen_cutoff, decimated, decimation_taps, lowpass, preprocess
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.segments import alone, segments


def sines(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    w = 2 * np.pi * np.array([0.5, 1.3])
    return np.sin(np.outer(t, w)), w * np.cos(np.outer(t, w)), -(w**2) * np.sin(np.outer(t, w))


def test_derivatives_of_irregular_samples() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.008, 0.012, 2000))
    q, _, _ = sines(t)
    s = preprocess(Recording.from_arrays(t, q=q, tau=q))
    inside = slice(100, -100)
    _, qd, qdd = sines(s.t)
    np.testing.assert_allclose(s.qd[inside], qd[inside], atol=0.02 * np.abs(qd).max())
    np.testing.assert_allclose(s.qdd[inside], qdd[inside], atol=0.03 * np.abs(qdd).max())
    assert np.allclose(np.diff(s.t), s.dt)


def test_filters_have_no_phase() -> None:
    t = np.arange(0, 10, 0.002)
    x = np.sin(2 * np.pi * 1.0 * t)[:, None]
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
    there = (t < 8) | (t > 9)
    s = preprocess(Recording.from_arrays(t[there], q=q[there], tau=q[there]))
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
    found = [x for x in segments(s) if x.joint == 0]
    constant = [x for x in found if x.kind == "constant"]
    assert len(constant) == 2
    assert constant[0].velocity == pytest.approx(0.5, rel=0.02)
    assert constant[1].velocity == pytest.approx(-0.5, rel=0.02)
    assert sum(x.kind == "reversal" for x in found) == 1
    assert sum(x.kind == "rest" for x in found) == 2
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
