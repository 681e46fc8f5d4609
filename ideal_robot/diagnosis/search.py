"""The search: effects are added one by one, each fitted jointly with all parameters, compared with its mimics on time
blocks that had no part in the fit, and taken out again when later ones make it superfluous.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize

from ideal_robot.diagnosis.candidates import Candidate, candidates, prepared, scanned
from ideal_robot.diagnosis.dependence import Dependence, Sieve, terms, time_period
from ideal_robot.diagnosis.experiment import Experiment
from ideal_robot.diagnosis.gram import Data
from ideal_robot.diagnosis.regression import Design, Fit, Trial, channel_weights
from ideal_robot.effects import Effect
from ideal_robot.effects.torque_ripple import TorqueRipple
from ideal_robot.interface import Array

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Options:
    """Thresholds of the search.

    Attributes:
        false_discovery: rate that Benjamini–Hochberg controls over joints × effects of each round.
        smallest: share of a channel's residual squares an effect has to take away on held-out blocks.
        smallest_next: the same for a channel that has an effect already: its form may be slightly another.
        smallest_learned: the same for a learned curve; twice that where the channel has an effect already.
        smallest_in_base: the same for an effect that is a change of the model's own parameters.
        smallest_torque: rms of an effect over rms of the torque below which nothing is claimed.
        smallest_own: share of an effect's squares that the other parameters must not be able to cancel.
        unknown_margin: a learned curve replaces the best effect of the library only if it wins so many times as much.
        most: effects at most.
    """

    false_discovery: float = 0.01
    smallest: float = 0.08
    smallest_next: float = 0.10
    smallest_learned: float = 0.10
    smallest_in_base: float = 0.10
    smallest_torque: float = 0.002
    smallest_own: float = 0.0005
    unknown_margin: float = 1.6
    most: int = 24


@dataclass(frozen=True)
class Choice:
    """A selected candidate and the evidence for it in the round it was taken.

    Attributes:
        candidate: with refined theta.
        p_value: of its held-out score, paid for the values of theta that were tried.
        rivals: labels of candidates that the data cannot tell from it, with the share of its win that they reach.
        share: share of the most affected channel's squares that it won on held-out blocks.
        dependence: for a learned term, the dependence that led to it.
    """

    candidate: Candidate
    p_value: float
    rivals: tuple[tuple[str, int, float], ...] = ()
    share: float = 0.0
    dependence: Dependence | None = None


@dataclass
class Scored:
    """A candidate with what it would win."""

    candidate: Candidate
    trial: Trial
    p_value: float
    share: float
    dependence: Dependence | None = field(default=None)


class Search:
    """Forward selection with backward pruning and exchange.

    Args:
        experiment: the regression.
        data: its rows and blocks.
        library: effects to choose from.
        prior: precision of the model's parameters, or None where they are free.
        in_base: whether effects are tried that the model's own parameters could take over.
        options: thresholds.
        rng: for null distributions.
        progress: called with a share done and a word.
        only: names and joints of the effects that may be looked for; then nothing is learned either.
    """

    def __init__(self, experiment: Experiment, data: Data, library: tuple[Effect, ...], *, prior: Array | None,
                 in_base: bool, options: Options, rng: np.random.Generator, progress: Progress,
                 only: tuple[tuple[str, int], ...] | None = None) -> None:
        self.experiment, self.data, self.prior = experiment, data, prior
        self.options, self.progress = options, progress
        self.design = Design(data)
        self.at_rows = experiment.decimated_signals()
        self.sieve = Sieve(self.at_rows, data.blocks.edges, rng)
        self.pool = [starts for starts in candidates(library, experiment.signals, experiment.undecided, in_base)
                     if only is None or (starts[0].effect.name, starts[0].joint) in only]
        self.learns = only is None
        self.weights = self._weights(["W"])
        self.choices: list[Choice] = []
        self.rounds: list[list[Scored]] = []
        power = (experiment.measured**2 * data.use).sum(axis=0) / np.maximum(data.use.sum(axis=0), 1)
        self.torque_rms = np.sqrt(np.maximum(power, 1e-300))

    # -- the loop ----------------------------------------------------------------------------------------------------

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

    def keys(self, without: Choice | None = None) -> list[str]:
        """Groups of the present model."""
        return ["W", *[c.candidate.key for c in self.choices if c is not without]]

    def fit(self, without: Choice | None = None) -> Fit:
        """Fit of the present model."""
        return Fit(self.design, self.keys(without), self.weights, self.prior)

    def _take(self, choice: Choice) -> None:
        self._ensure(choice.candidate)
        self.choices.append(choice)
        self.weights = self._weights(self.keys())

    def _weights(self, keys: list[str]) -> Array:
        """Noise of each channel from the present residual, twice, so that no channel's misfit weighs on another."""
        weights = channel_weights(Fit(self.design, ["W"], np.ones(self.data.c), self.prior).squares(), self.data.count)
        for _ in range(2):
            weights = channel_weights(Fit(self.design, keys, weights, self.prior).squares(), self.data.count)
        return weights

    def _next(self) -> Choice | None:
        fit = self.fit()
        residual = self.residual(fit)
        scored = self._score(fit, residual, self.pool)
        self.rounds.append(scored)
        best = self._best(fit, scored)
        learned = self._learned(fit, residual, best) if self.learns else None
        return learned if learned is not None else best

    def settle(self, prior: Array) -> None:
        """Takes a looser prior and drops effects that the model's own parameters can now take over."""
        self.prior = prior
        self.weights = self._weights(self.keys())
        for choice in sorted(self.choices, key=lambda c: c.share):
            if choice.candidate.effect.in_base:
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

    # -- scoring -----------------------------------------------------------------------------------------------------

    def _score(self, fit: Fit, residual: Array, pool: list[list[Candidate]]) -> list[Scored]:
        """The best start of every effect at every joint, with its held-out trial."""
        scored = []
        taken = {(c.candidate.effect.name, c.candidate.joint) for c in self.choices if c.candidate.key in fit.keys}
        for starts in pool:
            first = starts[0]
            repeatable = isinstance(first.effect, TorqueRipple)
            if (first.effect.name, first.joint) in taken and not repeatable:
                continue
            if isinstance(first.effect, TorqueRipple):
                seen = first.effect.seen(self.at_rows, first.joint, residual, self.data.use)
                starts = scanned(first.effect, first.joint, self.at_rows, *seen)
            best: tuple[float, Candidate] | None = None
            for candidate in starts:
                gain = self._plausible_gain(fit, candidate)
                if gain is not None and (best is None or gain > best[0]):
                    best = gain, candidate
            if best is not None and best[0] > 4.0:
                scored.append(self._tried(fit, best[1]))
        return scored

    def _ensure(self, candidate: Candidate) -> None:
        if candidate.key not in self.design.groups:
            self.design.add(candidate.key, candidate.columns(self.experiment, self.data))

    def _plausible_gain(self, fit: Fit, candidate: Candidate) -> float | None:
        self._ensure(candidate)
        gain, coefficients = fit.gain(candidate.key)
        if not np.any(coefficients) or not candidate.effect.plausible(coefficients, candidate.theta,
                                                                      self.experiment.signals, candidate.joint):
            return None
        return gain

    def _tried(self, fit: Fit, candidate: Candidate, found: Dependence | None = None) -> Scored:
        trial = fit.trial(candidate.key)
        selecting = self.data.blocks.fold >= 0
        squares = (fit.held_out_squares()[selecting] * self.weights).sum(axis=0)
        share = float(np.max(trial.won_by_channel / np.maximum(squares, 1e-300)))
        return Scored(candidate, trial, min(1.0, trial.p_value * candidate.tries), share, found)

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

    def _discovered(self, scored: list[Scored]) -> list[Scored]:
        """Benjamini–Hochberg over all joints × effects of the round."""
        ordered = sorted(scored, key=lambda s: s.p_value)
        tests = max(len(self.pool), 1)
        last = 0
        for rank, s in enumerate(ordered, start=1):
            if s.p_value <= self.options.false_discovery * rank / tests:
                last = rank
        return ordered[:last]

    def _large(self, s: Scored) -> bool:
        if s.share < self._smallest(s.candidate):
            return False
        columns = self.design.groups[s.candidate.key]
        own = columns.values @ s.trial.coefficients
        size = np.sqrt(np.mean(own**2, axis=0))
        # What the other parameters cancel almost wholly is no cause but a way of bending a curve.
        weighted = float(((own**2).sum(axis=0) * self.weights[list(columns.channels)]).sum())
        if s.trial.gain < self.options.smallest_own * weighted:
            return False
        return bool(np.max(size / self.torque_rms[list(columns.channels)]) > self.options.smallest_torque)

    def _smallest(self, candidate: Candidate, own: Choice | None = None) -> float:
        """Share of the residual's squares that is asked of a candidate; ``own`` is its choice if it was taken."""
        occupied = any(c.candidate.joint == candidate.joint for c in self.choices if c is not own)
        if candidate.effect.name == "unknown":
            return self.options.smallest_learned * (2.0 if occupied else 1.0)
        if candidate.effect.in_base:
            return self.options.smallest_in_base
        return self.options.smallest_next if occupied else self.options.smallest

    def _refined(self, fit: Fit, s: Scored) -> Scored:
        """Theta by bounded search from the best start, all linear parameters eliminated."""
        effect, joint = s.candidate.effect, s.candidate.joint
        bounds = effect.bounds(self.experiment.signals, joint)
        if not bounds or len(bounds) != len(s.candidate.theta) or (len(bounds) == 1 and s.candidate.theta[0] == 0.0):
            return s
        theta0 = np.array(s.candidate.theta)
        if isinstance(effect, TorqueRipple):
            width = 1.5 / float(np.ptp(self.experiment.signals.q[:, joint - 1]))
            bounds = [(theta0[0] - width, theta0[0] + width)]

        def loss(theta: Array) -> float:
            candidate = replace(s.candidate, theta=tuple(float(v) for v in theta))
            self._ensure(candidate)
            gain = self._plausible_gain(fit, candidate)
            if candidate.key != s.candidate.key and candidate.key not in self.keys():
                self.design.drop(candidate.key)
            return -gain if gain is not None else 0.0

        if len(bounds) == 1:
            low, high = bounds[0]
            if not isinstance(effect, TorqueRipple):
                near, far = sorted((theta0[0] / 3.0, theta0[0] * 3.0))
                low, high = max(low, near), min(high, far)
            found = optimize.minimize_scalar(lambda v: loss(np.array([v])), bounds=(low, high), method="bounded",
                                             options={"maxiter": 14, "xatol": 1e-3 * (high - low)})
            theta = np.array([float(found.x)])
        else:
            found = optimize.minimize(loss, theta0, method="Nelder-Mead", bounds=bounds,
                                      options={"maxfev": 40, "xatol": 1e-3, "fatol": 1e-2})
            theta = np.asarray(found.x)
        better = replace(s.candidate, theta=tuple(float(v) for v in theta))
        if self._plausible_gain(fit, better) is None:
            return s
        tried = self._tried(fit, better)
        return tried if tried.trial.total > s.trial.total else s

    def _rivals(self, winner: Scored, others: list[Scored]) -> tuple[tuple[str, int, float], ...]:
        """Candidates that win nine tenths of it, or not significantly less: with other data they might be ahead."""
        rivals = []
        for s in others:
            if s is winner:
                continue
            ratio = s.trial.total / max(winner.trial.total, 1e-300)
            nearly = ratio > 0.9 and self._overlap(winner.candidate, s.candidate)
            if nearly or self._equal(winner, s, 0.8):
                rivals.append((s.candidate.effect.name, s.candidate.joint, ratio))
        return tuple(rivals)

    def _equal(self, winner: Scored, other: Scored, share: float) -> bool:
        """Whether another candidate wins as much on the same channel, but for what scatters from block to block."""
        if not self._overlap(winner.candidate, other.candidate) or other.trial.total < share * winner.trial.total:
            return False
        difference = winner.trial.won - other.trial.won
        difference = difference[np.isfinite(difference)]
        error = float(np.std(difference, ddof=1)) * np.sqrt(len(difference))
        return bool(float(difference.sum()) < 2.0 * error)

    def _overlap(self, a: Candidate, b: Candidate) -> bool:
        """Whether two candidates act on a common channel, so that one can stand for the other."""
        ours, theirs = (set(self.design.groups[c.key].channels) for c in (a, b) if c.key in self.design.groups)
        same = a.joint == b.joint or not a.joint or not b.joint
        return bool(ours & theirs) and (same or min(len(ours), len(theirs)) == 1)

    # -- what the library does not have -------------------------------------------------------------------------------

    def _learned(self, fit: Fit, residual: Array, best: Choice | None) -> Choice | None:
        """A learned curve, if it wins clearly more than the best effect of the library in this round."""
        to_beat = 0.0
        if best is not None:
            to_beat = self.options.unknown_margin * self._tried(fit, best.candidate).trial.total
        scored: list[Scored] = []
        blocks = self.data.blocks.of_samples()
        selecting = self.data.blocks.fold[blocks] >= 0
        for j in range(self.data.c):
            if j + 1 in self.experiment.undecided and self.experiment.head != "tcp":
                continue
            use = self.data.use[:, j] & selecting
            squares = float(np.sum(residual[use, j] ** 2) * self.weights[j])
            tests = [self.sieve.test(residual[:, j], use, j, term)
                     for term in terms(self.at_rows, j, best is None, self.experiment.head)]
            period = time_period(residual[:, j], use, self.at_rows.t, self.experiment.head)
            if period is not None:
                tests.append(self.sieve.test(residual[:, j], use, j, period))
            tests.sort(key=lambda d: -(d.share - d.expected))
            # Only a sieve: what is promising is tried on held-out blocks below, paid for all curves looked at.
            promising = [d for d in tests if d.p_value < 0.3 and 3.0 * d.share * squares > to_beat]
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

    # -- second thoughts ----------------------------------------------------------------------------------------------

    def _prune(self) -> None:
        """Takes out what the others have made superfluous; a learned curve never pushes out a physical cause."""
        if self.choices[-1].candidate.effect.name == "unknown":
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
        if newest.effect.name == "unknown":
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
        if choice.candidate.effect.name == "unknown":
            return self.fit(without=choice)
        keys = [key for key in self.keys(without=choice) if not key.startswith("unknown:")]
        return Fit(self.design, keys, self.weights, self.prior)

    def residual(self, fit: Fit) -> Array:
        """Residual at all rows ``(N, c)``."""
        r = self.data.y.values[:, :, 0].copy()
        at = 0
        for key in fit.keys:
            group = self.design.groups[key]
            r[:, list(group.channels)] -= group.values @ fit.beta[at : at + group.m]
            at += group.m
        return np.asarray(r)
