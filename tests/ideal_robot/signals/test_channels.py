"""Channels are recognised for what they are, and ordinary ones are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from ideal_robot.signals.channels import channel_findings, dead_joints, filtered_above, lattice
from ideal_robot.signals.recording import Recording

T = np.arange(0.0, 20.0, 0.004)


def motion() -> np.ndarray:
    return np.column_stack([np.sin(1.3 * T), np.cos(0.9 * T)])


def torque(rng: np.random.Generator) -> np.ndarray:
    return 10.0 * np.column_stack([np.sin(1.3 * T + 0.3), np.cos(2.1 * T)]) + 0.1 * rng.normal(size=(len(T), 2))


def kinds(tau: np.ndarray, q: np.ndarray | None = None, t: np.ndarray = T) -> list[tuple[str, str]]:
    found = channel_findings(Recording.from_arrays(t, q=motion() if q is None else q, tau=tau))
    return [(f.kind, f.column) for f in found]


def test_ordinary_channels_are_left_alone() -> None:
    assert kinds(torque(np.random.default_rng(0))) == []


def test_dead_stepped_clipped_and_filtered() -> None:
    rng = np.random.default_rng(1)
    tau = torque(rng)
    dead = tau.copy()
    dead[rng.random(len(T)) < 0.8, 1] = 0.0
    assert kinds(dead) == [("dead", "tau_2")]
    found = channel_findings(Recording.from_arrays(T, q=motion(), tau=dead))
    assert dead_joints(found) == [1]
    assert kinds(np.column_stack([tau[:, 0], np.round(tau[:, 1])])) == [("stepped", "tau_2")]
    assert kinds(np.column_stack([np.clip(tau[:, 0], -8.0, 8.0), tau[:, 1]])) == [("clipped", "tau_1")]
    slow = signal.sosfiltfilt(signal.butter(6, 5.0, fs=250.0, output="sos"), tau[:, 0])
    assert kinds(np.column_stack([slow, tau[:, 1]])) == [("filtered", "tau_1")]


def test_coarse_encoders_and_irregular_stamps() -> None:
    rng = np.random.default_rng(2)
    tau = torque(rng)
    assert kinds(tau, q=5e-4 * np.round(motion() / 5e-4)) == [("stepped", "q_1"), ("stepped", "q_2")]
    late = np.sort(T + rng.uniform(-1e-3, 1e-3, len(T)))
    assert kinds(tau, t=late) == [("irregular-stamps", "t")]


def test_a_step_is_measured() -> None:
    rng = np.random.default_rng(3)
    assert lattice(0.25 * rng.integers(-20, 20, 1000)) == pytest.approx(0.25)
    assert lattice(rng.normal(size=1000)) == 0.0


def test_numbers_whose_squares_overflow_say_nothing_of_their_filter() -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        assert filtered_above(1e200 * np.sin(T)[:, None], 250.0) == [None]
