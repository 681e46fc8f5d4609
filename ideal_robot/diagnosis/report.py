"""Results of one domain: errors before and after, each cause with its numbers, and why it was named.

Errors are of blocks of time that the fit did not see: each block is predicted by the fit to all others; of another
recording, by the fit to the first one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.best_set import BestSet
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.regression import Regression, noise_left, rms, spread
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms
from ideal_robot.diagnosis.statistics.problem import Estimate
from ideal_robot.diagnosis.validation.result import (
    LEAST_ODDS,
    Argument,
    ChannelResult,
    FoundEffect,
    Structure,
    Traces,
    WeighedSet,
    probability,
)
from ideal_robot.effects import SENSOR, TCP_POSITION, Effect, EffectParameter, FittedEffect, Signals, library
from ideal_robot.effects.base import REACH
from ideal_robot.effects.fitted import Unknown
from ideal_robot.estimate.noise import ColouredNoise
from ideal_robot.estimate.score import standard_error


@dataclass(frozen=True)
class DomainResult:
    """Results of one domain for the diagnosis.

    Attributes:
        channels: errors of each channel before and after.
        found: causes that are large enough to be reported.
        before, remaining: strongest dependences of the residual on signals, without causes and with the best set.
        traces: names of the channels, and their series for plots.
        arguments: why each reported cause is in the set.
        small: effects of the set that are fitted but too small to be reported.
        gone: causes that another recording contradicts, in words.
        perhaps: causes that cannot be distinguished from no cause, in words.
    """

    channels: tuple[ChannelResult, ...]
    found: tuple[FoundEffect, ...]
    before: tuple[Structure, ...]
    remaining: tuple[Structure, ...]
    traces: tuple[tuple[str, ...], Traces]
    arguments: tuple[Argument, ...]
    small: tuple[FittedEffect, ...] = ()
    gone: tuple[str, ...] = ()
    perhaps: tuple[str, ...] = ()


@dataclass(frozen=True)
class DomainDiagnosis:
    """A domain with its finished search.

    Attributes:
        best: the best set of causes, with the candidates.
        final: coefficients of that set, with their uncertainty.
        arguments: why each cause is in the set.
        named: indices, from 0, of the causes that are large enough to be reported.
        gone: causes that the validation recording contradicts.
        perhaps: causes that cannot be distinguished from no cause.
        validation: the regression of the validation recording, or None.
        given: whether the model was given; "before" then has its parameters, else parameters fitted to this recording.
        source: hash of the recording.
    """

    best: BestSet
    final: Estimate
    arguments: tuple[Argument, ...]
    named: tuple[int, ...]
    gone: tuple[Candidate, ...]
    perhaps: tuple[Candidate, ...]
    validation: Regression | None
    given: bool
    source: str

    @classmethod
    def of(cls, best: BestSet, validation: Regression | None, given: bool, source: str) -> DomainDiagnosis:
        """The domain of a finished search.

        Causes that another recording contradicts, or that are not distinguishable from none, are removed.

        Args:
            best: the search.
            validation: regression of another recording, whose errors are then reported; None for held-out blocks.
            given: whether the model was given.
            source: hash of the recording.
        """
        gone, perhaps = _not_transferred(best, validation), _not_told_from_nothing(best)
        arguments = tuple(argument(best, choice) for choice in best.choices)
        named = tuple(k for k, choice in enumerate(best.choices) if best.matters(choice))
        return cls(best, best.estimate(), arguments, named, gone, perhaps, validation, given, source)

    @property
    def choices(self) -> tuple[Candidate, ...]:
        """Causes of the best set."""
        return self.final.effects

    @property
    def regression(self) -> Regression:
        """The regression in which causes were searched."""
        return self.best.regression

    @property
    def reported(self) -> Regression:
        """The regression whose errors are reported."""
        return self.validation or self.regression

    @property
    def held_out_seconds(self) -> float:
        """Duration of the reported held-out data [s]."""
        return float(len(self.reported.t) * self.reported.step)

    def residual(self, choices: Sequence[Candidate]) -> Array:
        """Residual of a set on held-out data, at the reported rows ``(N, c)``."""
        if self.validation is None:
            return self.best.predicted_by_others(choices)
        return self.best.fit_of(choices).residual(self.validation)

    def _rms(self, values: Array) -> Array:
        return rms(values, self.reported.use)

    @cached_property
    def without_any(self) -> Array:
        """Residual of the model with its parameters fitted to this recording ``(N, c)``."""
        return self.residual(())

    @cached_property
    def with_all(self) -> Array:
        """Residual of the best set ``(N, c)``."""
        return self.residual(self.choices)

    def result(self) -> DomainResult:
        """Errors of each channel, reported causes with their numbers, and dependences of the residual on signals."""
        reported = self.reported
        before, after = reported.y * reported.use if self.given else self.without_any, self._rms(self.with_all)
        # The noise floor is that of the residual's band, and a part of the residual.
        white, usual = noise_left(self.with_all, reported.use)
        numbers = np.array([self._rms(before), self._rms(self.without_any), after,
                            np.minimum.reduce([reported.noise_floor, white, after]), self._rms(reported.measured),
                            self.regression.use.mean(axis=0), spread(reported.measured, reported.use),
                            usual]).T.tolist()
        judged = reported.domain != TCP_POSITION or not reported.absent
        channels = tuple(ChannelResult(name, unit, *values, judged=judged) for j, (name, unit, values) in
                         enumerate(zip(reported.channels, reported.units, numbers, strict=True))
                         if j not in reported.absent)
        own = self.regression
        at_first = own.y if self.given else self.best.fit_of(()).residual(own)
        before_it, after_it = _ranked_structure(self.best, [at_first, self.best.fit_of(self.choices).residual(own)])
        s = reported.decimated_signals()
        last = self.best.fit_of(self.choices)
        traces = Traces(reported.t, reported.measured, before, self.with_all, reported.use,
                        np.ones(len(reported.t), dtype=bool), s.q, s.qd, tuple(last.contributions(reported)))
        return DomainResult(channels, tuple(map(self._found, self.named)), before_it, after_it,
                            (reported.channels, traces), tuple(self.arguments[k] for k in self.named),
                            tuple(self.final.fitted(k, reported.prismatic) for k, choice in enumerate(self.choices)
                                  if k not in self.named and not choice.effect.learned),
                            *(tuple(f"{_name(c.effect)} in {c.effect.channel(c.joint)}" for c in left)
                              for left in (self.gone, self.perhaps)))

    def _found(self, k: int) -> FoundEffect:
        """The report of a cause of the best set."""
        choice, effect, why = self.choices[k], self.choices[k].effect, self.arguments[k]
        without = self._rms(self.residual([c for c in self.choices if c is not choice]))
        j = self._channel(k, without)
        before, after = float(without[j]), float(self._rms(self.with_all)[j])
        transfers = None if self.validation is None else after < before
        rivals = why.not_distinguished
        evidence = {"nats": why.nats, "nats_std": why.std, "probability": why.probability, "rms_before": before,
                    "rms_after": after, "indistinguishable_from": list(rivals), "transfers": transfers,
                    "recording": self.source}
        fitted = with_limits(self.final.fitted(k, self.reported.prismatic, evidence=evidence), choice,
                             self.regression.signals)
        names = tuple(effect.signals_of(choice.joint)) if isinstance(effect, Unknown) else ()
        return FoundEffect(fitted, before, after, why.nats, why.std, why.probability, rivals,
                           discriminating_motion(effect.name, rivals), transfers, names, k)

    def _channel(self, k: int, without: Array) -> int:
        """Index of the channel in which an effect is reported: its own, else where it reduces the error most."""
        reported = self.reported
        own = reported.channel_of(self.choices[k].joint)
        if own is not None:
            return own
        if reported.domain == SENSOR:
            # The channel in which it is largest relative to the noise, not the one with the largest reduction by
            # chance.
            added = self.final.contributions(reported)[k]
            return int(np.argmax(np.sqrt(np.mean(added**2, axis=0)) / (reported.noise_floor + 1e-300)))
        return int(np.argmax((without - self._rms(self.with_all)) / (without + 1e-300)))


def _without_needless(best: BestSet, gains: Callable[[list[list[Candidate]]], Sequence[float]],
                      least: float) -> tuple[Candidate, ...]:
    """Takes causes out of the best set, one after the other, as long as one gains less than ``least``; returns them.

    Args:
        best: the search.
        gains: by how much the set is better than each of the sets without one of its causes.
        least: gain that every cause should have [nats].
    """
    gone: list[Candidate] = []
    while best.choices and (choice := best.taken_out(gains, least)) is not None:
        gone.append(choice)
    return tuple(gone)


def _not_transferred(best: BestSet, validation: Regression | None) -> tuple[Candidate, ...]:
    """Takes causes out of the best set with which another recording is predicted worse; returns them.

    First those without which the whole recording, or their own channel, is predicted better. Then, as long as the model
    alone clearly predicts any channel better than the set does, the cause without which that channel gains most.
    """
    if validation is None:
        return ()

    def gains(rests: list[list[Candidate]]) -> list[float]:
        by_channel = _densities(best, validation, rests).sum(axis=1)
        own = [best.regression.channel_of(choice.joint) for choice in best.choices]
        return [float(gain.sum() if j is None else min(gain.sum(), gain[j]))
                for gain, j in zip(by_channel, own, strict=True)]

    gone = _without_needless(best, gains, 0.0)
    while best.choices and (worse := _predicted_worse(best, validation)) is not None:
        # Removed is the cause without which this channel is predicted best.
        choice = best.taken_out(partial(_in_channel, best, validation, worse), np.inf)
        gone += () if choice is None else (choice,)
    return gone


def _predicted_worse(best: BestSet, validation: Regression) -> int | None:
    """The channel (from 0) of another recording that the model alone predicts most clearly better than the best set.

    None where no channel has the odds that a cause needs, ``LEAST_ODDS``.
    """
    odds = [WeighedSet("", 0, -float(gain.sum()), standard_error(gain)).moderated
            for gain in _densities(best, validation, [[]])[0].T]
    worst = int(np.argmax(odds))
    return worst if odds[worst] > LEAST_ODDS else None


def _in_channel(best: BestSet, validation: Regression, j: int, sets: Sequence[Sequence[Candidate]]) -> list[float]:
    """Nats by which the best set predicts a channel (from 0) better than each of some sets; see ``_densities``."""
    nats: list[float] = _densities(best, validation, sets)[:, :, j].sum(axis=1).tolist()
    return nats


def _densities(best: BestSet, validation: Regression, sets: Sequence[Sequence[Candidate]]) -> Array:
    """Nats by which the best set predicts another recording better than each of some sets ``(S, B, c)``.

    By blocks of time and channels, in units of the noise that the model alone leaves there.

    Args:
        best, validation: the search, and the recording's regression.
        sets: of causes.
    """
    use, cut = validation.use, validation.blocks().cut
    alone, whole = (best.fit_of(choices).residual(validation) for choices in ((), best.choices))
    noise = [ColouredNoise.fit(r, used) for r, used in zip(alone.T, use.T, strict=True)]
    level = np.array([max(each.variance[0] * max(each.colour, 1.0), 1e-300) for each in noise])
    own = cut(whole**2 * use / level).sum(axis=1)
    return np.array([0.5 * (cut(best.fit_of(other).residual(validation) ** 2 * use / level).sum(axis=1) - own)
                     for other in sets])


def _not_told_from_nothing(best: BestSet) -> tuple[Candidate, ...]:
    """Takes causes out of the best set whose odds against no cause are low for their standard error; returns them."""
    return _without_needless(best, lambda rests: [_weighed(best, rest)[0].moderated for rest in rests], LEAST_ODDS)


def _weighed(best: BestSet, instead: Sequence[Candidate], other: Candidate | None = None) -> tuple[WeighedSet, Array]:
    """A set in the place of the best one, and what each block of time, or pair of blocks, adds to the difference.

    Args:
        best: the search.
        instead: the set.
        other: the cause of it that stands in the place of one of the best set; None where nothing does.
    """
    # Ten blocks of time suffice for a standard error; the time of a cause uses all blocks.
    gain = best.better_by_block(best.choices, instead, 1 if other is None else 2)
    nats, std = best.better(best.choices, instead), standard_error(gain)
    return (WeighedSet("", 0, nats, std) if other is None else
            WeighedSet(_name(other.effect), other.joint, nats, std, other.effect.learned)), gain


# The argument why a cause is in the best set.

def argument(best: BestSet, own: Candidate) -> Argument:
    """Why a cause is in the best set: the score of the sets in which others, or none, take its place.

    Args:
        best: the search that has run.
        own: the cause, one of the best set.
    """
    rest = [c for c in best.choices if c is not own]
    others: list[Candidate | None] = [None]
    # A cause that appears in several channels may be at another joint.
    others += [w.candidate for w in best.ranked(own, anywhere=len(best.system.groups[own.key].channels) > 1)]
    if best.learns:
        channel = best.regression.channel_of(own.joint)
        others += [] if channel is None or own.effect.learned else best.curves_of(channel, [own])[:1]
    weighed = [_weighed(best, rest if other is None else [*rest, other], other) for other in others]
    whole = best.regression.domain.whole
    share, when = _when(best, own, weighed[0][1])
    ordered = sorted((each for each, _ in weighed), key=lambda s: s.nats)
    return Argument(own.effect.name, own.joint, own.effect.channel(own.joint),
                    f"joint {own.joint}" if own.joint else whole, tuple(ordered), when, share,
                    probability([s for s in ordered if not s.learned], own.effect.name))


def _when(best: BestSet, own: Candidate, gain: Array) -> tuple[float, str]:
    """The quarter of the recording in which most speaks for a cause: its share of all that does, and when it is."""
    gain, t = np.maximum(gain, 0.0), best.regression.t
    quarters = [float(part.sum()) for part in np.array_split(gain, 4)]
    total, k = sum(quarters) or 1.0, int(np.argmax(quarters))
    edges = np.linspace(float(t[0]), float(t[-1]), 5)
    return quarters[k] / total, f"from {edges[k]:.1f} to {edges[k + 1]:.1f} s"


def _name(effect: Effect) -> str:
    """Name of what stands in a place; of causes with several forms the form as well."""
    if isinstance(effect, Unknown):
        return f"a curve over {' and '.join(effect.depends_on)}"
    return effect.name


def discriminating_motion(name: str, rivals: tuple[str, ...]) -> str:
    """The motion that would distinguish an effect from its rivals; empty where there are none."""
    motions = {frozenset({effect.name, other}): motion for effect in library()
               for other, motion in effect.discriminating_motion}
    advice = dict.fromkeys(motions.get(frozenset({name, rival}), "") for rival in rivals)
    specific = [motion for motion in advice if motion]
    return "; ".join([*specific, *(["a motion with other speeds, ranges and loads"] if "" in advice else [])])


def _ranked_structure(best: BestSet, residuals: Sequence[Array]) -> list[tuple[Structure, ...]]:
    """The three strongest dependences of each channel beyond chance, for each residual ``(N, c)``."""
    regression, use = best.regression, best.regression.use
    dependence = DependenceTest(best.at_rows, use, best.problem.blocks)
    curves = [terms(best.at_rows, j, False, regression.domain) for j in range(use.shape[1])]
    result = []
    for residual in residuals:
        rows: list[Structure] = []
        for j in np.flatnonzero(use.any(axis=0)).tolist():
            tests = dependence.tests(residual[:, j], j, curves[j])
            limit = 0.01 / max(len(tests) * use.shape[1], 1)
            clear = [d for d in tests if d.p_value < limit and d.share - d.expected > 0.01]
            clear.sort(key=lambda d: d.expected - d.share)
            rows += [Structure(regression.channels[j], tuple(d.term.signals_of(j + 1)), d.share, d.expected, d.p_value)
                     for d in clear[:3]]
        result.append(tuple(rows))
    return result


# Parameters at a bound of the search.

def with_limits(fitted: FittedEffect, candidate: Candidate, signals: Signals) -> FittedEffect:
    """The effect whose parameters are limits (≤ or ≥), without standard deviation, where theta is at a bound.

    Args:
        fitted, candidate: its numbers, and their theta.
        signals: of the recording.
    """
    theta, parameters = candidate.theta, list(fitted.parameters)
    for i, side in enumerate(sides(candidate, signals)):
        if not side:
            continue
        inward = (*theta[:i], theta[i] - 0.01 * side * (abs(theta[i]) or 1.0), *theta[i + 1 :])
        moved = candidate.effect.parameters(np.asarray(fitted.coefficients), np.asarray(fitted.std), inward,
                                            fitted.theta_std)
        for k, (own, shifted) in enumerate(zip(fitted.parameters, moved, strict=True)):
            step = shifted.value - own.value
            if abs(step) > 1e-9 * max(abs(own.value), 1e-300):
                # The value beyond the bound is on the other side from values within.
                parameters[k] = EffectParameter(own.name, own.value, 0.0, own.unit, "≤" if step > 0.0 else "≥")
    return replace(fitted, parameters=tuple(parameters))


def sides(candidate: Candidate, signals: Signals) -> list[int]:
    """Place of each theta in the searched range: -1 at its lower end, 1 at its upper end, 0 between."""
    effect, theta = candidate.effect, candidate.theta
    bounds = effect.bounds(signals, candidate.joint) if effect.theta_is_physical else []
    if len(bounds) != len(theta):
        return [0] * len(theta)
    if len(bounds) == 1 and not effect.scanned:
        starts = [start[0] for start in effect.starts(signals, candidate.joint) if start and start[0] > 0.0]
        if starts and bounds[0][0] >= 0.0:
            low, high = bounds[0]
            bounds = [(max(low, min(starts) / REACH), min(high, max(starts) * REACH))]
    return [_side(value, low, high) for value, (low, high) in zip(theta, bounds, strict=True)]


def _side(value: float, low: float, high: float) -> int:
    # Zero below a positive bound is not a small value but another form of the effect.
    if value == 0.0 and low > 0.0:
        return 0
    below, above = (0.01 * min(high - low, abs(bound) or high - low) for bound in (low, high))
    return -1 if value <= low + below else 1 if value >= high - above else 0
