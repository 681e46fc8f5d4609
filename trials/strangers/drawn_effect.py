"""An effect of the trials with everything drawn but its size, and what several draws share.

Sizes are relative to a drive: ``size = 1`` is a guess that is scaled afterwards until the recording shows the size that
was drawn (see ``visible``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trials.strangers.logger import Logger
from trials.strangers.plant import Plant

Values = dict[tuple[str, int, str], float]


@dataclass(frozen=True)
class Setup:
    """A plant and what records it."""

    plant: Plant
    logger: Logger


@dataclass(frozen=True)
class Drawn:
    """An effect with everything drawn but its size.

    Attributes:
        name: of the effect; for those outside the library a name of its own.
        joint: from 1; 0 for the whole arm.
        apply: the setup with the effect at a size.
        largest: size beyond which it would be another arm.
        values: at a size, the true numbers of the library's parameters by effect, joint, parameter.
    """

    name: str
    joint: int
    apply: Callable[[Setup, float], Setup]
    largest: float = np.inf
    values: Callable[[float], Values] = lambda size: {}


Draw = Callable[[np.random.Generator, Setup, int], Drawn | None]
"""Draws an effect at a joint (from 0); None where that joint or plant cannot have it."""


def rows(setup: Setup, j: int, size: float, scaled: dict[int, float], fixed: dict[int, float]) -> Setup:
    """The setup with other numbers in the drive of one joint.

    Args:
        setup: plant and logger.
        j: joint, from 0.
        size: of the effect; 1 is a guess.
        scaled: what is added to a row of the parameter block at size 1, in the row's unit.
        fixed: what a row is set to whatever the size, in the row's unit.
    """
    block = setup.plant.block.copy()
    for row, value in scaled.items():
        block[row, j] += size * value
    for row, value in fixed.items():
        block[row, j] = value
    return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, block=block))


def in_drive(name: str, j: int, scaled: dict[int, float], fixed: dict[int, float], largest: float = np.inf,
             values: Callable[[float], Values] = lambda size: {}) -> Drawn:
    """An effect in the drive of one joint.

    Args:
        name: of the effect.
        j: joint, from 0.
        scaled: see ``rows``.
        fixed: see ``rows``.
        largest: size beyond which it would be another arm.
        values: at a size, the true numbers of the library's parameters.
    """
    return Drawn(name, j + 1, lambda setup, size: rows(setup, j, size, scaled, fixed), largest, values)


def span(s: Setup, j: int) -> float:
    """Range of a joint, counted from 0 [rad, or m]."""
    return float(s.plant.arm.high[j] - s.plant.arm.low[j])


def in_proportion(name: str, j: int, parameter: str, factor: float) -> Callable[[float], Values]:
    """The true number of one parameter that grows with the size.

    Args:
        name: of the effect.
        j: joint, from 0.
        parameter: its name in the library.
        factor: its value at size 1, in the parameter's unit.
    """
    return lambda size: {(name, j + 1, parameter): factor * size}
