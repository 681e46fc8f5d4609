"""What transfers to another recording: effects that make its error worse are habits of the recording they came from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import time_blocks
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.search.choice import Choice
from ideal_robot.diagnosis.statistics.least_squares import Fit, weights_of_channels
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.carry_over import eliminated
from ideal_robot.diagnosis.validation.result import NotTransferred


def deciding(validation: Regression) -> np.ndarray:
    """Samples ``(N,)`` of the other recording that decide what transfers: every second block; the others report."""
    dt = float(validation.t[1] - validation.t[0])
    return np.asarray(time_blocks(len(validation.t), dt, held_out=False).of_samples() % 2 == 0)


def held_out(problem: Problem) -> np.ndarray:
    """Samples ``(N,)`` of the recording itself that neither selection nor estimation saw."""
    blocks = problem.blocks
    return np.asarray(~blocks.selecting[blocks.of_samples()])


def transferring(problem: Problem, choices: Sequence[Choice], validation: Regression,
                 samples: np.ndarray) -> tuple[list[Choice], tuple[NotTransferred, ...]]:
    """Drops, one after another, the effect without which samples that took no part are predicted better.

    Each time everything else is fitted anew to the selecting blocks; these samples only compare. Parameters that are
    known before are held: else they would follow whatever change of them was left out.

    Args:
        problem: that was searched.
        choices: what was selected in it.
        validation: the regression of another recording, or that of the problem.
        samples: of ``validation`` that decide ``(N,)``.

    Returns:
        The choices that stay, in their order, and what was dropped with its errors.
    """
    problem = problem.held()
    effects = [choice.candidate for choice in choices]
    design = problem.design(effects)
    weights = weights_of_channels(design, ["W", *[c.key for c in effects]], problem.prior, 1)
    columns = {c.key: validation.decimate(c.effect.columns(validation.signals, c.joint, c.theta)) for c in effects}
    mask = validation.use & samples[:, None]
    p = problem.products.W.m

    def error(kept: Sequence[Choice]) -> Array:
        """RMS of each channel with these effects, on the blocks that decide."""
        keys = [c.candidate.key for c in kept]
        beta = Fit(design, ["W", *keys], weights, problem.prior).beta
        residual, at = validation.y - validation.W @ beta[:p], p
        for key in keys:
            m = design.groups[key].m
            residual = residual - columns[key] @ beta[at : at + m]
            at += m
        return np.asarray(np.sqrt((residual**2 * mask).sum(axis=0) / np.maximum(mask.sum(axis=0), 1)) + 1e-300)

    kept, dropped = eliminated(choices, error, lambda choice: validation.channel_of(choice.candidate.joint))
    return kept, tuple(_not_transferred(validation, *one) for one in dropped)


def _not_transferred(validation: Regression, choice: Choice, without: Array, present: Array) -> NotTransferred:
    joint = choice.candidate.joint
    j = validation.channel_of(joint)
    j = int(np.argmax(present / without)) if j is None else j
    return NotTransferred(choice.candidate.effect.name, joint, validation.channels[j], choice.p_value,
                          float(without[j]), float(present[j]))
