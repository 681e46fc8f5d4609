"""The search: forward selection of effects, with pruning.

They are added one by one, each fitted together with all parameters, compared with its rivals on blocks of time that had
no part in the fit, and taken out again when later ones make it superfluous.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.search.choice import FINALISTS, NEARLY, Options, PresentModel, overlap
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.least_squares import TOLD, Fit, standard_errors
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem
from ideal_robot.effects import Effect, Signals
from ideal_robot.effects.loads import AngleLaw
from ideal_robot.errors import RaisedBy
from ideal_robot.progress import Progress, silent


def discoveries(scored: Sequence[Candidate], tests: int, rate: float) -> list[Candidate]:
    """Candidates that Benjamini–Hochberg accepts.

    Args:
        scored, tests: with their p-values, and how many were tested, joints × effects.
        rate: of false discoveries.
    """
    ordered = sorted(scored, key=lambda s: s.p_value)
    accepted = [rank for rank, s in enumerate(ordered, start=1) if s.p_value <= rate * rank / max(tests, 1)]
    return ordered[: max(accepted, default=0)]


def indistinguishable(model: PresentModel, best: Candidate, other: Candidate) -> bool:
    """Whether another candidate reduces the same channel as much, but for what scatters from block to block.

    Args:
        model, best, other: the two, and against what they were scored.
    """
    if not overlap(model, best, other) or other.test.total < NEARLY * best.test.total:
        return False
    return standard_errors(best.test.reduction - other.test.reduction) < TOLD


def likelier(best: Candidate, others: list[Candidate]) -> Candidate:
    """The best one, or one of the others that is taken sooner and reduces nearly as much of what is asked of it."""
    return next((other for other in others if best.effect.name in other.effect.sooner_than and
                 other.test.total / other.effect.caution > NEARLY * best.test.total / best.effect.caution), best)


def candidates(effects: Sequence[Effect], signals: Signals, undecided: dict[int, str],
               absorbed: bool) -> Iterator[list[Candidate]]:
    """For every effect and joint the list of its starts, joints that move too little left out.

    Args:
        effects, signals: to try, in a recording.
        undecided: joints that cannot be decided.
        absorbed: whether effects may be tried that the model's own parameters can take over.
    """
    for effect in effects:
        if effect.absorbed_by_base and not absorbed:
            continue
        with RaisedBy(f"effect {effect.key}, as its starts are found"):
            for joint in effect.joints(signals):
                if joint not in undecided and effect.usable(signals, joint):
                    starts = [()] if effect.scanned else effect.starts(signals, joint)
                    yield [Candidate(effect, joint, theta, len(starts)) for theta in starts]


Only = tuple[tuple[str, int], ...]
"""Names and joints of the effects that may be looked for."""


class Search:
    """Forward selection with backward pruning.

    Args:
        problem, effects, options: the regression, what to choose from, and thresholds.
        absorbed: whether effects are tried that the model's own parameters could take over.
        only: names and joints of the effects that may be looked for; then nothing is learned either.
        progress: called with the share done and a word.
    """

    def __init__(self, problem: Problem, effects: Sequence[Effect], options: Options, *,
                 absorbed: bool, only: Only | None = None, progress: Progress = silent) -> None:
        self.options, self.progress = options, progress
        self.model = PresentModel(problem)
        self.scoring = Scoring(self.model, options)
        self.learns = only is None
        regression = problem.regression
        pool = [starts for starts in candidates(effects, regression.signals, regression.undecided, absorbed)
                if only is None or (starts[0].effect.name, starts[0].joint) in only]
        # Joint by joint, as several effects need how torques change with its motion, which is large to keep.
        self.pool = sorted(pool, key=lambda starts: starts[0].joint)

    def run(self, start: Sequence[Candidate] = ()) -> list[Candidate]:
        """The choices in the order they were taken, first those of an earlier search that still hold their places."""
        self.model.replace(list(start))
        for candidate in sorted(start, key=lambda c: c.share):
            self._drop_if_small(candidate)
        self._with_needed_form()
        for round_ in range(self.options.most):
            # How many rounds there will be is not known: each takes a share of what is left.
            self.progress(round_ / (round_ + 4.0), f"round {round_ + 1}")
            fit = self.model.fit()
            best = self._best(fit, self.scoring.scored(fit, self.pool))
            choice = (self.scoring.best_curve(fit, best) if self.learns else None) or best
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
        passed.sort(key=lambda s: -s.test.total)
        refined: list[Candidate] = []
        for s in passed:
            if len(refined) == FINALISTS or (refined and s.test.total < 0.4 * refined[0].test.total):
                break
            better = self.scoring.refined(fit, s)
            if self.scoring.holds_slowly(better) and self.scoring.holds_everywhere(fit, better):
                refined.append(better)
        if not refined:
            return None
        refined.sort(key=lambda s: -s.test.total)
        first = refined[0]
        # Of those that the data cannot tell apart, the one with fewest parameters.
        alike = [first, *(other for other in refined if other.parameter_count < first.parameter_count
                          and indistinguishable(self.model, first, other))]
        best = likelier(min(alike, key=lambda s: s.parameter_count), refined)
        return self._with_rivals(best, refined, self.scoring.share_asked(best))

    def _with_rivals(self, best: Candidate, others: Sequence[Candidate], asked: float) -> Candidate:
        """The best one with what was asked of it, and its rivals: with other data they might be ahead of it."""
        shares = [(s, s.test.total / max(best.test.total, 1e-300)) for s in others if s is not best]
        return replace(best, asked=asked, rivals=tuple((s.effect.name, s.joint, share) for s, share in shares
                                                       if share > NEARLY and overlap(self.model, best, s)))

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
        """
        for position, choice in enumerate(self.model.choices):
            if not isinstance(choice.effect, AngleLaw):
                continue
            fit = self.model.fit(choice)
            laws = [starts for starts in self.pool
                    if isinstance(starts[0].effect, AngleLaw) and starts[0].joint == choice.joint]
            tried = [self.scoring.refined(fit, s) for s in self.scoring.scored(fit, laws)]
            alternatives = [s for s in tried if s.place != choice.place]
            own = [self.scoring.tested(fit, choice), *(s for s in tried if s.place == choice.place)]
            present = max(own, key=lambda s: s.test.total)
            if self.learns and choice.theta:
                # With a shape of its own a law bends to nearly any curve, which has to be needed beside it.
                alternatives += self.scoring.curves_over_angle(fit, choice.joint)
            for other in alternatives:
                simple, rich = sorted((present, other), key=lambda s: s.parameter_count)
                # With any of its theta the simpler one may do without the other.
                needed = rich.test.total > simple.test.total and all(
                    self.scoring.tested(self.model.fit_beside(s, choice), rich).p_value < self.options.learned_discovery
                    for s in ([other] if simple is other else own))
                if needed == (rich is other) and self.scoring.is_large(other, choice) \
                        and other.test.total > NEARLY * present.test.total:
                    better = self._with_rivals(other, [present], self.scoring.smallest_share(other, choice))
                    self.model.replace([*self.model.choices[:position], better, *self.model.choices[position + 1 :]])
                    return True
        return False

    def _retune(self, newest: Candidate) -> None:
        """Theta of each effect once more, where the newest acts on the same channels: they were found without it."""
        for choice in self.model.choices:
            if choice.effect.learned or not choice.theta or not overlap(self.model, choice, newest):
                continue
            fit = self.model.fit(choice)
            better = self.scoring.refined(fit, self.scoring.tested(fit, choice))
            if better.key != choice.key:
                self.model.replace([replace(c, theta=better.theta) if c is choice else c for c in self.model.choices])
