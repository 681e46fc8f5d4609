"""The cut-off is chosen by what it predicts, not by how the spectrum looks."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.signals.cutoff import CutoffChoice, choose_cutoff
from ideal_robot.signals.preprocess import FilteredSignals
from ideal_robot.signals.recording import Recording

T = np.arange(0.0, 40.0, 0.002)


def columns(s: FilteredSignals, stride: int) -> Array:
    return np.stack([s.qdd, s.qd, s.q], axis=-1)[::stride]


def chosen(scale: float, frequency: float, rng: np.random.Generator) -> CutoffChoice:
    """Choice for a mass, damper and spring, with positions that are off by ``scale``."""
    w = 2.0 * np.pi * frequency * np.array([1.0, 1.37, 2.3])
    sine, cosine = np.sin(np.outer(T, w)), np.cos(np.outer(T, w))
    q, qd, qdd = (np.sum(values, axis=1)[:, None] for values in (sine, w * cosine, -(w**2) * sine))
    tau = 3.0 * qdd + 5.0 * qd + 2.0 * q + 0.1 * rng.normal(size=q.shape)
    recording = Recording.from_arrays(T, q=q + scale * rng.normal(size=q.shape), tau=tau)
    return choose_cutoff([recording], columns, start=np.zeros(3), information=np.zeros((3, 3)))


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
    parts = []
    for k in range(10):
        w = 2.0 * np.pi * 0.4 * np.array([1.0, 1.37, 2.3])
        phase = np.outer(t + 30.0 * k, w)
        q, qd, qdd = (np.sum(values, axis=1)[:, None]
                      for values in (np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)))
        tau = 3.0 * qdd + 5.0 * qd + 2.0 * q + 0.1 * rng.normal(size=q.shape)
        parts.append(Recording.from_arrays(t, q=q, tau=tau))
    choice = choose_cutoff(parts, columns, start=np.zeros(3), information=np.zeros((3, 3)))
    assert min(choice.errors) == 4.0


def test_a_recording_too_short_for_slow_filters_is_left_the_quicker_ones() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 4.0, 0.002)
    w = 2.0 * np.pi * np.array([0.7, 1.6])
    q, qd, qdd = (np.sum(values, axis=1)[:, None]
                  for values in (np.sin(np.outer(t, w)), w * np.cos(np.outer(t, w)), -(w**2) * np.sin(np.outer(t, w))))
    tau = 3.0 * qdd + 5.0 * qd + 2.0 * q + 0.1 * rng.normal(size=q.shape)
    choice = choose_cutoff([Recording.from_arrays(t, q=q, tau=tau)], columns, start=np.zeros(3),
                           information=np.zeros((3, 3)))
    assert 4.0 < min(choice.errors) <= choice.cutoff
