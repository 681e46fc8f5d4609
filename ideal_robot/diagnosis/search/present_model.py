"""The present model of a search: the parameters and the effects that were selected so far."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.search.choice import Choice
from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.least_squares import Fit, weights_of_channels
from ideal_robot.diagnosis.statistics.problem import Problem

_ROUNDS = 2
"""Refits after which the channels' weights have settled."""


class PresentModel:
    """Selected effects, the weights of the channels that follow from what they leave, and fits with them.

    Args:
        problem: the regression.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.design = problem.design()
        self.choices: list[Choice] = []
        self.weights = self._weights()

    def keys(self, *without: Choice) -> list[str]:
        """Groups of the fit."""
        return ["W", *[c.candidate.key for c in self.choices if not any(c is other for other in without)]]

    def fit(self, *without: Choice) -> Fit:
        """Fit with the selected effects but some."""
        return Fit(self.design, self.keys(*without), self.weights, self.problem.prior)

    def fit_beside(self, candidate: Candidate, *without: Choice) -> Fit:
        """Fit with the selected effects but some and with one more, with the weights of these."""
        self.add_columns(candidate)
        return Fit(self.design, [*self.keys(*without), candidate.key], self.weights, self.problem.prior)

    def fit_of_rivals(self, choice: Choice) -> Fit:
        """The fit against which a choice has to hold its place: without it, and without curves where it is physical.

        Curves of other joints stay: what they take away would else be looked for in the parameters.
        """
        if choice.candidate.effect.learned:
            return self.fit(choice)
        curves = [c for c in self.choices if c.candidate.effect.learned
                  and (c.candidate.joint == choice.candidate.joint or not choice.candidate.joint)]
        return self.fit(choice, *curves)

    def residual(self, fit: Fit) -> Array:
        """Residual at all rows ``(N, c)``."""
        r = self.problem.products.y.values[:, :, 0].copy()
        at = 0
        for key in fit.keys:
            group = self.design.groups[key]
            r[:, list(group.channels)] -= group.values @ fit.beta[at : at + group.m]
            at += group.m
        return np.asarray(r)

    def add_columns(self, candidate: Candidate) -> None:
        """Makes a candidate's columns part of the design if they are not yet."""
        if candidate.key not in self.design.groups:
            self.design.add(candidate.key, self.problem.columns(candidate))

    def take(self, choice: Choice) -> None:
        """Adds a choice."""
        self.replace([*self.choices, choice])

    def drop(self, choice: Choice) -> None:
        """Takes a choice out."""
        self.replace([c for c in self.choices if c is not choice])

    def replace(self, choices: list[Choice]) -> None:
        """Other choices, with the weights that follow from them."""
        self.choices = choices
        for choice in choices:
            self.add_columns(choice.candidate)
        self.weights = self._weights()

    def with_prior(self, prior: Array) -> None:
        """Other knowledge of the parameters."""
        self.problem = self.problem.with_prior(prior)
        self.weights = self._weights()

    def mean_squares(self) -> float:
        """Geometric mean over channels of the mean squares on blocks left out."""
        selecting, count = self.problem.blocks.selecting, self.problem.products.count
        squares = self.fit().held_out_squares[selecting].sum(axis=0)
        samples = count[selecting].sum(axis=0)
        kept = samples > 0
        return float(np.exp(np.mean(np.log(np.maximum(squares[kept], 1e-300) / samples[kept]))))

    def _weights(self) -> Array:
        return weights_of_channels(self.design, self.keys(), self.problem.prior, _ROUNDS)
