"""Selection against a model known before: its parameters hold unless the data say that they have changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.search.choice import Choice, Options
from ideal_robot.diagnosis.search.forward_selection import Only, Progress, Search
from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.effects import Effect

_AS_GOOD = 1.05
_NEARLY_AS_GOOD = 1.1
"""Ratio of the mean squares with held parameters to those with free ones up to which the model holds: for the same
effects, and after a search of its own. Where it takes learned curves to hold it has to be better by as much."""


@dataclass(frozen=True)
class Selection:
    """What was selected.

    Attributes:
        choices: the effects.
        holds: whether the model's parameters hold.
        beside_known: where they do not, what a search with held parameters selected all the same: all of it, and what
            of it the parameters, as uncertain as they are, do not take over.
    """

    choices: tuple[Choice, ...]
    holds: bool
    beside_known: tuple[tuple[Candidate, ...], ...] = ()


def selected_against(problem: Problem, prior: Array, effects: Sequence[Effect], options: Options,
                     rng: np.random.Generator, *, only: Only | None, progress: Progress,
                     start: Sequence[Choice] = (), refuted: Only = ()) -> Selection:
    """Selects effects with the model's parameters held, or with free ones where the model does not hold.

    Args:
        problem: about the known model, without a prior.
        prior: precision of its parameters ``(P, P)``, in the units of the weighted squares.
        effects: to choose from.
        options: thresholds.
        rng: for null distributions.
        only: names and joints of the effects that may be looked for.
        progress: called with the share done and a word.
        start: choices of an earlier search to begin with.
        refuted: forms (``Effect.key``) and joints of effects that are not tried.
    """
    held = Search(problem.with_prior(prior).held(), effects, options, rng, absorbed=True, only=only,
                  refuted=refuted, progress=progress)
    every = tuple(choice.candidate for choice in held.run(start))
    held.settle(prior)
    settled = tuple(choice.candidate for choice in held.model.choices)
    free = Search(problem, effects, options, rng, absorbed=False, only=only, refuted=refuted,
                  progress=progress)
    # A curve without a cause is no reason to hold what other parameters explain as well.
    free.model.replace([c for c in held.model.choices
                        if not (c.candidate.effect.absorbed_by_base or c.candidate.effect.learned)])
    error = held.model.mean_squares()
    curved = any(c.candidate.effect.learned for c in held.model.choices)
    as_good, nearly = (1.0 / _AS_GOOD, 1.0 / _AS_GOOD) if curved else (_AS_GOOD, _NEARLY_AS_GOOD)
    if error < as_good * free.model.mean_squares():
        return Selection(tuple(held.model.choices), True)
    # The search begins without effects, but with the weights that they leave.
    free.model.choices = []
    free.run()
    if error < nearly * free.model.mean_squares():
        return Selection(tuple(held.model.choices), True)
    return Selection(tuple(free.model.choices), False, tuple(dict.fromkeys(own for own in (every, settled) if own)))
