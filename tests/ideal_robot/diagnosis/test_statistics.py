"""The statistics: null distributions, folds, held-out gains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.diagnosis.channels.blocks import Blocks, Columns, Design, time_blocks
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.search.forward_selection import likelier
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms
from ideal_robot.diagnosis.statistics.least_squares import LEFT_OUT, Fit, HeldOutTest
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem
from ideal_robot.effects import library
from ideal_robot.effects.registry import find
from ideal_robot.model.model import Model
from tests.ideal_robot.diagnosis.test_diagnose import arm, rippled
from tests.ideal_robot.effects.test_laws import motion


def coloured(rng: np.random.Generator, count: int, memory: float = 0.9) -> np.ndarray:
    e = rng.normal(size=count)
    for k in range(1, count):
        e[k] += memory * e[k - 1]
    return e


def design_of(y: np.ndarray, W: np.ndarray, blocks: Blocks, group: np.ndarray | None = None) -> Design:
    """Of measurements ``(N, n)`` and parameters' columns ``(N, n, m)``, and a group ``c`` of one column ``(N, n)``."""
    design = Design(y, W, np.ones(y.shape, bool), blocks)
    if group is not None:
        design.add("c", Columns(group[:, :, None], tuple(range(y.shape[1]))))
    return design


def test_p_values_of_coloured_noise_are_honest():
    rng = np.random.default_rng(1)
    count, p_values = 1600, []
    for _ in range(120):
        x, extra = coloured(rng, count, 0.98), coloured(rng, count, 0.98)
        W = np.stack([np.ones(count), x], axis=1)[:, None, :]
        design = design_of(coloured(rng, count)[:, None], W, time_blocks(count, 0.01, held_out=False), extra[:, None])
        p_values.append(Fit(design, ["W"], np.ones(1)).held_out_test("c").p_value)
    assert np.mean(np.array(p_values) < 0.05) < 0.12
    assert np.mean(np.array(p_values) < 0.001) < 0.02


def test_the_trial_is_what_refitting_without_each_fold_gives():
    rng = np.random.default_rng(2)
    count = 800
    W, C = rng.normal(size=(count, 2, 3)), rng.normal(size=(count, 2, 1))
    y = rng.normal(size=(count, 2)) + 0.3 * C[:, :, 0] + W[:, :, 0]
    blocks = time_blocks(count, 0.02, held_out=True)
    weights = np.array([1.0, 2.0])
    trial = Fit(design_of(y, W, blocks, C[:, :, 0]), ["W"], weights).held_out_test("c")
    of_sample = blocks.fold[blocks.of_samples()]
    scale = np.sqrt(weights)[None, :, None]
    reduction = 0.0
    for k in range(blocks.folds):
        # A fold that is left out keeps a small weight.
        train, test = of_sample >= 0, of_sample == k
        root = np.sqrt(np.where(test, LEFT_OUT, 1.0))[train, None, None]
        losses = []
        for X in (W, np.concatenate([W, C], axis=2)):
            A = (root * (X * scale)[train]).reshape(-1, X.shape[2])
            b = (root[:, :, 0] * (y * scale[:, :, 0])[train]).ravel()
            beta = np.linalg.lstsq(A, b, rcond=None)[0]
            losses.append(np.sum(((y - X @ beta) * scale[:, :, 0])[test] ** 2))
        reduction += losses[0] - losses[1]
    np.testing.assert_allclose(trial.total, reduction, rtol=2e-3)
    assert np.isnan(trial.reduction[blocks.fold < 0]).all()


@pytest.fixture
def sieve() -> DependenceTest:
    signals = motion()
    blocks = time_blocks(len(signals.t), signals.dt, held_out=False)
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
    blocks = time_blocks(len(signals.t), signals.dt, held_out=False)
    rng = np.random.default_rng(6)
    noise = coloured(rng, len(signals.t))
    term = next(t for t in terms(signals, 0, pairs=False) if t.depends_on == ("q_2",))
    result = sieve.tests(noise, 0, [term])[0]
    signs = rng.choice([-1.0, 1.0], size=(400, blocks.count))[:, blocks.of_samples()]
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


def test_held_out_blocks_take_no_part():
    rng = np.random.default_rng(4)
    count = 600
    W, y = rng.normal(size=(count, 1, 2)), rng.normal(size=(count, 1))
    blocks = time_blocks(count, 0.05, held_out=True)
    spoiled = y.copy()
    spoiled[blocks.fold[blocks.of_samples()] < 0] += 100.0
    betas = [Fit(design_of(values, W, blocks), ["W"], np.ones(1)).beta for values in (y, spoiled)]
    np.testing.assert_allclose(betas[0], betas[1])
    assert isinstance(blocks, Blocks)


def test_a_group_that_the_prior_allows_is_not_significant_and_one_beyond_it_is():
    rng = np.random.default_rng(5)
    count = 800
    x = rng.normal(size=count)
    W = np.stack([np.ones(count), x], axis=1)[:, None, :]
    blocks = time_blocks(count, 0.01, held_out=False)

    def p_value(change: float) -> float:
        design = design_of((change * x + rng.normal(size=count))[:, None], W, blocks, x[:, None])
        # The second parameter is known to 0.1; the group changes the same.
        return Fit(design, ["W"], np.ones(1), np.diag([0.0, 1.0 / 0.1**2])).p_value("c")

    assert p_value(0.05) > 0.05
    assert p_value(1.0) < 1e-6


def test_parameters_that_leave_what_was_known_of_them_leave_squares_as_well():
    rng = np.random.default_rng(5)
    x = rng.normal(size=800)
    blocks = time_blocks(len(x), 0.01, held_out=False)

    def shares(known: float) -> tuple[float, float]:
        design = design_of((x + rng.normal(size=len(x)))[:, None], x[:, None, None], blocks, x[:, None])
        fit = Fit(design, ["W"], np.ones(1), np.array([1.0 / known**2]))
        return fit.share_with_prior("c"), fit.gain("c")[0] / float(fit.squares().sum())

    # Moved by thirty of its deviations: what was known is wrong by as much as the noise that is left.
    in_all, beside = shares(1.0 / 30.0)
    assert in_all > 0.25
    loose, _ = shares(1.0)
    assert loose < 0.01
    assert in_all < beside


def test_what_a_model_class_leaves_averages_out_over_stretches_not_over_samples():
    rng = np.random.default_rng(6)
    count, misses, plain = 1600, [], []
    blocks = time_blocks(count, 0.02, held_out=False).without_folds()
    for _ in range(200):
        # The residual follows the motion in a way that differs from one stretch to the next.
        x, misfit = coloured(rng, count, 0.97), coloured(rng, count, 0.97)
        design = design_of((2.0 * x + misfit)[:, None], x[:, None, None], blocks)
        fit = Fit(design, ["W"], Fit(design, ["W"], np.ones(1)).refitted_weights())
        variance = fit.misfit_variance(np.zeros(1))[0]
        np.testing.assert_allclose(variance, fit.inverse[0, 0] * count / blocks.count)
        assert fit.misfit_variance(1.0 / np.sqrt(fit.weights))[0] < 1e-9 * variance
        misses.append((fit.beta[0] - 2.0) / np.sqrt(variance))
        plain.append((fit.beta[0] - 2.0) / np.sqrt(fit.inverse[0, 0]))
    assert np.mean(np.abs(misses) < 1.96) > 0.9
    assert np.mean(np.abs(plain) < 1.96) < 0.6


def test_what_a_fold_leaves_open_says_nothing_of_candidates():
    # One stretch alone moves a parameter: without it that parameter is open, and what it predicts would be anything.
    rng, count = np.random.default_rng(4), 800
    blocks = time_blocks(count, 0.02, held_out=False)
    alone = (blocks.of_samples() == 3) + 1e-4 * rng.normal(size=count)
    y = (50.0 * alone + rng.normal(size=count))[:, None]
    W = np.stack([alone, np.ones(count)], axis=1)[:, None, :]
    fit = Fit(design_of(y, W, blocks), ["W"], np.ones(1))
    assert fit.held_out_squares.sum() < 2.0 * fit.squares().sum()


# The problem object: a joint fit is least squares of everything, and what is reported comes from all blocks.

@pytest.fixture
def problem(tmp_path: Path) -> Problem:
    robot = arm(tmp_path)
    return Problem.of(torque_regression(rippled(robot, 0.0, 1), robot, Model.nominal(robot)), held_out=True)


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


def test_parameters_of_a_joint_that_slides_are_in_its_units(problem):
    fit = problem.fit([ripple()], uncertainty=True)
    turning, sliding = (fit.fitted(0, [slides]).parameters[0] for slides in (False, True))
    assert (turning.unit, sliding.unit) == ("N m", "N")


def test_held_parameters_leave_their_changes_to_effects(problem):
    free = problem.with_prior(1e2 * np.eye(problem.products.W.m))
    assert np.abs(free.held().fit().change).max() < 0.1 * np.abs(free.fit().change).max()
    assert problem.held() is problem


@pytest.mark.parametrize(("best", "share", "taken"), [
    ("torque_filter", 0.96, True), ("torque_filter", 0.9, False),
    # Two and a half times as much is asked of a delay of one joint.
    ("dead_time", 0.4, True), ("dead_time", 0.37, False)])
def test_a_likelier_cause_is_taken_where_the_other_is_no_clearer_than_is_asked_of_it(best, share, taken):
    other, clearest = (Candidate(find(name, "tau"), joint, (8e-3,), test=HeldOutTest(reduction=np.array([size])))
                       for name, joint, size in (("common_delay", 0, share), (best, 2, 1.0)))
    assert (likelier(clearest, [clearest, other]) is other) is taken


def test_a_pause_leaves_the_filters_as_they_are(tmp_path: Path):
    robot = arm(tmp_path)
    recording = rippled(robot, 0.0, 1)
    t = recording.t + 600.0 * (np.arange(len(recording.t)) >= len(recording.t) // 2)
    apart = replace(recording, columns={**recording.columns, "t": t})
    whole, halves = (torque_regression(some, robot, Model.nominal(robot)).filtered for some in (recording, apart))
    assert (halves.cutoff, halves.factor) == (whole.cutoff, whole.factor)
