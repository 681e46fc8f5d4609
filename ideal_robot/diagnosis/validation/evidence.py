"""What remains in a residual, and what motion would tell two causes apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.statistics.dependence import Dependence, DependenceTest, terms
from ideal_robot.diagnosis.statistics.problem import Candidate, Estimate, Problem
from ideal_robot.diagnosis.validation.result import Structure
from ideal_robot.effects import EffectParameter, FittedEffect, Signals, library
from ideal_robot.effects.base import REACH


def discriminating_motion(name: str, rivals: tuple[str, ...]) -> str:
    """The motion that would tell an effect from its rivals; empty where there are none."""
    said = {frozenset({effect.name, other}): motion for effect in library()
            for other, motion in effect.discriminating_motion}
    found = [said.get(frozenset({name, rival}), f"a motion with other speeds, ranges and loads ({name} or {rival})")
             for rival in rivals]
    return "; ".join(dict.fromkeys(found))


def ranked_structure(problem: Problem, residual: Array, most: int = 3) -> tuple[Structure, ...]:
    """For each channel the strongest dependences of a residual that stand out of their null distribution.

    Args:
        problem: with signals and blocks.
        residual: at its rows ``(N, c)``, in the units of the channels.
        most: dependences of a channel.
    """
    regression, use = problem.regression, problem.products.use
    signals = regression.decimated_signals()
    dependence = DependenceTest(signals, use, problem.blocks)
    result = []
    for j, channel in enumerate(regression.channels):
        if not use[:, j].any():
            continue
        tests = dependence.tests(residual[:, j], j, terms(signals, j, False, regression.domain))
        limit = 0.01 / max(len(tests) * len(regression.channels), 1)
        clear: list[Dependence] = [d for d in tests if d.p_value < limit and d.share - d.expected > 0.01]
        clear.sort(key=lambda d: -(d.share - d.expected))
        result += [Structure(channel, tuple(d.term.signals_of(j + 1)), d.share, d.expected, d.p_value)
                   for d in clear[:most]]
    return tuple(result)


def with_limits(fitted: FittedEffect, candidate: Candidate, signals: Signals) -> FittedEffect:
    """The effect with limits, and no standard deviation, for parameters whose theta stands at its bound.

    Args:
        fitted: the effect with its numbers.
        candidate: whose theta they were found with.
        signals: of the recording.
    """
    effect, theta = candidate.effect, candidate.theta
    parameters = list(fitted.parameters)
    for i, side in enumerate(sides(candidate, signals)):
        if not side:
            continue
        inward = (*theta[:i], theta[i] - 0.01 * side * (abs(theta[i]) or 1.0), *theta[i + 1 :])
        moved = effect.parameters(np.asarray(fitted.coefficients), np.asarray(fitted.std), inward, fitted.theta_std)
        for k, (here, there) in enumerate(zip(fitted.parameters, moved, strict=True)):
            step = there.value - here.value
            if abs(step) > 1e-9 * max(abs(here.value), 1e-300):
                # What lies beyond the bound lies on the other side than what lies within.
                parameters[k] = EffectParameter(here.name, here.value, 0.0, here.unit, "≤" if step > 0.0 else "≥")
    return dataclasses.replace(fitted, parameters=tuple(parameters))


def sides(candidate: Candidate, signals: Signals) -> list[int]:
    """For each theta -1 where it stands at the lower end of what was searched, 1 at the upper, 0 between.

    Args:
        candidate: effect, joint and theta.
        signals: of the recording.
    """
    effect, theta = candidate.effect, candidate.theta
    bounds = effect.bounds(signals, candidate.joint) if effect.theta_is_physical else []
    if len(bounds) != len(theta):
        return [0] * len(theta)
    if len(bounds) == 1 and not effect.scanned:
        starts = [start[0] for start in effect.starts(signals, candidate.joint) if start and start[0] > 0.0]
        if starts and bounds[0][0] >= 0.0:
            (low, high) = bounds[0]
            bounds = [(max(low, min(starts) / REACH), min(high, max(starts) * REACH))]
    return [_side(value, low, high) for value, (low, high) in zip(theta, bounds, strict=True)]


def at_standstill(candidate: Candidate, signals: Signals) -> bool:
    """Whether an effect stands at the end of its search at which it is only how friction goes through standstill.

    A friction law whose bend lies below a hundredth or so of the speeds that were driven says nothing of sliding: it
    follows the contact, the filters and the controller there, which differ from drive to drive.

    Args:
        candidate: effect, joint and theta.
        signals: of the recording.
    """
    return candidate.effect.at_standstill(sides(candidate, signals))


def _side(value: float, low: float, high: float) -> int:
    # Zero below a positive bound is no small value but another form of the effect.
    if value == 0.0 and low > 0.0:
        return 0
    below, above = (0.01 * min(high - low, abs(bound) or high - low) for bound in (low, high))
    return -1 if value <= low + below else 1 if value >= high - above else 0


def with_misfit(problem: Problem, effects: Sequence[Candidate], found: Estimate) -> Estimate:
    """An estimate whose standard deviations hold the misfit, and what the numbers differ by in half of the band.

    Vibrations, filters and the way friction goes through standstill bend numbers in the same way in every block of
    time, so no scatter over blocks shows it; but they fade towards slow motion, and so does what they do to a number.
    A law of speed errs by no more than it errs in the lower half and differs from there: where vibrations are most of
    what is left, that is far less than all that is left could bend it by.

    Args:
        problem: in which the effects were fitted.
        effects: of the fit, in its order.
        found: the fit to all blocks, with uncertainty.
    """
    if not effects:
        return found
    whole = problem.on_all_blocks()
    wide = whole.fit(effects, uncertainty=True, misfit=True)
    slow = whole.slow().fit(effects, uncertainty=True, misfit=True)
    hidden = [candidate.effect.of_slow_motion for candidate in effects]
    own_std, own_theta = ([np.minimum(here, there) if less else here for here, there, less in
                           zip(*stds, hidden, strict=True)]
                          for stds in ((wide.std, slow.std), (wide.theta_std, slow.theta_std)))
    std = [np.hypot(own, there - here) for own, here, there in
           zip(own_std, found.coefficients, slow.coefficients, strict=True)]
    theta_std = [np.where(own > 0.0, np.hypot(own, there - here), own) for own, here, there in
                 zip(own_theta, wide.theta_step, slow.theta_step, strict=True)]
    return replace(found, std=tuple(std), theta_std=tuple(theta_std))
