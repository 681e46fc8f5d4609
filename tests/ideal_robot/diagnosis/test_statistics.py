"""Dependences against their null distributions, and the joint fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.blocks import time_blocks
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.effects import library
from ideal_robot.model.model import Model
from tests.ideal_robot.diagnosis.test_diagnose import arm, rippled
from tests.ideal_robot.effects.test_laws import motion


def coloured(rng: np.random.Generator, count: int, memory: float = 0.9) -> np.ndarray:
    e = rng.normal(size=count)
    for k in range(1, count):
        e[k] += memory * e[k - 1]
    return e


@pytest.fixture
def sieve() -> DependenceTest:
    signals = motion()
    blocks = time_blocks(len(signals.t), 32, 8)
    return DependenceTest(signals, np.ones((len(signals.t), 1), bool), blocks)


def test_dependence_is_seen_where_it_is_and_not_where_it_is_not(sieve):
    signals = motion()
    noise = np.random.default_rng(3).normal(size=len(signals.t))
    term = next(t for t in terms(signals, 0, pairs=False) if t.depends_on == ("q_2",))
    nothing = sieve.tests(noise, 0, [term])[0]
    something = sieve.tests(noise + 1.5 * np.cos(3.0 * signals.q[:, 1]), 0, [term])[0]
    assert nothing.p_value > 0.01
    assert something.p_value < 1e-3
    assert something.share > 0.3


def test_what_a_curve_explains_by_chance_follows_from_the_blocks(sieve):
    signals = motion()
    blocks = time_blocks(len(signals.t), 32, 8)
    rng = np.random.default_rng(6)
    noise = coloured(rng, len(signals.t))
    term = next(t for t in terms(signals, 0, pairs=False) if t.depends_on == ("q_2",))
    result = sieve.tests(noise, 0, [term])[0]
    signs = rng.choice([-1.0, 1.0], size=(400, blocks.count))[:, blocks.of_samples]
    shares = np.array([sieve.tests(sign * noise, 0, [term])[0].share for sign in signs])
    assert result.expected == pytest.approx(shares.mean(), rel=0.1)
    assert result.p_value == pytest.approx(np.mean(shares >= result.share), abs=0.1)


def test_a_slow_disturbance_is_seen_over_time(sieve):
    # A curve over time is nearly constant in a block; without centring its chance share was a thousandfold.
    signals, rng = motion(), np.random.default_rng(5)
    of_time = [t for t in terms(signals, 0, pairs=False) if t.depends_on == ("t",) and not t.directed]
    slow = np.sin(2.0 * np.pi * 1.7 * signals.t / signals.t[-1])
    for term in of_time:
        nothing = sieve.tests(rng.normal(size=len(slow)), 0, [term])[0]
        something = sieve.tests(slow + 0.5 * rng.normal(size=len(slow)), 0, [term])[0]
        assert nothing.expected < 0.2
        assert nothing.p_value > 0.01
        assert something.expected < 0.5
        assert something.share > 0.5
        assert something.p_value < 0.02


# The problem object: a joint fit is one of everything.

@pytest.fixture
def problem(tmp_path: Path) -> Problem:
    robot = arm(tmp_path)
    return Problem(torque_regression(rippled(robot, 0.0, 1), robot, Model.nominal(robot)))


def ripple() -> Candidate:
    return Candidate(next(e for e in library() if e.key == "torque_ripple/tau"), 1, (40.0,))


def test_effects_and_parameters_are_fitted_together(problem):
    # The recording holds a ripple of 0.4 N m, 40 periods per turn of the joint divided by 2 pi.
    fit = problem.fit([ripple()], uncertainty=True)
    size, theta_std = fit.coefficients[0], fit.theta_std[0]
    assert size == pytest.approx([0.4, 0.0], abs=0.02)
    assert np.all(np.abs(size - [0.4, 0.0]) < 4.0 * fit.std[0] + 1e-3)
    assert 0.0 < theta_std[0] < 0.1
    torques = problem.regression
    before, after = (float(np.std(r[torques.use])) for r in (problem.fit().residual(torques), fit.residual(torques)))
    assert after < 0.3 * before


def test_a_prior_holds_the_parameters(problem):
    count = problem.regression.W.shape[2]
    held = problem.with_root(1e-7 * np.eye(count)).fit()
    assert np.all(np.abs(held.change) < 1e-3 * np.abs(problem.fit().change).max())
    assert held.change.shape == (count,)


def test_parameters_of_a_joint_that_slides_are_in_its_units(problem):
    fit = problem.fit([ripple()], uncertainty=True)
    turning, sliding = (fit.fitted(0, [slides]).parameters[0] for slides in (False, True))
    assert (turning.unit, sliding.unit) == ("N m", "N")


def test_a_pause_leaves_the_filters_as_they_are(tmp_path: Path):
    robot = arm(tmp_path)
    recording = rippled(robot, 0.0, 1)
    t = recording.t + 600.0 * (np.arange(len(recording.t)) >= len(recording.t) // 2)
    apart = replace(recording, columns={**recording.columns, "t": t})
    whole, halves = (torque_regression(some, robot, Model.nominal(robot)).filtered for some in (recording, apart))
    assert (halves.cutoff, halves.factor) == (whole.cutoff, whole.factor)
