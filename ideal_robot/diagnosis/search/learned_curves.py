"""What the library does not have: curves over signals, taken where they explain clearly more than any effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.diagnosis.search.choice import FINALISTS
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms, time_period
from ideal_robot.diagnosis.statistics.least_squares import Fit
from ideal_robot.diagnosis.statistics.problem import Candidate
from ideal_robot.effects import TCP_POSITION
from ideal_robot.effects.fitted import Unknown


class LearnedCurves:
    """Looks for curves in what the present model leaves.

    Args:
        scoring: of the present model.
    """

    def __init__(self, scoring: Scoring) -> None:
        self.scoring, self.model, self.options = scoring, scoring.model, scoring.options
        problem = self.model.problem
        self.use = problem.products.use & problem.blocks.selecting[problem.blocks.of_samples()][:, None]
        self.dependence = DependenceTest(scoring.at_rows, self.use, problem.blocks)
        self._of_signals: dict[tuple[int, bool], list[Unknown]] = {}

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
        curves = [Candidate(term, joint) for term in self._terms(joint - 1, False)
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
        curves = [*self._terms(j, pairs), *([] if period is None else [period])]
        tests = sorted(self.dependence.tests(residual[:, j], j, curves), key=lambda d: -d.adjusted)
        # Only a first choice: what is promising is tested on blocks left out, corrected for all curves looked at.
        promising = [d for d in tests if d.p_value < 0.05 and 3.0 * d.share * squares > least]
        scored = []
        for d in promising[:FINALISTS]:
            candidate = Candidate(d.term, j + 1, (), len(tests) * self.model.problem.products.c)
            if d.term.frequency:
                # One of an earlier round may have had the same name.
                self.model.design.drop(candidate.key)
            self.model.add_columns(candidate)
            scored.append(self.scoring.tested(fit, candidate))
            # A curve has many columns, and every round has other curves.
            self.model.design.forget_products(candidate.key)
        return scored

    def _terms(self, j: int, pairs: bool) -> list[Unknown]:
        """Curves to try on channel ``j``; they follow from the signals alone and are the same in every round."""
        if (j, pairs) not in self._of_signals:
            domain = self.model.problem.regression.domain
            self._of_signals[j, pairs] = terms(self.scoring.at_rows, j, pairs, domain)
        return self._of_signals[j, pairs]
