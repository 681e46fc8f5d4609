"""Poses between the controller's samples."""

from __future__ import annotations

import numpy as np
import pytest

from planning.path.pose_history import PoseHistory
from planning.planning_error import PlanningError
from tests.planning.cell import T, kr6


def motion(t: float) -> np.ndarray:
    return kr6().home + 0.2 * np.sin(2.0 * t + np.arange(6))


def filled(count: int = 30) -> PoseHistory:
    history = PoseHistory(kr6())
    for k in range(count):
        history.add(k * T, motion(k * T))
    return history


def test_samples_themselves_are_exact() -> None:
    history = filled()
    for k in (0, 3, 15, 29):
        np.testing.assert_allclose(history.q(k * T), motion(k * T), atol=1e-12)


def test_between_samples_the_error_is_that_of_a_cubic() -> None:
    history = filled()
    t = np.linspace(T, 28 * T, 97)
    error = max(np.max(np.abs(history.q(x) - motion(x))) for x in t)
    # |f''''| T⁴ · 3/128, and 1/24 in the last interval.
    assert error < 0.2 * 2.0**4 * T**4 / 24.0


def test_pose_and_velocity_fit_the_motion() -> None:
    history, fk = filled(), kr6().fk()
    t = 0.1234
    np.testing.assert_allclose(history.pose(t).translation, fk(motion(t)).translation, atol=1e-7)
    v, w = history.velocity(t)
    before, after = fk(motion(t - 1e-4)), fk(motion(t + 1e-4))
    np.testing.assert_allclose(v, (after.translation - before.translation) / 2e-4, atol=1e-4)
    S = (after.rotation - before.rotation) / 2e-4 @ fk(motion(t)).rotation.T
    np.testing.assert_allclose(w, [S[2, 1], S[0, 2], S[1, 0]], atol=1e-3)


def test_a_little_ahead_is_extrapolated_and_more_is_refused() -> None:
    history = filled()
    np.testing.assert_allclose(history.q(29.5 * T), motion(29.5 * T), atol=1e-6)
    for t in (-0.01, 29 * T + 0.06):
        with pytest.raises(PlanningError, match="no pose at"):
            history.q(t)
    with pytest.raises(PlanningError, match="nothing"):
        PoseHistory(kr6()).q(0.0)


def test_few_samples_are_enough_to_begin_with() -> None:
    history = filled(2)
    np.testing.assert_allclose(history.q(0.5 * T), 0.5 * (motion(0.0) + motion(T)), atol=1e-12)


def test_old_samples_are_forgotten_and_time_runs_forwards() -> None:
    history = filled(200)
    with pytest.raises(PlanningError, match="no pose at"):
        history.q(0.1)
    with pytest.raises(PlanningError, match="came after"):
        history.add(1.0, motion(1.0))
