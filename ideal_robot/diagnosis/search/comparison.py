"""Comparing scored candidates: which stand out of chance, and which the data cannot tell apart."""

from __future__ import annotations

import numpy as np

from ideal_robot.diagnosis.search.choice import Scored
from ideal_robot.diagnosis.search.present_model import PresentModel
from ideal_robot.diagnosis.statistics.candidate import Candidate

_NEARLY = 0.9
"""Share of a reduction from which on a cause is a rival, or is taken if it is likelier."""
_NOT_TOLD = 0.8
"""The same where the difference is no more than what scatters from block to block."""
SIMPLER = 0.95
"""Share of a reduction from which on a law with fewer parameters may stand for one with more."""


def discoveries(scored: list[Scored], tests: int, rate: float) -> list[Scored]:
    """Candidates that Benjamini–Hochberg accepts.

    Args:
        scored: candidates with their p-values.
        tests: how many were tested, joints × effects.
        rate: of false discoveries.
    """
    ordered = sorted(scored, key=lambda s: s.p_value)
    last = 0
    for rank, s in enumerate(ordered, start=1):
        if s.p_value <= rate * rank / max(tests, 1):
            last = rank
    return ordered[:last]


def rivals_of(model: PresentModel, best: Scored, others: list[Scored]) -> tuple[tuple[str, int, float], ...]:
    """Candidates with nine tenths of the reduction, or not significantly less: with other data they might be ahead.

    Args:
        model: the present model.
        best: the candidate that was selected.
        others: all that were refined beside it.

    Returns:
        Name, joint, and share of the best one's reduction.
    """
    rivals = []
    for s in others:
        if s is best:
            continue
        ratio = s.test.total / max(best.test.total, 1e-300)
        nearly = ratio > _NEARLY and overlap(model, best.candidate, s.candidate)
        if nearly or indistinguishable(model, best, s, _NOT_TOLD):
            rivals.append((s.candidate.effect.name, s.candidate.joint, ratio))
    return tuple(rivals)


def indistinguishable(model: PresentModel, best: Scored, other: Scored, share: float) -> bool:
    """Whether another candidate reduces the same channel as much, but for what scatters from block to block.

    Args:
        model: the present model.
        best: scored against it.
        other: likewise.
        share: of the best one's reduction that the other has to reach.
    """
    if not overlap(model, best.candidate, other.candidate) or other.test.total < share * best.test.total:
        return False
    difference = best.test.reduction - other.test.reduction
    difference = difference[np.isfinite(difference)]
    error = float(np.std(difference, ddof=1)) * np.sqrt(len(difference))
    return bool(float(difference.sum()) < 2.0 * error)


def adds_little(model: PresentModel, best: Scored, other: Scored, share: float, asked: float) -> bool:
    """Whether of what another candidate leaves the best one takes away less than any effect is asked for.

    Where nearly everything is explained, causes differ by little that hardly scatters: what the model class leaves
    decides then, and a form with more parameters fits more of that.

    Args:
        model: the present model.
        best: scored against it.
        other: likewise.
        share: of the best one's reduction that the other has to reach.
        asked: share of a channel's squares that an effect has to take away.
    """
    if not overlap(model, best.candidate, other.candidate) or other.test.total < share * best.test.total:
        return False
    return best.share - other.share < asked * (1.0 - other.share)


def likelier(model: PresentModel, best: Scored, others: list[Scored]) -> Scored:
    """The best one, or one of the others that is taken sooner and reduces nearly as much.

    Args:
        model: the present model.
        best: scored.
        others: scored against the same model.
    """
    for other in others:
        if best.candidate.effect.name in other.candidate.effect.sooner_than \
                and (other.test.total > _NEARLY * best.test.total
                     or indistinguishable(model, best, other, _NOT_TOLD)):
            return other
    return best


def overlap(model: PresentModel, a: Candidate, b: Candidate) -> bool:
    """Whether two candidates act on a common channel, so that one can stand for the other.

    Args:
        model: the present model.
        a: a candidate.
        b: another one.
    """
    groups = model.design.groups
    ours, theirs = (set(groups[c.key].channels) for c in (a, b) if c.key in groups)
    same = a.joint == b.joint or not a.joint or not b.joint
    return bool(ours & theirs) and (same or min(len(ours), len(theirs)) == 1)
