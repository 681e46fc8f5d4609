"""The search: effects are added one by one, each fitted jointly with all parameters, compared with its mimics on time
blocks that had no part in the fit, and taken out again when later ones make it superfluous.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.search.candidates import Candidate, prepared
from ideal_robot.diagnosis.search.choice import Choice, Scored
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.block_regression import Fit
from ideal_robot.diagnosis.statistics.dependence import terms, time_period
from ideal_robot.effects import TCP_POSITION


class Search(Scoring):
    """Forward selection with backward pruning and exchange; see ``Scoring`` for the arguments."""

    def run(self) -> list[Choice]:
        """Selects; returns the choices in the order they were taken."""
        for round_ in range(self.options.most):
            self.progress(min(0.9, 0.1 + 0.8 * round_ / (round_ + 4.0)), f"round {round_ + 1}")
            choice = self._next()
            if choice is None:
                break
            self._take(choice)
            self._prune()
            self._exchange()
        return self.choices

    def _take(self, choice: Choice) -> None:
        self._ensure(choice.candidate)
        self.choices.append(choice)
        self.weights = self._weights(self.keys())

    def _next(self) -> Choice | None:
        fit = self.fit()
        residual = self.residual(fit)
        scored = self._score(fit, residual, self.pool)
        self.rounds.append(scored)
        best = self._best(fit, scored)
        learned = self._learned(fit, residual, best) if self.learns else None
        return learned if learned is not None else best

    def _best(self, fit: Fit, scored: list[Scored]) -> Choice | None:
        """The winner of this round: significant among all, large enough, best on held-out blocks after refinement."""
        passed = [s for s in self._discovered(scored) if self._large(s)]
        if not passed:
            return None
        passed.sort(key=lambda s: -s.trial.total)
        top = passed[0].trial.total
        refined = [self._refined(fit, s) for s in passed[:6] if s.trial.total > 0.4 * top]
        refined.sort(key=lambda s: -s.trial.total)
        winner = refined[0]
        # Of those that the data cannot tell apart, the one with fewest parameters.
        for other in refined[1:]:
            if other.candidate.cost < winner.candidate.cost and self._equal(refined[0], other, 0.95):
                winner = other
        return Choice(winner.candidate, winner.p_value, self._rivals(winner, refined), winner.share)

    def settle(self, prior: Array) -> None:
        """Takes a looser prior and drops effects that the model's own parameters can now take over."""
        self.prior = prior
        self.weights = self._weights(self.keys())
        for choice in sorted(self.choices, key=lambda c: c.share):
            if choice.candidate.effect.absorbed_by_base:
                continue
            trial = self._tried(self.fit(without=choice), choice.candidate, choice.dependence)
            if trial.p_value > self.options.false_discovery or trial.share < self._smallest(choice.candidate, choice):
                self.choices.remove(choice)
                self.weights = self._weights(self.keys())

    def adopt(self, other: Search) -> None:
        """Takes over the columns of another search's choices."""
        for choice in self.choices:
            self.design.add(choice.candidate.key, other.design.groups[choice.candidate.key])
        self.weights = self._weights(self.keys())

    # -- what the library does not have --------------------------------------------------------------------------------

    def _learned(self, fit: Fit, residual: Array, best: Choice | None) -> Choice | None:
        """A learned curve, if it wins clearly more than the best effect of the library in this round."""
        to_beat = 0.0
        if best is not None:
            to_beat = self.options.unknown_margin * self._tried(fit, best.candidate).trial.total
        scored: list[Scored] = []
        blocks = self.data.blocks.of_samples()
        selecting = self.data.blocks.fold[blocks] >= 0
        for j in range(self.data.c):
            if j + 1 in self.experiment.undecided and self.experiment.domain != TCP_POSITION:
                continue
            use = self.data.use[:, j] & selecting
            squares = float(np.sum(residual[use, j] ** 2) * self.weights[j])
            tests = [self.sieve.test(residual[:, j], use, j, term)
                     for term in terms(self.at_rows, j, best is None, self.experiment.domain)]
            period = time_period(residual[:, j], use, self.at_rows.t, self.experiment.domain)
            if period is not None:
                tests.append(self.sieve.test(residual[:, j], use, j, period))
            tests.sort(key=lambda d: -(d.share - d.expected))
            # Only a sieve: what is promising is tried on held-out blocks below, paid for all curves looked at.
            promising = [d for d in tests if d.p_value < 0.05 and 3.0 * d.share * squares > to_beat]
            for d in promising[:6]:
                candidate = Candidate(d.term, j + 1, (), len(tests) * self.data.c)
                key = candidate.key
                self.design.add(key, prepared(self.experiment, self.data,
                                              d.term.columns(self.experiment.signals, j + 1, ())))
                scored.append(self._tried(fit, candidate, d))
        scored = [s for s in scored if s.p_value < self.options.false_discovery and self._large(s)
                  and s.trial.total > to_beat and not self._taken(s.candidate)]
        if not scored:
            return None
        s = max(scored, key=lambda s: s.trial.total)
        return Choice(s.candidate, s.p_value, (), s.share, s.dependence)

    def _taken(self, candidate: Candidate) -> bool:
        return any(c.candidate.key == candidate.key for c in self.choices)

    # -- second thoughts -----------------------------------------------------------------------------------------------

    def _prune(self) -> None:
        """Takes out what the others have made superfluous; a learned curve never pushes out a physical cause."""
        if self.choices[-1].candidate.effect.learned:
            return
        for choice in list(self.choices[:-1]):
            trial = self._tried(self._rivalling(choice), choice.candidate)
            if trial.p_value > self.options.false_discovery or trial.share < 0.5 * self.options.smallest:
                self.choices.remove(choice)
                self.weights = self._weights(self.keys())

    def _exchange(self) -> None:
        """Tries, for each selected effect, every other one that acts on the same joint in its place."""
        if len(self.choices) < 2:
            return
        newest = self.choices[-1].candidate
        if newest.effect.learned:
            return
        for position, choice in enumerate(list(self.choices[:-1])):
            if not self._overlap(choice.candidate, newest):
                continue
            fit = self._rivalling(choice)
            present = self._tried(fit, choice.candidate)
            pool = [starts for starts in self.pool if starts[0].joint in (choice.candidate.joint, 0)
                    and (starts[0].place != choice.candidate.place or len(starts) > 1)]
            rivals = self._score(fit, self.residual(fit), pool)
            rivals = [s for s in rivals if s.p_value < self.options.false_discovery and self._large(s)
                      and s.trial.total > 0.8 * present.trial.total]
            refined = sorted((self._refined(fit, s) for s in rivals), key=lambda s: -s.trial.total)
            if refined and refined[0].trial.total > 1.03 * present.trial.total:
                s = refined[0]
                self._ensure(s.candidate)
                self.choices[position] = Choice(s.candidate, s.p_value, self._rivals(s, refined), s.share)
                self.weights = self._weights(self.keys())

    def _rivalling(self, choice: Choice) -> Fit:
        """The fit against which a choice has to hold its place: without it, and for a physical cause without curves."""
        if choice.candidate.effect.learned:
            return self.fit(without=choice)
        keys = ["W", *[c.candidate.key for c in self.choices if c is not choice and not c.candidate.effect.learned]]
        return Fit(self.design, keys, self.weights, self.prior)
