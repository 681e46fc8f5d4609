"""Stamps are corrected where the positions say that they are late, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.signals.stamps import regular_stamps

STEP = 0.004


def path(t: np.ndarray) -> np.ndarray:
    return np.column_stack([np.sin(2.0 * t), np.cos(3.1 * t)])


def test_late_stamps_are_put_back() -> None:
    rng = np.random.default_rng(1)
    true = np.arange(0.0, 20.0, STEP)
    true = true[rng.random(len(true)) > 0.01]
    stamped = np.sort(true + rng.normal(scale=4e-4, size=len(true)))
    found, jitter = regular_stamps(stamped, path(true))
    assert jitter == pytest.approx(4e-4, rel=0.1)
    assert np.std(found - true) < 0.25 * np.std(stamped - true)


def test_right_stamps_of_irregular_samples_stay() -> None:
    rng = np.random.default_rng(2)
    true = np.sort(np.arange(0.0, 20.0, STEP) + rng.normal(scale=4e-4, size=5000))
    found, jitter = regular_stamps(true, path(true))
    assert jitter == 0.0
    np.testing.assert_array_equal(found, true)
