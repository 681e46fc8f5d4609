"""How large a cause is beforehand, and what a model class may err by in its direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.diagnosis.best_set import BestSet, Weighed, _error_of
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.report import _not_told_from_nothing
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.effects import MOTOR_TORQUE, library
from ideal_robot.effects.registry import find
from ideal_robot.estimate.gaussian import Joined
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.test_known_model import harmonics

EFFECTS = [effect for effect in library() if effect.domain == MOTOR_TORQUE]


@pytest.mark.parametrize("seed", range(4))
def test_rows_that_are_off_alike_in_all_directions_move_coefficients_by_the_estimators_gain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    N, p, m = 60, 7, 2
    X, C = rng.normal(size=(N, p)), rng.normal(size=(N, m)) + rng.normal(size=(N, 1))
    covariance = np.eye(N) + X @ X.T
    gain = np.linalg.solve(C.T @ np.linalg.solve(covariance, C), np.linalg.solve(covariance, C).T)
    across = C.T @ X
    taken = np.linalg.solve(X.T @ X + np.eye(p), across.T)
    root = _error_of(C.T @ C - across @ taken, taken.T @ taken, 3.0 * m)
    np.testing.assert_allclose(root @ root.T, 3.0 * gain @ gain.T, rtol=1e-8)


def moved(seconds: float = 24.0) -> tuple[Robot, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    robot, t = Robot.load("kr6"), np.arange(0.0, seconds, 0.004)
    return robot, t, *harmonics(np.random.default_rng(2), t, robot.home, 0.25, (0.8, 5.0), 4)


@pytest.fixture(scope="module")
def problem() -> Problem:
    robot, t, q, qd, qdd = moved()
    rng, model = np.random.default_rng(3), Model.nominal(robot)
    tau = model.inverse_dynamics(q, qd, qdd)
    tau += 0.002 * np.std(tau, axis=0) * rng.normal(size=q.shape)
    return Problem(torque_regression(Recording.from_arrays(t, q=q, tau=tau), robot, model, payload=True))


def test_a_cause_is_as_large_beforehand_whatever_else_a_model_may_explain_of_it(problem: Problem) -> None:
    regression = problem.regression
    spring = Candidate(find("gravity_spring", "tau"), 2, (0.4, 0.5))
    columns = regression.filtered.decimate(spring.effect.columns(regression.signals, 2, spring.theta))
    like_it = replace(regression, W=np.concatenate([regression.W, columns + 1e-3], axis=2))
    either = [BestSet(Problem(own), EFFECTS, absorbed=False) for own in (regression, like_it)]
    for best in either:
        best.add(spring)
    sizes = [float(np.sqrt(np.mean((columns[:, 1] @ best.wide(spring)) ** 2))) for best in either]
    # The noise of the two differs a little, and by it what a row weighs.
    assert sizes[1] == pytest.approx(sizes[0], rel=0.1)


def test_what_is_wrong_with_the_form_of_a_cause_of_the_whole_arm_may_show_in_each_joint(problem: Problem) -> None:
    best = BestSet(problem, EFFECTS, absorbed=False)
    late, all_late = (Candidate(find(name, "tau"), joint, (0.004,))
                      for name, joint in (("dead_time", 3), ("common_delay", 0)))
    torque = problem.regression.filtered.decimate(problem.regression.signals.torque)
    best.system.y[:] += 0.1 * (np.roll(torque, 1, axis=0) - torque) * problem.regression.use
    best.add(all_late)
    best.take([all_late])
    alone, beside = (float(np.linalg.norm(best.narrow(late, others))) for others in ([], [all_late]))
    assert beside > alone


def test_an_error_of_form_is_in_what_parameters_with_a_prior_are_estimated_from_too(problem: Problem) -> None:
    """Beside a large cause, friction known to 3 % was weighed as if the rows were right to their noise."""
    r = problem.regression
    s, way = r.signals, r.signals.sliding_direction(3)
    # Nearly what dry friction makes, so that an estimate beside it is by what little is of its own.
    rubs = r.filtered.decimate(s.on_joint(3, way * (1.0 + 0.02 * np.sin(7.0 * s.q[:, 2]))))
    pulls = 300.0 * r.filtered.decimate(s.on_joint(3, s.q[:, 2]))[:, :, 0]
    known = Problem(replace(r, W=np.concatenate([r.W, rubs], axis=2), y=r.y + pulls),
                    np.diag([*np.full(r.W.shape[2], 1e-6), 1.0]))
    best = BestSet(known, EFFECTS, absorbed=True)
    spring, dry = Candidate(find("cable_spring", "tau"), 3), Candidate(find("coulomb", "tau"), 3)
    best.take([spring])
    best.add(dry)
    makes = best.narrow(dry, [spring])[0, 0] * best.system.groups[dry.key].values
    # Five per cent of what the spring makes, and what the class errs by; with rows taken for right, 8.5 times it.
    share = float(np.std(makes) / np.std(pulls))
    assert 0.02 < share < 0.2


def test_what_the_class_may_err_by_bars_no_cause_that_stands_above_it(problem: Problem, monkeypatch) -> None:
    best = BestSet(problem, EFFECTS, absorbed=False)
    below, above, further = (Weighed(Candidate(find(name, "tau"), 2), Joined(*np.zeros((2, 1)), 0.0), nats)
                             for name, nats in (("presliding_hysteresis", -9.0), ("viscous", 7.0), ("coulomb", 8.0)))
    monkeypatch.setattr(best, "ranked", lambda: [below, above, further])
    assert best._best() is above
    monkeypatch.setattr(best, "ranked", lambda: [below])
    assert best._best() is None


@pytest.mark.parametrize("there", [False, True])
def test_what_is_not_told_from_nothing_leaves_the_set(problem: Problem, there: bool) -> None:
    spring = Candidate(find("cable_spring", "tau"), 3)
    columns = problem.regression.filtered.decimate(spring.effect.columns(problem.regression.signals, 3, ()))[:, :, 0]
    pulled = replace(problem.regression, y=problem.regression.y + 20.0 * there * columns)
    best = BestSet(Problem(pulled), EFFECTS, absorbed=False)
    best.take([spring])
    assert _not_told_from_nothing(best) == (() if there else (spring,))
    assert best.choices == ([spring] if there else [])
