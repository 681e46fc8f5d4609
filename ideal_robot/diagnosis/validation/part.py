"""One domain of a diagnosis: what was selected in it, and its errors before and after on held-out data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm import ToolExperiment
from ideal_robot.diagnosis.channels.motor_torque import Experiment
from ideal_robot.diagnosis.search.candidates import Candidate
from ideal_robot.diagnosis.search.choice import Choice
from ideal_robot.diagnosis.search.evidence import ranked_structure, would_tell
from ideal_robot.diagnosis.statistics.cross_products import Data
from ideal_robot.diagnosis.statistics.estimate import Estimate, estimate, fitted_effect
from ideal_robot.diagnosis.validation.result import ChannelResult, FoundEffect, Structure, Traces
from ideal_robot.diagnosis.validation.transfer import deciding
from ideal_robot.effects import SENSOR


@dataclass(frozen=True)
class PartResult:
    """What one domain adds to the diagnosis."""

    channels: tuple[ChannelResult, ...]
    found: tuple[FoundEffect, ...]
    before: tuple[Structure, ...]
    remaining: tuple[Structure, ...]
    traces: tuple[tuple[str, ...], Traces]


@dataclass(frozen=True)
class Part:
    """A domain after its search.

    Attributes:
        raw, data: the regression that was searched.
        choices: what was selected.
        prior: precision of the model's parameters, or None.
        final: the fit to all of the recording.
        seen: the regression of the validation recording, or None.
        given: whether the model was given, so that "before" is the model as it was.
        source: hash of the recording.
    """

    raw: Experiment
    data: Data
    choices: list[Choice]
    prior: Array | None
    final: Estimate
    seen: Experiment | None
    given: bool
    source: str

    @property
    def held_out(self) -> np.ndarray:
        """Samples on which errors are reported."""
        if self.seen is not None:
            return ~deciding(self.seen)
        return self.data.blocks.fold[self.data.blocks.of_samples()] < 0

    @property
    def held_out_seconds(self) -> float:
        """How much time they are."""
        seen = self.seen or self.raw
        return float(self.held_out.sum() * (seen.t[1] - seen.t[0]))

    def result(self, rng: np.random.Generator) -> PartResult:
        """Errors of each step, effects with their numbers, and what the residual depends on."""
        chosen = [c.candidate for c in self.choices]
        steps = [estimate(self.raw, self.data, chosen[:k], self.prior, spread=False) for k in range(len(chosen) + 1)]
        seen, where = self.seen or self.raw, self.held_out
        residuals = [predicted(seen, s, chosen[:k]) for k, s in enumerate(steps)]
        before = seen.y if self.given else residuals[0]
        levels = [rms(r, seen.use, where) for r in residuals]
        start, signal = rms(before, seen.use, where), rms(seen.measured, seen.use, where)
        channels = tuple(ChannelResult(name, unit, float(start[j]), float(levels[0][j]), float(levels[-1][j]),
                                       float(seen.quiet[j]), float(signal[j]))
                         for j, (name, unit) in enumerate(zip(seen.channels, seen.units, strict=True)))
        # An effect that could as well be a change of the model's parameters is measured against the model as it was.
        if self.given:
            levels[0] = start
        found = tuple(self._found(k, choice, levels, seen) for k, choice in enumerate(self.choices))
        # Dependences are looked for in the recording itself, where the fit is at home.
        own = predicted(self.raw, steps[-1], chosen)
        first = self.raw.y if self.given else predicted(self.raw, steps[0], [])
        return PartResult(channels, found, ranked_structure(self.raw, self.data, first, rng),
                          ranked_structure(self.raw, self.data, own, rng),
                          _traces(seen, before, residuals[-1], where, chosen, steps[-1]))

    def _found(self, k: int, choice: Choice, levels: Sequence[Array], seen: Experiment) -> FoundEffect:
        candidate = choice.candidate
        gains = (levels[k] - levels[k + 1]) / (levels[k] + 1e-300)
        j = seen.channel_of(candidate.joint)
        if j is None and seen.domain == SENSOR:
            # Not where it helps most by chance, but where it says most against the noise.
            columns = candidate.effect.columns(seen.signals, candidate.joint, candidate.theta)
            added = seen.decimate(columns @ self.final.coefficients[k])
            j = int(np.argmax(np.sqrt(np.mean(added**2, axis=0)) / (seen.quiet + 1e-300)))
        j = int(np.argmax(gains)) if j is None else j
        rivals = tuple(dict.fromkeys(name for name, _, _ in choice.rivals if name != candidate.effect.name))
        transfers = None if self.seen is None else bool(levels[k + 1][j] < levels[k][j])
        before, after = float(levels[k][j]), float(levels[k + 1][j])
        evidence = {"p_value": choice.p_value, "rms_before": before, "rms_after": after,
                    "indistinguishable_from": list(rivals), "transfers": transfers, "recording": self.source}
        fitted = fitted_effect(candidate, self.final.coefficients[k], self.final.std[k], self.final.theta_std[k],
                               _slides(seen, candidate, j), evidence)
        names = tuple(choice.dependence.names) if choice.dependence is not None else ()
        return FoundEffect(fitted, before, after, choice.p_value, rivals, would_tell(candidate.effect.name, rivals),
                           transfers, names)


def _slides(seen: Experiment, candidate: Candidate, j: int) -> bool:
    """Whether an effect's parameters are those of a sliding joint."""
    if not candidate.effect.depends_on_joint:
        return False
    return seen.prismatic[candidate.joint - 1] if isinstance(seen, ToolExperiment) else seen.units[j] in ("N", "m")


def predicted(seen: Experiment, found: Estimate, chosen: list[Candidate]) -> Array:
    """Residual ``(N, c)`` of an experiment with the numbers of an estimate."""
    r = seen.y - seen.W @ found.change
    for candidate, coefficients in zip(chosen, found.coefficients, strict=True):
        r = r - seen.decimate(candidate.effect.columns(seen.signals, candidate.joint, candidate.theta) @ coefficients)
    return np.asarray(r)


def rms(values: Array, use: np.ndarray, where: np.ndarray) -> Array:
    """Root mean square per channel ``(c,)`` over the samples that count."""
    mask = use & where[:, None]
    return np.asarray(np.sqrt((values**2 * mask).sum(axis=0) / np.maximum(mask.sum(axis=0), 1)))


def _traces(seen: Experiment, before: Array, after: Array, where: np.ndarray, chosen: list[Candidate],
            last: Estimate) -> tuple[tuple[str, ...], Traces]:
    at = seen.decimated_signals()
    added = tuple(seen.decimate(c.effect.columns(seen.signals, c.joint, c.theta) @ own)
                  for c, own in zip(chosen, last.coefficients, strict=True))
    return seen.channels, Traces(seen.t, seen.measured, before, after, seen.use, where, at.q, at.qd, added)
