"""One domain of a diagnosis: what was selected, errors before and after on held-out data, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.regression import Regression, noise_left, rms, spread
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms
from ideal_robot.diagnosis.statistics.least_squares import CLEAR, TOLD
from ideal_robot.diagnosis.statistics.problem import Candidate, Estimate, Problem
from ideal_robot.diagnosis.validation.result import ChannelResult, FoundEffect, NotTransferred, Structure, Traces
from ideal_robot.diagnosis.validation.transfer import deciding
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, TCP_POSITION, EffectParameter, FittedEffect, Signals, library
from ideal_robot.effects.base import REACH
from ideal_robot.effects.fitted import Unknown


def discriminating_motion(name: str, rivals: tuple[str, ...]) -> str:
    """The motion that would tell an effect from its rivals; empty where there are none."""
    motions = {frozenset({effect.name, other}): motion for effect in library()
               for other, motion in effect.discriminating_motion}
    advice = [motions.get(frozenset({name, rival}), f"a motion with other speeds, ranges and loads ({name} or {rival})")
              for rival in rivals]
    return "; ".join(dict.fromkeys(advice))


def _ranked_structure(problem: Problem, residuals: Sequence[Array]) -> list[tuple[Structure, ...]]:
    """For each residual ``(N, c)`` the three strongest dependences of each channel that are not as by chance."""
    regression, use = problem.regression, problem.products.use
    signals = regression.decimated_signals()
    dependence = DependenceTest(signals, use, problem.blocks)
    curves = [terms(signals, j, False, regression.domain) for j in range(use.shape[1])]
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


def with_limits(fitted: FittedEffect, candidate: Candidate, signals: Signals) -> FittedEffect:
    """The effect with limits, and no standard deviation, for parameters whose theta stands at its bound.

    Args:
        fitted, candidate: its numbers, and the theta that they were found with.
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
                # What lies beyond the bound lies on the other side than what lies within.
                parameters[k] = EffectParameter(own.name, own.value, 0.0, own.unit, "≤" if step > 0.0 else "≥")
    return replace(fitted, parameters=tuple(parameters))


def sides(candidate: Candidate, signals: Signals) -> list[int]:
    """For each theta -1 where it stands at the lower end of what was searched, 1 at the upper, 0 between."""
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
    # Zero below a positive bound is no small value but another form of the effect.
    if value == 0.0 and low > 0.0:
        return 0
    below, above = (0.01 * min(high - low, abs(bound) or high - low) for bound in (low, high))
    return -1 if value <= low + below else 1 if value >= high - above else 0


def with_misfit(problem: Problem, found: Estimate) -> Estimate:
    """An estimate whose standard deviations hold the misfit, and what the numbers differ by in half of the band.

    Vibrations, filters and the way friction goes through standstill bend numbers in the same way in every block of
    time, so no scatter over blocks shows it; but they fade towards slow motion, and so does what they do to a number.
    A law of speed errs by no more than it errs in the lower half and differs from there: where vibrations are most of
    what is left, that is far less than all that is left could bend it by.

    Args:
        problem: of the fit.
        found: the fit to all blocks, with uncertainty.
    """
    if not (effects := found.effects):
        return found
    whole = problem.on_all_blocks()
    wide = whole.fit(effects, uncertainty=True, misfit=True)
    slow = whole.slow().fit(effects, uncertainty=True, misfit=True)
    std, theta_std = [], []
    for k, candidate in enumerate(effects):
        errs, drifts = (np.minimum(whole[k], half[k]) if candidate.effect.of_slow_motion else whole[k]
                        for whole, half in ((wide.std, slow.std), (wide.theta_std, slow.theta_std)))
        std.append(np.hypot(errs, slow.coefficients[k] - found.coefficients[k]))
        theta_std.append(np.where(drifts > 0.0, np.hypot(drifts, slow.theta_step[k] - wide.theta_step[k]), drifts))
    return replace(found, std=tuple(std), theta_std=tuple(theta_std))


_HALF = 0.5
"""Share of the held-out squares from which on coefficients that are loose each are certain together, and those of a
body tell it without its mass. Of the share that was asked of an effect where it was found, what is asked of it on
held-out data: against a given model, where what needs other parameters than the model's own to show is a change of
these, and in a torque of the same recording, in blocks that nobody looked at."""

# A single coefficient has to differ from none by ``TOLD`` reported standard deviations: what may as well be nothing is
# not claimed. Several coefficients, or one and its theta, may each be loose and all of them together certain; but
# not where none of several differs by one and the error hardly falls, for they cancel, nor where theta may be twice
# itself or nothing as well.


@dataclass(frozen=True)
class DomainResult:
    """What one domain adds to the diagnosis."""

    channels: tuple[ChannelResult, ...]
    found: tuple[FoundEffect, ...]
    before: tuple[Structure, ...]
    remaining: tuple[Structure, ...]
    traces: tuple[tuple[str, ...], Traces]


@dataclass(frozen=True)
class DomainDiagnosis:
    """A domain after its search.

    Attributes:
        problem: that was searched.
        final: the fit of what was selected to all of the recording, with uncertainty.
        validation: the regression of the validation recording, or None.
        given: whether the model was given, so that "before" is the model as it was.
        source: hash of the recording.
    """

    problem: Problem
    final: Estimate
    validation: Regression | None
    given: bool
    source: str

    @property
    def choices(self) -> tuple[Candidate, ...]:
        """What was selected."""
        return self.final.effects

    @property
    def reported(self) -> Regression:
        """The regression whose errors are reported."""
        return self.validation or self.problem.regression

    @property
    def held_out(self) -> np.ndarray:
        """Samples on which errors are reported ``(N,)``."""
        if self.validation is not None:
            return ~deciding(self.validation)
        return np.asarray(~self.problem.blocks.selecting_samples)

    @property
    def held_out_seconds(self) -> float:
        """How much time they are."""
        return float(self.held_out.sum() * self.reported.step)

    def settled(self) -> tuple[DomainDiagnosis, tuple[NotTransferred, ...]]:
        """The same without effects that do not hold in the end, one after another, and what was dropped.

        An effect whose coefficients in the fit of everything together are not what physics allows, or with which the
        error on the held-out data does not fall by half of what was asked at least, is not missing.
        """
        domain, dropped = self, list[NotTransferred]()
        while domain.choices and (failure := domain._unsound() or domain._worthless()):
            k, gone = failure
            choices = [choice for i, choice in enumerate(domain.choices) if i != k]
            final = domain.problem.on_all_blocks().fit(choices, uncertainty=True)
            domain = replace(domain, final=final)
            dropped.append(gone)
        return domain, tuple(dropped)

    def _unsound(self) -> tuple[int, NotTransferred] | None:
        """The last effect that in the final fit is not plausible, as good as none, or only near standstill."""
        signals = self.problem.regression.signals
        for k in reversed(range(len(self.choices))):
            candidate, own = self.choices[k], self.final.coefficients[k]
            why = ""
            if np.any(own) and not candidate.effect.plausible(own, candidate.theta, signals, candidate.joint):
                why = "it has a sign or a size that physics does not allow"
            elif candidate.effect.at_standstill(sides(candidate, signals)):
                # A friction law whose bend lies below a hundredth or so of the speeds that were driven follows contact,
                # filters and controller there, which differ from drive to drive.
                why = "it is how friction goes through standstill, at the end of what was searched"
            elif not (candidate.effect.learned or self._differs(k)):
                why = "it is not distinguished from none"
            if why:
                numbers = self._widened.fitted(k, self.reported.prismatic).parameters
                text = ", ".join(p.text for p in numbers)
                return k, self._not_added(k, f"in the fit of everything together {why} ({text})")
        return None

    def _differs(self, k: int) -> bool:
        """Whether an effect differs from none by its uncertainty, the misfit in it."""
        candidate, own, wide = self.choices[k], self.final.coefficients[k], self._widened.std[k]
        effect, signals = candidate.effect, self.problem.regression.signals
        if len(own) == 1 and not effect.absorbed_by_base:
            # A theta that is known no better than to its own size makes nothing certain; one that only serves the
            # computation is no number at all. Where another recording decides, that is the evidence.
            searched = effect.theta_is_physical and bool(effect.bounds(signals, candidate.joint))
            known = searched and not np.all(self._widened.theta_std[k] > np.abs(candidate.theta))
            # Shares are of squares: what has to take away more of them has to be as much clearer.
            least = TOLD * np.sqrt(effect.caution if signals.n > 1 else 1.0)
            return (searched and self.validation is not None) or effect.certain(np.abs(own) > least * wide, own, known)
        least, sigma = TOLD, wide
        if effect.absorbed_by_base:
            # What the model's own recording told is in the prior; only what bends parameters counts once for each.
            least, sigma = CLEAR, np.sqrt(wide**2 + np.maximum(wide**2 - self.final.std[k] ** 2, 0.0))
        large = np.abs(own) > least * sigma
        return effect.certain(large, own, False) or (
            effect.certain(large, own, True) and self._shares()[k] > _HALF)

    def _worthless(self) -> tuple[int, NotTransferred] | None:
        """The effect that falls shortest of what it has to take away from the held-out error of its channel, if any."""
        shares = self._shares()
        short = [share - self._asked_in_the_end(choice) for share, choice in zip(shares, self.choices, strict=True)]
        k = int(np.argmin(short))
        if short[k] > 0.0:
            return None
        why = "" if shares[k] <= 0.0 else (
            f"of the squares that had no part in finding it, it takes away {100.0 * shares[k]:.0f} % and not "
            f"{100.0 * self._asked_in_the_end(self.choices[k]):.0f} %, half of what was asked where it was found")
        return k, self._not_added(k, why)

    def _shares(self) -> list[float]:
        """Share of the held-out squares of its channel that each effect takes away, those before it being there."""
        return [1.0 - float(after[j] / max(float(before[j]), 1e-300)) ** 2
                for k, (before, after) in enumerate(pairwise(self.levels)) for j in [self._channel(k)]]

    def _asked_in_the_end(self, choice: Candidate) -> float:
        """Share of the held-out squares that an effect has to take away.

        What is true of the torque of one recording takes away as much of it where nobody looked, but for what eight
        blocks scatter by; in another motion it may show less. What friction does not hide has only to take something.
        """
        alike = self.validation is None and self.reported.domain == MOTOR_TORQUE
        return _HALF * choice.asked if alike or self.problem.prior is not None else 0.0

    def _not_added(self, k: int, why: str) -> NotTransferred:
        choice, j = self.choices[k], self._channel(k)
        return NotTransferred(choice.effect.name, choice.joint, self.reported.channels[j], choice.p_value,
                              float(self.levels[k][j]), float(self.levels[k + 1][j]), why)

    @cached_property
    def levels(self) -> list[Array]:
        """Held-out errors of the reported regression ``(c,)`` with the first 0, 1, … effects.

        The parameters of a model that holds stay as they were: an effect that could as well be a change of them is
        measured against it, and what refitting alone explains is no merit of any effect.
        """
        problem, steps = self.problem.held(), [self.choices[:k] for k in range(len(self.choices) + 1)]
        return [self._rms(problem.fit(some).residual(self.reported)) for some in steps]

    @cached_property
    def _widened(self) -> Estimate:
        """The final fit with the misfit in its standard deviations."""
        return with_misfit(self.problem, self.final)

    def result(self) -> DomainResult:
        """Errors of each step, effects with their numbers, and what the residual depends on."""
        effects, own, reported = self.choices, self.problem.regression, self.reported
        first, last = self.problem.fit(), self.problem.fit(effects)
        refitted, residual = first.residual(reported), last.residual(reported)
        before, after = reported.y if self.given else refitted, self._rms(residual)
        # The floor belongs to the band of the residual, and is part of it.
        white, usual = noise_left(residual, reported.use)
        numbers = np.array([self._rms(before), self._rms(refitted), after,
                            np.minimum.reduce([reported.noise_floor, white, after]), self._rms(reported.measured),
                            own.use.mean(axis=0), spread(reported.measured, reported.use), usual]).T.tolist()
        judged = reported.domain != TCP_POSITION or not reported.absent
        channels = tuple(ChannelResult(name, unit, *values, judged=judged) for j, (name, unit, values) in
                         enumerate(zip(reported.channels, reported.units, numbers, strict=True))
                         if j not in reported.absent)
        # Dependences are looked for in the recording that the fit was made on.
        at_first = own.y if self.given else first.residual(own)
        before_it, after_it = _ranked_structure(self.problem, [at_first, last.residual(own)])
        s = reported.decimated_signals()
        traces = Traces(reported.t, reported.measured, before, residual, reported.use, self.held_out, s.q, s.qd,
                        tuple(last.contributions(reported)))
        return DomainResult(channels, tuple(map(self._found, range(len(effects)))), before_it, after_it,
                            (reported.channels, traces))

    def _rms(self, values: Array) -> Array:
        return rms(values, self.reported.use & self.held_out[:, None])

    def _found(self, k: int) -> FoundEffect:
        """What is said of a choice."""
        choice, effect, j = self.choices[k], self.choices[k].effect, self._channel(k)
        rivals = tuple(dict.fromkeys(name for name, _, _ in choice.rivals if name != effect.name))
        before, after = float(self.levels[k][j]), float(self.levels[k + 1][j])
        transfers = None if self.validation is None else after < before
        evidence = {"p_value": choice.p_value, "rms_before": before, "rms_after": after,
                    "indistinguishable_from": list(rivals), "transfers": transfers, "recording": self.source,
                    "share": choice.share, "share_asked": choice.asked}
        fitted = with_limits(self._widened.fitted(k, self.reported.prismatic, evidence=evidence), choice,
                             self.problem.regression.signals)
        names = tuple(effect.signals_of(choice.joint)) if isinstance(effect, Unknown) else ()
        return FoundEffect(fitted, before, after, choice.p_value, rivals, discriminating_motion(effect.name, rivals),
                           transfers, names, k)

    def _channel(self, k: int) -> int:
        """Index of the channel in which an effect is reported: its own, else where it reduces the error most."""
        reported = self.reported
        own = reported.channel_of(self.choices[k].joint)
        if own is not None:
            return own
        if reported.domain == SENSOR:
            # Not where it reduces most by chance, but where it is largest against the noise.
            added = self.final.contributions(reported)[k]
            return int(np.argmax(np.sqrt(np.mean(added**2, axis=0)) / (reported.noise_floor + 1e-300)))
        return int(np.argmax((self.levels[k] - self.levels[k + 1]) / (self.levels[k] + 1e-300)))
