"""Geometry of one joint that another's may reproduce: links between parallel axes are one length."""

from __future__ import annotations

import dataclasses

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.search.choice import Choice
from ideal_robot.diagnosis.statistics.problem import Problem


def with_equivalents(problem: Problem, choices: list[Choice], share: float = 0.95) -> list[Choice]:
    """The choices with what other joints' geometry could do as well: links of parallel axes are one length.

    Args:
        problem: the regression of the TCP.
        choices: what was selected.
        share: of the squares that another joint's columns have to reproduce.
    """
    if not any(choice.candidate.effect.geometric for choice in choices):
        return choices
    made, found = problem.regression, problem.fit([choice.candidate for choice in choices])
    result = []
    for k, choice in enumerate(choices):
        effect, joint, theta = choice.candidate.effect, choice.candidate.joint, choice.candidate.theta
        more: list[tuple[str, int, float]] = []
        if effect.geometric:
            own = made.decimate(effect.columns(made.signals, joint, theta) @ found.coefficients[k]).reshape(-1)
            W = made.W.reshape(len(own), -1)
            alone = float(np.sum(_without(W, own) ** 2))
            for other in effect.joints(made.signals):
                if other != joint and effect.usable(made.signals, other):
                    theirs = made.decimate(effect.columns(made.signals, other, theta)).reshape(len(own), -1)
                    left = float(np.sum(_without(np.column_stack([W, theirs]), own) ** 2))
                    if left < (1.0 - share) * alone:
                        more.append((f"{effect.name} of joint {other}", other, 1.0 - left / alone))
        result.append(dataclasses.replace(choice, rivals=choice.rivals + tuple(more)))
    return result


def _without(columns: Array, values: Array) -> Array:
    """What of values ``(N,)`` the columns ``(N, m)`` cannot make."""
    size = np.linalg.norm(columns, axis=0) + 1e-300
    return np.asarray(values - columns / size @ np.linalg.lstsq(columns / size, values, rcond=1e-9)[0])
