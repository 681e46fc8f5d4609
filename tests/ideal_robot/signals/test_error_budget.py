"""The error budget says how far velocity and acceleration are from the truth."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.signals.error_budget import error_budget
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
from ideal_robot.signals.recording import Recording

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
