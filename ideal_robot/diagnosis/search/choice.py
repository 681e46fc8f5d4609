"""The selected candidates, and the thresholds between them and others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import Columns
from ideal_robot.diagnosis.statistics.least_squares import Fit, standard_errors, weights_of_channels
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem


@dataclass(frozen=True)
class Options:
    """Thresholds of the search.

    Attributes:
        false_discovery: rate that Benjamini–Hochberg controls over joints × effects of each round.
        smallest: share of a channel's residual squares an effect has to take away on held-out blocks.
        smallest_learned: the same for a learned curve; twice that where the channel has an effect already.
        smallest_torque: rms of what an effect takes away over the torque's standard deviation below which nothing is
            claimed.
        smallest_beside: the same over the rms of the largest other effect at the same joint, at least.
        learned_discovery: p-value of a learned curve; motions repeat themselves, and so does what a model leaves, so
            that blocks of time are fewer than they are counted.
        smallest_own: share of an effect's squares that the other parameters must not be able to cancel.
        unknown_margin: a learned curve replaces the best effect of the library only if it reduces squares by so many
            times as much.
        most: effects at most.
    """

    false_discovery: float = 0.01
    smallest: float = 0.15
    smallest_learned: float = 0.30
    smallest_torque: float = 0.002
    smallest_beside: float = 0.05
    learned_discovery: float = 1e-5
    smallest_own: float = 0.0005
    unknown_margin: float = 1.6
    most: int = 24

    def finer(self) -> Options:
        """A third of the shares that are asked of causes.

        For positions and forces, which no friction hides, and where another recording decides what stays. A curve
        without a cause has to be as large as anywhere: else it would stand in the way of smaller causes.
        """
        return replace(self, smallest=self.smallest / 3.0)


class PresentModel:
    """Selected effects, the weights of the channels that follow from what they leave, and fits with them.

    Args:
        problem: the regression.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.design = problem, problem.design()
        self.choices: list[Candidate] = []
        self._starts: dict[str, list[tuple[float, ...]]] = {}
        self.weights = self._weights()
        self._last: Fit | None = None

    def keys(self, *without: Candidate) -> list[str]:
        """Groups of the fit."""
        return ["W", *[c.key for c in self.choices if not any(c is other for other in without)]]

    def fit(self, *without: Candidate) -> Fit:
        """Fit with the selected effects but some."""
        keys = self.keys(*without)
        if self._last is None or self._last.keys != keys or self._last.weights is not self.weights:
            self._last = Fit(self.design, keys, self.weights, self.problem.prior)
        return self._last

    def fit_beside(self, candidate: Candidate, *without: Candidate) -> Fit:
        """Fit with the selected effects but some and with one more, with the weights of these."""
        self.add_columns(candidate)
        return Fit(self.design, [*self.keys(*without), candidate.key], self.weights, self.problem.prior)

    def residual(self, fit: Fit) -> Array:
        """Residual at all rows ``(N, c)``."""
        return self._left(fit, fit.beta[None])

    def parts(self, fit: Fit) -> Iterator[tuple[Columns, slice]]:
        """The groups of a fit and where their coefficients stand in it."""
        column = 0
        for key in fit.keys:
            group = self.design.groups[key]
            yield group, slice(column, column + group.m)
            column += group.m

    def left_out(self, fit: Fit) -> Array:
        """Residual at all rows ``(N, c)``, each block predicted by the fit without its fold."""
        blocks = self.problem.blocks
        return self._left(fit, fit.betas[1 + blocks.fold[blocks.of_samples()]])

    def _left(self, fit: Fit, betas: Array) -> Array:
        """What of ``y`` the groups of a fit leave with parameters of each row, or of all ``(N or 1, P)``."""
        r = self.problem.products.y.values[:, :, 0].copy()
        for group, place in self.parts(fit):
            r[:, list(group.channels)] -= (group.values @ betas[:, place, None])[:, :, 0]
        return np.asarray(r)

    def add_columns(self, candidate: Candidate) -> None:
        """Makes a candidate's columns part of the design if they are not yet."""
        if candidate.key not in self.design.groups:
            self.design.add(candidate.key, self.problem.columns(candidate))

    def add_starts(self, starts: Sequence[Candidate]) -> str:
        """Makes all starts of a candidate one group of the design, unless it is; the name of the group."""
        key, thetas = f"{starts[0].place}*", [start.theta for start in starts]
        if self._starts.get(key) != thetas:
            self.design.add(key, Columns.side_by_side([self.problem.columns(start) for start in starts]))
            self._starts[key] = thetas
        return key

    def drop(self, choice: Candidate) -> None:
        """Takes a choice out."""
        self.replace([c for c in self.choices if c is not choice])

    def replace(self, choices: list[Candidate]) -> None:
        """Other choices, with the weights that follow from them."""
        self.choices = choices
        for choice in choices:
            self.add_columns(choice)
        self.weights = self._weights()

    def with_prior(self, prior: Array) -> None:
        """Other knowledge of the parameters."""
        self.problem = self.problem.with_prior(prior)
        self.weights = self._weights()

    def worse_than(self, other: PresentModel) -> float:
        """Standard errors by which it leaves more of blocks that had no part in its fit than another about the same."""
        sums = [model.fit().held_out_squares[self.problem.blocks.selecting] @ self.weights for model in (self, other)]
        return standard_errors(sums[0] - sums[1])

    def _weights(self) -> Array:
        return weights_of_channels(self.design, self.keys(), self.problem.prior)


NEARLY = 0.95
"""Share of a reduction from which on a cause is a rival, or is taken if it is likelier or has fewer parameters."""
FINALISTS = 6
"""Candidates of a round that are looked at closely, at most: effects that are refined over theta, or curves."""


def overlap(model: PresentModel, a: Candidate, b: Candidate) -> bool:
    """Whether two candidates act on a common channel, so that one can stand for the other.

    Args:
        model, a, b: the two, and what has their columns.
    """
    groups = model.design.groups
    ours, theirs = (set(groups[c.key].channels) for c in (a, b) if c.key in groups)
    same = a.joint == b.joint or not a.joint or not b.joint
    return bool(ours & theirs) and (same or min(len(ours), len(theirs)) == 1)
