"""The problem object: a joint fit is least squares of everything, and what is reported comes from all blocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ideal_robot.diagnosis.channels.blocks import time_blocks
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.effects import library
from ideal_robot.model.model import Model
from tests.ideal_robot.diagnosis.test_diagnose import arm, rippled


@pytest.fixture
def problem(tmp_path: Path) -> Problem:
    one = arm(tmp_path)
    made = torque_regression(rippled(one, 0.0, 1), one, Model.nominal(one))
    return Problem(made, time_blocks(len(made.t), float(made.t[1] - made.t[0]), held_out=True))


def ripple() -> Candidate:
    return Candidate(next(e for e in library() if e.key == "torque_ripple/tau"), 1, (40.0,))


def test_effects_and_parameters_are_fitted_together(problem):
    # The recording holds a ripple of 0.4 N m, 40 periods per turn of the joint divided by 2 pi.
    found = problem.fit([ripple()], uncertainty=True)
    size, theta_std = found.coefficients[0], found.theta_std[0]
    assert size == pytest.approx([0.4, 0.0], abs=0.02)
    assert np.all(np.abs(size - [0.4, 0.0]) < 4.0 * found.std[0] + 1e-3)
    assert 0.0 < theta_std[0] < 0.1
    made = problem.regression
    before, after = (float(np.std(r[made.use])) for r in (problem.fit().residual(made, []),
                                                          found.residual(made, [ripple()])))
    assert after < 0.3 * before


def test_held_out_blocks_estimate_only_where_all_are_asked_for(problem):
    assert not problem.blocks.selecting.all()
    every = problem.on_all_blocks()
    assert every.blocks.selecting.all()
    ours, theirs = problem.fit([ripple()]), every.fit([ripple()])
    assert not np.array_equal(ours.coefficients[0], theirs.coefficients[0])


def test_a_prior_holds_the_parameters(problem):
    count = problem.regression.W.shape[2]
    held = problem.with_prior(1e15 * np.eye(count)).fit()
    assert np.all(np.abs(held.change) < 1e-3 * np.abs(problem.fit().change).max())
    assert held.change.shape == (count,)


def test_the_lower_half_of_the_band_gives_the_same_numbers_where_nothing_else_is_there(problem):
    slow = problem.slow()
    assert np.std(slow.products.y.values) < np.std(problem.products.y.values)
    size = slow.fit([ripple()]).coefficients[0]
    assert size == pytest.approx([0.4, 0.0], abs=0.05)


def test_held_parameters_leave_their_changes_to_effects(problem):
    free = problem.with_prior(1e2 * np.eye(problem.products.W.m))
    assert np.abs(free.held().fit().change).max() < 0.1 * np.abs(free.fit().change).max()
    assert problem.held() is problem
