"""What transfers to another recording: effects that make its error worse are habits of the recording they came from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import Experiment
from ideal_robot.diagnosis.search.choice import Choice
from ideal_robot.diagnosis.statistics.block_regression import Design, Fit, channel_weights
from ideal_robot.diagnosis.statistics.cross_products import Data, time_blocks
from ideal_robot.diagnosis.validation.result import NotTransferred


def deciding(seen: Experiment) -> np.ndarray:
    """Samples ``(N,)`` of the other recording that decide what transfers: every second block; the others report."""
    blocks = time_blocks(len(seen.t), float(seen.t[1] - seen.t[0]), held_out=False)
    return np.asarray(blocks.of_samples() % 2 == 0)


def transferring(raw: Experiment, data: Data, choices: Sequence[Choice], prior: Array | None,
                 seen: Experiment) -> tuple[list[Choice], tuple[NotTransferred, ...]]:
    """Drops, one after another, the effect without which the other recording is predicted better.

    Each time everything else is fitted anew to the recording itself; the other one only compares.

    Args:
        raw, data, prior: the regression that was searched.
        choices: what was selected in it.
        seen: the regression of the other recording.

    Returns:
        The choices that stay, in their order, and what was dropped with its errors.
    """
    design = Design(data)
    there = {}
    for choice in choices:
        c = choice.candidate
        design.add(c.key, c.columns(raw, data))
        there[c.key] = seen.decimate(c.effect.columns(seen.signals, c.joint, c.theta))
    keys = ["W", *there]
    weights = channel_weights(Fit(design, ["W"], np.ones(data.c), prior).squares(), data.count)
    weights = channel_weights(Fit(design, keys, weights, prior).squares(), data.count)
    mask = seen.use & deciding(seen)[:, None]

    def error(kept: Sequence[Choice]) -> Array:
        """RMS of each channel with these effects, on the blocks that decide."""
        fit = Fit(design, ["W", *[c.candidate.key for c in kept]], weights, prior)
        residual, at = seen.y - seen.W @ fit.beta[: data.W.m], data.W.m
        for c in kept:
            m = design.groups[c.candidate.key].m
            residual = residual - there[c.candidate.key] @ fit.beta[at : at + m]
            at += m
        return np.asarray(np.sqrt((residual**2 * mask).sum(axis=0) / np.maximum(mask.sum(axis=0), 1)) + 1e-300)

    kept, dropped = list(choices), []
    while kept:
        present = error(kept)
        absent = [error([other for other in kept if other is not c]) for c in kept]
        worth = [_worth(seen, c, present, without) for c, without in zip(kept, absent, strict=True)]
        worst = int(np.argmin(worth))
        if worth[worst] >= 0.0:
            break
        gone = kept.pop(worst)
        joint = gone.candidate.joint
        j = seen.channel_of(joint)
        j = int(np.argmax(present / absent[worst])) if j is None else j
        dropped.append(NotTransferred(gone.candidate.effect.name, joint, seen.channels[j], gone.p_value,
                                      float(absent[worst][j]), float(present[j])))
    return kept, tuple(dropped)


def _worth(seen: Experiment, choice: Choice, present: Array, without: Array) -> float:
    """Logarithm of the error without an effect over that with it, in its own channel or over all of them."""
    ratio = np.log(without / present)
    j = seen.channel_of(choice.candidate.joint)
    return float(np.mean(ratio) if j is None else ratio[j])
