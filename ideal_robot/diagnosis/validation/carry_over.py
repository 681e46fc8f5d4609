"""Which effects carry over to another recording: those that lower its error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from ideal_robot.arrays import Array

T = TypeVar("T")
Error = Callable[[Sequence[T]], Array]
"""Error of each channel of the other recording ``(c,)`` with some of the effects."""


def log_reduction(without: Array, present: Array, channel: int | None) -> float:
    """Logarithm of the error without an effect over that with it.

    Args:
        without: error of each channel ``(c,)``, in their units.
        present: the same with it.
        channel: the effect's own; None takes the mean over all.
    """
    ratio = np.log(without / present)
    return float(np.mean(ratio) if channel is None else ratio[channel])


def eliminated(effects: Sequence[T], error: Error[T],
               channel_of: Callable[[T], int | None]) -> tuple[list[T], list[tuple[T, Array, Array]]]:
    """Drops, one after another, the effect without which the error is lowest, until each lowers it.

    Args:
        effects: all of them.
        error: of the other recording with some of them.
        channel_of: the channel of an effect, None if it has no own.

    Returns:
        Those that stay, in their order, and those that do not, with the errors without and with each.
    """
    kept, dropped = list(effects), []
    while kept:
        present = error(kept)
        absent = [error([other for other in kept if other is not effect]) for effect in kept]
        reductions = [log_reduction(without, present, channel_of(effect))
                      for effect, without in zip(kept, absent, strict=True)]
        worst = int(np.argmin(reductions))
        if reductions[worst] >= 0.0:
            break
        dropped.append((kept.pop(worst), absent[worst], present))
    return kept, dropped


def accepted(effects: Sequence[T], error: Error[T], channel_of: Callable[[T], int | None], least: float) -> list[T]:
    """Takes, one after another, the effects that lower the error beside those already taken.

    Args:
        effects: in the order in which they are tried.
        error: of the other recording with some of them.
        channel_of: the channel of an effect, None if it has no own.
        least: logarithm of the ratio by which an error has to fall.
    """
    kept: list[T] = []
    present = error(kept)
    for effect in effects:
        tried = error([*kept, effect])
        if log_reduction(present, tried, channel_of(effect)) > least:
            kept, present = [*kept, effect], tried
    return kept
