"""What the library does not have: curves over signals, taken where they explain clearly more than any effect."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.search.choice import FINALISTS
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms, time_period
from ideal_robot.diagnosis.statistics.least_squares import Fit
from ideal_robot.diagnosis.statistics.problem import Candidate
from ideal_robot.effects import TCP_POSITION, Effect, Signals
from ideal_robot.effects.fitted import Unknown
from ideal_robot.effects.loads import flexible


class LearnedCurves:
    """Looks for curves in what the present model leaves.

    Args:
        scoring: of the present model.
    """

    def __init__(self, scoring: Scoring) -> None:
        self.scoring, self.model, self.options = scoring, scoring.model, scoring.options
        problem = self.model.problem
        self.use = problem.products.use & problem.blocks.selecting[problem.blocks.of_samples()][:, None]
        self.dependence = DependenceTest(scoring.at_rows, self.use, problem.blocks.edges)
        self._of_signals: dict[tuple[int, bool], list[Unknown]] = {}

    def best(self, fit: Fit, best: Candidate | None) -> Candidate | None:
        """A learned curve, if it reduces the residual clearly more than the best effect of the library.

        Args:
            fit: of the present model.
            best: the best effect of this round, or None.
        """
        # A law that bends to nearly any curve has no advantage.
        margin = self.options.unknown_margin if best is None or not flexible(best.effect) else 1.0
        least = 0.0 if best is None else margin * best.test.total
        problem = self.model.problem
        residual = self.model.residual(fit)
        scored: list[Candidate] = []
        for j in range(problem.products.c):
            if j + 1 in problem.regression.undecided and problem.regression.domain != TCP_POSITION:
                continue
            scored += self._of_channel(fit, residual, j, best is None, least)
        return self._largest(scored, least)

    def in_channel(self, fit: Fit, channel: int) -> Candidate | None:
        """The curve that takes most away in one channel, from 0, whether it is large or not.

        Args:
            fit: without it.
            channel: from 0.
        """
        scored = self._of_channel(fit, self.model.residual(fit), channel, False, 0.0)
        return max(scored, key=lambda s: s.test.total, default=None)

    def over_angle(self, fit: Fit, joint: int) -> Candidate | None:
        """The curve over a joint's own angle, if blocks left out need it.

        For a torque that a law of that angle explained: in what parameters leave of it, once they take what they can,
        the angle need not stand out before the curve is fitted together with them.

        Args:
            fit: of the present model.
            joint: from 1.
        """
        curves = [term for term in self._terms(joint - 1, False)
                  if term.depends_on == (f"q_{joint}",) and not term.directed]
        scored = []
        for term in curves:
            candidate = Candidate(term, joint, (), len(curves))
            self.model.add_columns(candidate)
            scored.append(self.scoring.tested(fit, candidate))
        return self._largest(scored, 0.0)

    def _largest(self, scored: list[Candidate], least: float) -> Candidate | None:
        """The curve that takes most away and more than the least, if one that is not taken is certain and large."""
        taken = {c.key for c in self.model.choices}
        scored = [s for s in scored if s.p_value < self.options.learned_discovery and s.test.total > least
                  and s.key not in taken and self.scoring.is_large(s)]
        found = max(scored, key=lambda s: s.test.total, default=None)
        return None if found is None else replace(found, asked=self.scoring.smallest_share(found))

    def _of_channel(self, fit: Fit, residual: np.ndarray, j: int, pairs: bool, least: float) -> list[Candidate]:
        """Curves of channel ``j`` tested on blocks left out; ``least`` is what they have to take away."""
        regression = self.model.problem.regression
        use = self.use[:, j]
        squares = float(np.sum(residual[use, j] ** 2) * self.model.weights[j])
        at_rows = self.scoring.at_rows
        tests = [self.dependence.test(residual[:, j], j, term) for term in self._terms(j, pairs)]
        period = time_period(residual[:, j], use, at_rows.t, regression.domain)
        if period is not None:
            tests.append(self.dependence.test(residual[:, j], j, period))
        tests.sort(key=lambda d: -d.adjusted)
        # Only a first choice: what is promising is tested on blocks left out, corrected for all curves looked at.
        promising = [d for d in tests if d.p_value < 0.05 and 3.0 * d.share * squares > least]
        scored = []
        for d in promising[:FINALISTS]:
            candidate = Candidate(d.term, j + 1, (), len(tests) * self.model.problem.products.c)
            self.model.design.add(candidate.key, self.model.problem.columns(candidate))
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


_PLACES = np.linspace(0.1, 0.9, 17)
"""Where in the range a pull may begin: in what was seen it both is slack and pulls."""


@dataclass(frozen=True)
class OneSidedPull(Effect):
    """Torque of a hose or a strap that is slack up to an angle and pulls back beyond it.

    With ``x`` the angle beyond ``start`` on its ``side``, and zero before it, ``tau = side (c_1 x + c_2 x² + c_3 x³)``:
    the first terms of whatever is slack in a part of the range and stiffens, in as many numbers as a balancing spring
    has. It is no cause of the library, and only says what else a curve over the angle may come from.

    Attributes:
        side: 1 where it pulls beyond the angle, -1 where it pulls below.
    """

    side: float

    name = "one_sided_pull"
    theta_names = ("start",)
    theta_units = ("rad",)
    coefficient_names = ("stiffness", "stiffening", "further stiffening")
    coefficient_units = ("N m/rad", "N m/rad²", "N m/rad³")
    source = "hoses and straps with slack"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Evenly over the middle four fifths of the range."""
        low, high = np.percentile(signals.q[:, joint - 1], [1.0, 99.0])
        return [(float(place),) for place in low + _PLACES * (high - low)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Within what is tried to start from."""
        places = self.starts(signals, joint)
        return [(places[0][0], places[-1][0])]

    def bounds_near(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> list[tuple[float, float]]:
        """See ``Effect.bounds_near``. Up to the next places on either side: an angle has no scale."""
        [(low, high)] = self.bounds(signals, joint)
        step = (high - low) / (len(_PLACES) - 1)
        return [(max(low, theta[0] - step), min(high, theta[0] + step))]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 3)``."""
        x = np.maximum(self.side * (signals.q[:, joint - 1] - theta[0]), 0.0)
        return signals.on_joint(joint, self.side * x, self.side * x**2, self.side * x**3)

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. At the end of what was seen it pulls back, and the more the further."""
        x = float(np.max(self.side * (signals.q[:, joint - 1] - theta[0])))
        orders = np.arange(1, len(coefficients) + 1)
        return bool(coefficients @ x**orders > 0.0 and coefficients @ (orders * x ** (orders - 1)) > 0.0)
