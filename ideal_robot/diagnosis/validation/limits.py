"""Numbers that stand at the end of what was searched: limits, not estimates."""

from __future__ import annotations

import dataclasses

import numpy as np

from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.effects import EffectParameter, FittedEffect, Signals

_NEAR = 0.05
"""A value within this share of itself from a bound stands at it: the search ends a little before."""
_REACH = 3.0
"""By what a single theta is refined about its start, at most (``Effect.bounds_near``)."""


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
            bounds = [(max(low, min(starts) / _REACH), min(high, max(starts) * _REACH))]
    return [_side(value, low, high) for value, (low, high) in zip(theta, bounds, strict=True)]


def at_standstill(candidate: Candidate, signals: Signals) -> bool:
    """Whether an effect stands at the end of its search at which it is only how friction goes through standstill.

    A friction law whose bend lies below a hundredth or so of the speeds that were driven says nothing of sliding: it
    follows the contact, the filters and the controller there, which differ from drive to drive.

    Args:
        candidate: effect, joint and theta.
        signals: of the recording.
    """
    side = candidate.effect.standstill
    return bool(side) and sides(candidate, signals) == [side]


def _side(value: float, low: float, high: float) -> int:
    # Zero below a positive bound is no small value but another form of the effect.
    if value == 0.0 and low > 0.0:
        return 0
    narrow = 0.01 * (high - low)
    if value <= low + min(narrow, _NEAR * abs(low) or narrow):
        return -1
    return 1 if value >= high - min(narrow, _NEAR * abs(high) or narrow) else 0
