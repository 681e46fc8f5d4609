"""What remains in a residual, and what motion would tell two causes apart."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.statistics.dependence import Dependence, DependenceTest, terms
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.result import Structure
from ideal_robot.effects import library


def discriminating_motion(name: str, rivals: tuple[str, ...]) -> str:
    """The motion that would tell an effect from its rivals; empty where there are none."""
    said = {frozenset({effect.name, other}): motion for effect in library()
            for other, motion in effect.discriminating_motion}
    found = [said.get(frozenset({name, rival}), f"a motion with other speeds, ranges and loads ({name} or {rival})")
             for rival in rivals]
    return "; ".join(dict.fromkeys(found))


def ranked_structure(problem: Problem, residual: Array, rng: np.random.Generator,
                     most: int = 3) -> tuple[Structure, ...]:
    """For each channel the strongest dependences of a residual that stand out of their null distribution.

    Args:
        problem: with signals and blocks.
        residual: at its rows ``(N, c)``, in the units of the channels.
        rng: of the null distribution.
        most: dependences of a channel.
    """
    regression, use = problem.regression, problem.products.use
    signals = regression.decimated_signals()
    dependence = DependenceTest(signals, problem.blocks.edges, rng)
    result = []
    for j, channel in enumerate(regression.channels):
        if not use[:, j].any():
            continue
        tests = [dependence.test(residual[:, j], use[:, j], j, term)
                 for term in terms(signals, j, False, regression.domain)]
        limit = 0.01 / max(len(tests) * len(regression.channels), 1)
        clear: list[Dependence] = [d for d in tests if d.p_value < limit and d.share - d.expected > 0.01]
        clear.sort(key=lambda d: -(d.share - d.expected))
        result += [Structure(channel, tuple(d.names), d.share, d.expected, d.p_value) for d in clear[:most]]
    return tuple(result)
