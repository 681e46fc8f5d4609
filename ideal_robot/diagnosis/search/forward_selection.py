"""The search: forward selection of effects, with pruning.

They are added one by one, each fitted together with all parameters, compared with its rivals on blocks of time that had
no part in the fit, and taken out again when later ones make it superfluous.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.search.choice import (
    FINALISTS,
    NEARLY,
    Options,
    PresentModel,
    discoveries,
    indistinguishable,
    likelier,
    overlap,
    rivals_of,
)
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms, time_period
from ideal_robot.diagnosis.statistics.least_squares import Fit
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem
from ideal_robot.effects import TCP_POSITION, Effect, Signals
from ideal_robot.effects.loads import AngleLaw
from ideal_robot.progress import Progress, silent


class LearnedCurves:
    """Looks for curves in what the present model leaves.

    Args:
        scoring: of the present model.
    """

    def __init__(self, scoring: Scoring) -> None:
        self.scoring, self.model, self.options = scoring, scoring.model, scoring.options
        problem = self.model.problem
        self.use = problem.products.use & problem.blocks.selecting_samples[:, None]
        self.dependence = DependenceTest(scoring.at_rows, self.use, problem.blocks)

    def best(self, fit: Fit, best: Candidate | None) -> Candidate | None:
        """A learned curve, if it reduces the residual clearly more than the best effect of the library.

        Args:
            fit: of the present model.
            best: the best effect of this round, or None.
        """
        least = 0.0 if best is None else self.options.unknown_margin * best.test.total
        problem = self.model.problem
        residual = self.model.residual(fit)
        scored: list[Candidate] = []
        for j in range(problem.products.c):
            if j + 1 in problem.regression.undecided and problem.regression.domain != TCP_POSITION:
                continue
            scored += self._of_channel(fit, residual, j, best is None, least)
        taken = {c.key for c in self.model.choices}
        scored = [s for s in scored if s.p_value < self.options.learned_discovery and s.test.total > least
                  and s.key not in taken and self.scoring.is_large(s)]
        found = max(scored, key=lambda s: s.test.total, default=None)
        return None if found is None else replace(found, asked=self.scoring.smallest_share(found))

    def in_channel(self, fit: Fit, channel: int) -> Candidate | None:
        """The curve that takes most away in one channel, from 0, whether it is large or not.

        Args:
            fit: without it.
            channel: from 0.
        """
        scored = self._of_channel(fit, self.model.residual(fit), channel, False, 0.0)
        return max(scored, key=lambda s: s.test.total, default=None)

    def over_angle(self, fit: Fit, joint: int) -> list[Candidate]:
        """The curve over a joint's own angle, tested; none where the joint hardly moves.

        Args:
            fit: of the present model.
            joint: from 1.
        """
        curves = [Candidate(term, joint) for term in terms(self.scoring.at_rows, joint - 1, False)
                  if term.depends_on == (f"q_{joint}",) and not term.directed]
        for curve in curves:
            self.model.add_columns(curve)
        return [self.scoring.tested(fit, curve) for curve in curves]

    def _of_channel(self, fit: Fit, residual: np.ndarray, j: int, pairs: bool, least: float) -> list[Candidate]:
        """Curves of channel ``j`` tested on blocks left out; ``least`` is what they have to take away."""
        regression = self.model.problem.regression
        use = self.use[:, j]
        squares = float(np.sum(residual[use, j] ** 2) * self.model.weights[j])
        at_rows = self.scoring.at_rows
        period = time_period(residual[:, j], use, at_rows.t, regression.domain)
        curves = [*terms(at_rows, j, pairs, regression.domain), *([] if period is None else [period])]
        # By the share explained of what would not be by chance: many curves follow a residual that is in few places.
        tests = sorted(self.dependence.tests(residual[:, j], j, curves),
                       key=lambda d: (d.expected - d.share) / max(1.0 - d.expected, 1e-12))
        # Only a first choice: what is promising is tested on blocks left out, corrected for all curves looked at.
        promising = [d for d in tests if d.p_value < 0.05 and 3.0 * d.share * squares > least]
        scored = []
        for d in promising[:FINALISTS]:
            candidate = Candidate(d.term, j + 1, (), len(tests) * self.model.problem.products.c)
            self.model.add_columns(candidate)
            scored.append(self.scoring.tested(fit, candidate))
            # A curve has many columns, and every round has other curves.
            self.model.design.forget_products(candidate.key)
        return scored


def candidates(effects: Sequence[Effect], signals: Signals, undecided: dict[int, str],
               absorbed: bool) -> Iterator[list[Candidate]]:
    """For every effect and joint the list of its starts, joints that move too little left out.

    Args:
        effects: to try.
        signals: of the recording.
        undecided: joints that cannot be decided.
        absorbed: whether effects may be tried that the model's own parameters can take over.
    """
    for effect in effects:
        if effect.absorbed_by_base and not absorbed:
            continue
        for joint in effect.joints(signals):
            if joint in undecided or not effect.usable(signals, joint):
                continue
            if effect.scanned:
                yield [Candidate(effect, joint)]
                continue
            starts = effect.starts(signals, joint)
            yield [Candidate(effect, joint, theta, len(starts)) for theta in starts]


Only = tuple[tuple[str, int], ...]
"""Names and joints of the effects that may be looked for."""


class Search:
    """Forward selection with backward pruning.

    Args:
        problem: the regression.
        effects: to choose from.
        options: thresholds.
        absorbed: whether effects are tried that the model's own parameters could take over.
        only: names and joints of the effects that may be looked for; then nothing is learned either.
        progress: called with the share done and a word.
    """

    def __init__(self, problem: Problem, effects: Sequence[Effect], options: Options, *,
                 absorbed: bool, only: Only | None = None, progress: Progress = silent) -> None:
        self.options, self.progress = options, progress
        self.model = PresentModel(problem)
        self.scoring = Scoring(self.model, options)
        self.curves = LearnedCurves(self.scoring)
        self.learns = only is None
        regression = problem.regression
        pool = [starts for starts in candidates(effects, regression.signals, regression.undecided, absorbed)
                if only is None or (starts[0].effect.name, starts[0].joint) in only]
        # Joint by joint, as several effects need how torques change with its motion, which is large to keep.
        self.pool = sorted(pool, key=lambda starts: starts[0].joint)

    def run(self, start: Sequence[Candidate] = ()) -> list[Candidate]:
        """Selects; returns the choices in the order they were taken.

        Args:
            start: choices of an earlier search to begin with, as far as they still hold their places.
        """
        self.model.replace(list(start))
        for one in sorted(start, key=lambda c: c.share):
            self._drop_if_small(one)
        self._with_needed_form()
        for round_ in range(self.options.most):
            # How many rounds there will be is not known: each takes a share of what is left.
            self.progress(round_ / (round_ + 4.0), f"round {round_ + 1}")
            fit = self.model.fit()
            best = self._best(fit, self.scoring.scored(fit, self.pool))
            choice = (self.curves.best(fit, best) if self.learns else None) or best
            if choice is None:
                if not self._with_needed_form():
                    break
                continue
            self.model.replace([*self.model.choices, choice])
            if not choice.effect.learned:
                self._prune()
            self._retune(choice)
            if isinstance(choice.effect, AngleLaw):
                self._with_needed_form()
        return self.model.choices

    def settle(self, prior: Array) -> None:
        """Takes a looser prior ``(P, P)`` and drops effects that the model's own parameters can now take over.

        Changes of parameters stay where they stand out of what was known of the parameters; so do other effects in
        whose place parameters would have to leave that as far as measurements were left.
        """
        self.model.with_prior(prior)
        for choice in sorted(self.model.choices, key=lambda c: c.share):
            if choice.effect.absorbed_by_base:
                if self.model.fit(choice).p_value(choice.key) > self.options.false_discovery:
                    self.model.drop(choice)
                continue
            if self.model.fit(choice).share_with_prior(choice.key) < self.scoring.smallest_share(choice, choice):
                self._drop_if_small(choice)

    def _best(self, fit: Fit, scored: list[Candidate]) -> Candidate | None:
        """The best candidate of this round: significant among all, large enough, best after refinement."""
        scored = [self._sharpened(fit, s) for s in scored]
        passed = [s for s in discoveries(scored, len(self.pool), self.options.false_discovery)
                  if self.scoring.is_large(s)]
        if not passed:
            return None
        passed.sort(key=lambda s: -s.test.total)
        refined: list[Candidate] = []
        for s in passed:
            if len(refined) == FINALISTS or (refined and s.test.total < 0.4 * refined[0].test.total):
                break
            better = self.scoring.refined(fit, s)
            if self.scoring.holds(fit, better):
                refined.append(better)
        if not refined:
            return None
        refined.sort(key=lambda s: -s.test.total)
        best = refined[0]
        # Of those that the data cannot tell apart, the one with fewest parameters.
        for other in refined[1:]:
            if other.parameter_count < best.parameter_count \
                    and indistinguishable(self.model, refined[0], other):
                best = other
        best = likelier(best, refined)
        return dataclasses.replace(best, rivals=rivals_of(self.model, best, refined),
                                   asked=self.scoring.share_asked(best))

    def _sharpened(self, fit: Fit, s: Candidate) -> Candidate:
        """A candidate that is large enough, but whose start lies too far off its theta to pay the price of all starts.

        What happens a few times in a recording, as the crossing of a gap, a coarse theta hits in some blocks only. Its
        p-value stays multiplied by the number of starts.
        """
        alone = s.p_value / max(s.tries, 1)
        if s.p_value <= self.options.false_discovery / max(len(self.pool), 1) or alone > self.options.false_discovery \
                or not self.scoring.is_large(s):
            return s
        return self.scoring.refined(fit, s)

    def _prune(self) -> None:
        """Takes out what the others have made superfluous."""
        for choice in list(self.model.choices[:-1]):
            self._drop_if_small(choice, 0.5)

    def _drop_if_small(self, choice: Candidate, part: float = 1.0) -> None:
        """Takes a choice out that the others leave too little, curves among them: a part of what is asked of it."""
        s = self.scoring.tested(self.model.fit(choice), choice)
        if s.p_value > self.options.false_discovery or s.share < part * self.scoring.share_asked(s, choice):
            self.model.drop(choice)

    def _with_needed_form(self) -> bool:
        """Exchanges two laws of a joint's angle where the one with more parameters is needed beside the other, or not.

        Residuals of friction, lags and gears depend on the motion and differ between blocks. A residual over the angle
        that is alike in all blocks says that the law's form is wrong. Without one the simpler law stays.

        Returns:
            Whether any was exchanged.
        """
        for position, choice in enumerate(self.model.choices):
            if not isinstance(choice.effect, AngleLaw):
                continue
            fit = self.model.fit(choice)
            laws = [starts for starts in self.pool
                    if isinstance(starts[0].effect, AngleLaw) and starts[0].joint == choice.joint]
            tried = [self.scoring.refined(fit, s) for s in self.scoring.scored(fit, laws)]
            others = [s for s in tried if s.place != choice.place]
            own = [self.scoring.tested(fit, choice), *(s for s in tried if s.place == choice.place)]
            present = max(own, key=lambda s: s.test.total)
            if self.learns and choice.theta:
                # With a shape of its own a law bends to nearly any curve, which has to be needed beside it.
                others += self.curves.over_angle(fit, choice.joint)
            for other in others:
                simple, rich = sorted((present, other), key=lambda s: s.parameter_count)
                # With any of its theta the simpler one may do without the other.
                needed = rich.test.total > simple.test.total and all(
                    self.scoring.tested(self.model.fit_beside(s, choice), rich).p_value < self.options.learned_discovery
                    for s in ([other] if simple is other else own))
                if needed == (rich is other) and self.scoring.is_large(other, choice) \
                        and other.test.total > NEARLY * present.test.total:
                    better = dataclasses.replace(other, rivals=rivals_of(self.model, other, [present]),
                                                 asked=self.scoring.smallest_share(other, choice))
                    self.model.replace([*self.model.choices[:position], better, *self.model.choices[position + 1 :]])
                    return True
        return False

    def _retune(self, newest: Candidate) -> None:
        """Theta of each effect once more, where the newest acts on the same channels: they were found without it.

        Args:
            newest: that was taken.
        """
        for choice in self.model.choices:
            if choice.effect.learned or not choice.theta or not overlap(self.model, choice, newest):
                continue
            fit = self.model.fit(choice)
            better = self.scoring.refined(fit, self.scoring.tested(fit, choice))
            if better.key != choice.key:
                self.model.replace([dataclasses.replace(c, theta=better.theta) if c is choice else c
                                    for c in self.model.choices])
