"""What each candidate would win: scored on time blocks it has not seen, refined over theta, held against its mimics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import optimize

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import Experiment
from ideal_robot.diagnosis.search.candidates import Candidate, candidates
from ideal_robot.diagnosis.search.choice import Choice, Options, Scored
from ideal_robot.diagnosis.statistics.block_regression import Design, Fit, channel_weights
from ideal_robot.diagnosis.statistics.cross_products import Data
from ideal_robot.diagnosis.statistics.dependence import Dependence, Sieve
from ideal_robot.effects import Effect

Progress = Callable[[float, str], None]
_ITERATIONS = 4
"""Steps that bring a computational theta to where its coefficients are exact; each leaves a small share of the last."""


class Scoring:
    """The present model of a search, and how candidates are judged against it.

    Args:
        experiment: the regression.
        data: its rows and blocks.
        library: effects to choose from.
        prior: precision of the model's parameters, or None where they are free.
        absorbed: whether effects are tried that the model's own parameters could take over.
        options: thresholds.
        rng: for null distributions.
        progress: called with a share done and a word.
        only: names and joints of the effects that may be looked for; then nothing is learned either.
    """

    def __init__(self, experiment: Experiment, data: Data, library: tuple[Effect, ...], *, prior: Array | None,
                 absorbed: bool, options: Options, rng: np.random.Generator, progress: Progress,
                 only: tuple[tuple[str, int], ...] | None = None) -> None:
        self.experiment, self.data, self.prior = experiment, data, prior
        self.options, self.progress = options, progress
        self.design = Design(data)
        self.at_rows = experiment.decimated_signals()
        self.sieve = Sieve(self.at_rows, data.blocks.edges, rng)
        self.pool = [starts for starts in candidates(library, experiment.signals, experiment.undecided, absorbed)
                     if only is None or (starts[0].effect.name, starts[0].joint) in only]
        self.learns = only is None
        self.weights = self._weights(["W"])
        self.choices: list[Choice] = []
        self.rounds: list[list[Scored]] = []
        count = np.maximum(data.use.sum(axis=0), 1)
        mean = (experiment.measured * data.use).sum(axis=0) / count
        power = ((experiment.measured - mean) ** 2 * data.use).sum(axis=0) / count
        self.torque_std = np.sqrt(np.maximum(power, 1e-300))

    # -- the present model --------------------------------------------------------------------------------------------

    def keys(self, without: Choice | None = None) -> list[str]:
        """Groups of the present model."""
        return ["W", *[c.candidate.key for c in self.choices if c is not without]]

    def fit(self, without: Choice | None = None) -> Fit:
        """Fit of the present model."""
        return Fit(self.design, self.keys(without), self.weights, self.prior)

    def residual(self, fit: Fit) -> Array:
        """Residual at all rows ``(N, c)``."""
        r = self.data.y.values[:, :, 0].copy()
        at = 0
        for key in fit.keys:
            group = self.design.groups[key]
            r[:, list(group.channels)] -= group.values @ fit.beta[at : at + group.m]
            at += group.m
        return np.asarray(r)

    def _weights(self, keys: list[str]) -> Array:
        """Noise of each channel from the present residual, twice, so that no channel's misfit weighs on another."""
        weights = channel_weights(Fit(self.design, ["W"], np.ones(self.data.c), self.prior).squares(), self.data.count)
        for _ in range(2):
            weights = channel_weights(Fit(self.design, keys, weights, self.prior).squares(), self.data.count)
        return weights

    # -- a candidate ---------------------------------------------------------------------------------------------------

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

    def _smallest(self, candidate: Candidate, own: Choice | None = None) -> float:
        """Share of the residual's squares that is asked of a candidate; ``own`` is its choice if it was taken."""
        occupied = any(c.candidate.joint == candidate.joint for c in self.choices if c is not own)
        if candidate.effect.learned:
            return self.options.smallest_learned * (2.0 if occupied else 1.0)
        if candidate.effect.absorbed_by_base:
            return self.options.smallest_in_base
        return self.options.smallest_next if occupied else self.options.smallest

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
        return bool(np.max(size / self.torque_std[list(columns.channels)]) > self.options.smallest_torque)

    def _refined(self, fit: Fit, s: Scored) -> Scored:
        """Theta by bounded search from the best start, all linear parameters eliminated."""
        effect, joint = s.candidate.effect, s.candidate.joint
        if not effect.theta_is_physical:
            return self._made_consistent(fit, s)
        bounds = effect.bounds_near(self.experiment.signals, joint, s.candidate.theta)
        if not bounds:
            return s

        def loss(theta: Array) -> float:
            candidate = replace(s.candidate, theta=tuple(float(v) for v in theta))
            self._ensure(candidate)
            gain = self._plausible_gain(fit, candidate)
            if candidate.key != s.candidate.key and candidate.key not in self.keys():
                self.design.drop(candidate.key)
            return -gain if gain is not None else 0.0

        if len(bounds) == 1:
            low, high = bounds[0]
            found = optimize.minimize_scalar(lambda v: loss(np.array([v])), bounds=(low, high), method="bounded",
                                             options={"maxiter": 14, "xatol": 1e-3 * (high - low)})
            theta = np.array([float(found.x)])
        else:
            found = optimize.minimize(loss, np.array(s.candidate.theta), method="Nelder-Mead", bounds=bounds,
                                      options={"maxfev": 40, "xatol": 1e-3, "fatol": 1e-2})
            theta = np.asarray(found.x)
        better = replace(s.candidate, theta=tuple(float(v) for v in theta))
        if self._plausible_gain(fit, better) is None:
            return s
        tried = self._tried(fit, better)
        return tried if tried.trial.total > s.trial.total else s

    def _made_consistent(self, fit: Fit, s: Scored) -> Scored:
        """Theta that agrees with the coefficients, by fixed-point iteration."""
        for _ in range(_ITERATIONS):
            theta = s.candidate.effect.consistent_theta(s.trial.coefficients, s.candidate.theta)
            if np.allclose(theta, s.candidate.theta, rtol=0.01):
                break
            better = replace(s.candidate, theta=theta)
            if self._plausible_gain(fit, better) is None:
                break
            s = self._tried(fit, better)
        return s

    # -- many candidates -----------------------------------------------------------------------------------------------

    def _score(self, fit: Fit, residual: Array, pool: list[list[Candidate]]) -> list[Scored]:
        """The best start of every effect at every joint, with its held-out trial."""
        scored = []
        taken = {(c.candidate.effect.name, c.candidate.joint) for c in self.choices if c.candidate.key in fit.keys}
        for starts in pool:
            first = starts[0]
            if (first.effect.name, first.joint) in taken and not first.effect.scanned:
                continue
            if first.effect.scanned:
                found, tries = first.effect.starts_from_residual(self.at_rows, first.joint, residual, self.data.use)
                starts = [replace(first, theta=theta, tries=tries) for theta in found]
            best: tuple[float, Candidate] | None = None
            for candidate in starts:
                gain = self._plausible_gain(fit, candidate)
                if gain is not None and (best is None or gain > best[0]):
                    best = gain, candidate
            if best is not None and best[0] > 4.0:
                scored.append(self._tried(fit, best[1]))
        return scored

    def _discovered(self, scored: list[Scored]) -> list[Scored]:
        """Benjamini–Hochberg over all joints × effects of the round."""
        ordered = sorted(scored, key=lambda s: s.p_value)
        tests = max(len(self.pool), 1)
        last = 0
        for rank, s in enumerate(ordered, start=1):
            if s.p_value <= self.options.false_discovery * rank / tests:
                last = rank
        return ordered[:last]

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
