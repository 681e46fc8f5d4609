"""The result of a diagnosis, as plain values; plots are made elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.estimate.score import CLEAR
from ideal_robot.model.model import Model
from ideal_robot.results import Summarised, over_time, plain

if TYPE_CHECKING:
    from ideal_robot.results import Figure


@dataclass(frozen=True)
class MovedParameter:
    """A parameter of the given model before and after this recording; ``sigmas``: the change over its spread."""

    name: str
    unit: str
    value: float
    refitted: float
    sigmas: float

    @property
    def text(self) -> str:
        """The change of the parameter in a few words."""
        return f"{self.name} from {self.value:.3g} to {self.refitted:.3g} {self.unit} ({self.sigmas:+.1f} σ)"


_MATTERS = 0.10
"""Error over the spread of a torque from which on that matters. Friction near standstill, vibrations and a rigid body
for an elastic one leave up to 6 % in closed loops of other engines in which nothing is undeclared."""


@dataclass(frozen=True)
class ChannelResult:
    """Error of one channel on held-out data.

    Attributes:
        channel, unit: e.g. ``tau_1``, ``N m``.
        rms_before: of the model as it was given or, without one, of the baseline identified from the same recording.
        rms_refit, rms_after: with the model's parameters fitted to this recording, and with the added effects.
        noise_floor: level of the measurement's own noise in the same band.
        rms_signal, spread: rms and standard deviation of the measurement; the latter may be unknown.
        counted: share of all samples that were used, 0 to 1: in motion, away from reversals, rests and ends.
        usual: usual change of the error from sample to sample, as noise.
        judged: whether all possible causes of its error were tried; the arm's geometry is not, where an axis of the
            tool's position is missing.
    """

    channel: str
    unit: str
    rms_before: float
    rms_refit: float
    rms_after: float
    noise_floor: float
    rms_signal: float
    counted: float = 1.0
    spread: float = float("nan")
    usual: float = 0.0
    judged: bool = field(default=True, kw_only=True)

    @property
    def times_noise(self) -> float:
        """Error over the noise of the measurement and its usual changes; NaN where no noise is known."""
        noise = max(self.noise_floor, self.usual)
        return self.rms_after / noise if noise > 0.0 else float("nan")

    @property
    def above_noise(self) -> bool:
        """Whether more of the error's power lies above the noise than in it."""
        return self.times_noise**2 > 2.0

    @property
    def loud(self) -> bool:
        """Whether the error is several times the noise of the measurement and its usual changes."""
        return self.noise_floor > 0.0 and self.times_noise > CLEAR

    @property
    def unexplained(self) -> bool:
        """Whether the error is loud and, for a torque, a relevant part of it."""
        whole = self.spread if np.isfinite(self.spread) else self.rms_signal
        return self.loud and self.judged and (not self.channel.startswith("tau") or self.rms_after > _MATTERS * whole)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, relative errors 100·‖y − ŷ‖/‖y‖ included."""
        scale = 100.0 / self.rms_signal if self.rms_signal > 0 else float("nan")
        return {"channel": self.channel, "unit": self.unit, "rms_before": self.rms_before, "rms_after": self.rms_after,
                "noise_floor": self.noise_floor, "rms_refit": self.rms_refit, "rms_signal": self.rms_signal,
                "samples_counted_percent": 100.0 * self.counted, "times_noise": self.times_noise,
                "relative_error_percent_before": scale * self.rms_before,
                "relative_error_percent_refit": scale * self.rms_refit,
                "relative_error_percent_after": scale * self.rms_after}


@dataclass(frozen=True)
class FoundEffect:
    """One cause of the best set.

    Attributes:
        fitted: with its numbers.
        rms_before, rms_after: of its channel on data that the fit did not see, without it and with it, all else being
            there.
        nats, nats_std: by which the best set is better than the one without it, and the standard error of that.
        probability: of it, against everything that was weighed in its place.
        indistinguishable_from, would_tell: effects that these data do not reject in its place, and a motion that would
            distinguish them.
        transfers: whether it also lowers the error on the validation recording; None without one.
        depends_on: for a learned term, the signals it is a curve of.
        taken: its place in the best set.
    """

    fitted: FittedEffect
    rms_before: float
    rms_after: float
    nats: float
    nats_std: float = 0.0
    probability: float = 1.0
    indistinguishable_from: tuple[str, ...] = ()
    would_tell: str = ""
    transfers: bool | None = None
    depends_on: tuple[str, ...] = ()
    taken: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"effect": self.fitted.name, "joint": self.fitted.joint, "channel": self.fitted.channel,
                "rms_before": self.rms_before, "rms_after": self.rms_after, "nats": self.nats,
                "nats_std": self.nats_std, "probability": self.probability,
                "parameters": [p.to_dict() for p in self.fitted.parameters],
                "indistinguishable_from": list(self.indistinguishable_from), "would_tell": self.would_tell,
                "transfers": self.transfers}


@dataclass(frozen=True)
class Structure:
    """A dependence of a channel's residual on signals: the explained share of squares, and that by chance."""

    channel: str
    depends_on: tuple[str, ...]
    share: float
    share_by_chance: float
    p_value: float


@dataclass(frozen=True)
class Traces:
    """Series for plots, all at the same times ``(N,)`` and channels ``(N, c)``."""

    t: Array
    measured: Array
    residual_before: Array
    residual_after: Array
    use: np.ndarray
    held_out: np.ndarray
    q: Array
    qd: Array
    added: tuple[Array, ...] = ()


NOT_REJECTED = 3.0
"""Nats up to which a set is not rejected beside the best: odds of twenty to one, as for taking a cause."""

LEAST_ODDS = float(np.log(3.0))
"""Logarithm of the odds, averaged over their standard error, below which a cause is not told from nothing: 3 to 1. Of
eight causes with less four were there on recordings of other engines, of 144 with more 131."""


@dataclass(frozen=True)
class WeighedSet:
    """One alternative to the best set: another cause, or none, in the place of one of its causes.

    Attributes:
        name, joint: name and joint of the other cause; no name for none.
        nats: by which the set is worse than the best one, priors and all.
        std: standard error of that, over blocks of time.
        learned: whether it is a curve without a physical cause.
    """

    name: str
    joint: int
    nats: float
    std: float
    learned: bool = False

    @property
    def moderated(self) -> float:
        """Its loss in score [nats], moderated by the standard error: MacKay's moderated output (1992)."""
        return float(self.nats / np.sqrt(1.0 + np.pi / 8.0 * self.std**2)) if np.isfinite(self.std) else 0.0

    @property
    def rejected(self) -> bool:
        """Whether the data reject it against the best set."""
        return self.moderated > NOT_REJECTED

    @property
    def words(self) -> str:
        """The other cause with its joint, in words."""
        return f"{self.name} of joint {self.joint}" if self.joint else self.name or "nothing"

    @property
    def amount(self) -> str:
        """The loss in score, rounded to its standard error."""
        digits = 0 if self.std >= 1.0 else 1
        return f"{abs(self.nats):.{digits}f} ± {self.std:.{digits}f} nats {'worse' if self.nats >= 0.0 else 'better'}"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"effect": self.name or None, "joint": self.joint, "nats_worse": self.nats, "std": self.std,
                "rejected": self.rejected}


def probability(sets: Sequence[WeighedSet], name: str) -> float:
    """Probability of a cause against the other sets; a set with the same name supports it.

    The odds are those of the score, averaged over its standard error.

    Args:
        sets: with something else, or nothing, in its place.
        name: of the cause.
    """
    nats = np.array([s.moderated for s in sets if s.name != name])
    return float(1.0 / (1.0 + np.exp(-np.clip(nats, -500.0, 500.0)).sum())) if nats.size else 1.0


@dataclass(frozen=True)
class Argument:
    """Why one cause is in the best set.

    Attributes:
        name, joint, channel: of the cause.
        place: its place in words.
        sets: every set that was weighed, the best first.
        when: the quarter of the time that holds most of the evidence for it.
        share: of the evidence in that quarter.
        probability: of the cause, against all of them.
    """

    name: str
    joint: int
    channel: str
    place: str
    sets: tuple[WeighedSet, ...]
    when: str
    share: float
    probability: float

    @property
    def nothing(self) -> WeighedSet:
        """The set without any cause in the argued place."""
        return next(s for s in self.sets if not s.name)

    @property
    def nats(self) -> float:
        """Score of the best set less that of the set with nothing in this place [nats]."""
        return self.nothing.nats

    @property
    def std(self) -> float:
        """Standard error of ``nats``."""
        return self.nothing.std

    @property
    def rivals(self) -> tuple[WeighedSet, ...]:
        """The sets with another cause in its place, the best first."""
        return tuple(weighed for weighed in self.sets if weighed.name)

    @property
    def not_distinguished(self) -> tuple[str, ...]:
        """Names of other causes that the data do not reject in its place, with the joint where it differs."""
        names = [s.name if s.joint == self.joint else s.words for s in self.rivals
                 if not (s.learned or s.rejected) and (s.name, s.joint) != (self.name, self.joint)]
        return tuple(dict.fromkeys(names))

    @property
    def text(self) -> str:
        """The argument in a few sentences."""
        parts = [f"{self.place}: {self.name} in {self.channel}, probability {self.probability:.3g}.",
                 f"With nothing in its place the score is {self.nothing.amount}; {100.0 * self.share:.0f} % of that "
                 f"lies {self.when}."]
        best = next((rival for rival in self.rivals if not rival.learned), None)
        if best is not None:
            what = best.words if best.joint != self.joint else best.name
            parts.append(f"With {what}, the next best cause, {best.amount}" +
                         ("." if best.rejected else ", which these data do not reject."))
        parts += [f"With {rival.name}, which has no cause, {rival.amount}." for rival in self.rivals if rival.learned]
        return f"{' '.join(parts)} Sets compared: {len(self.sets) + 1}."

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"effect": self.name, "joint": self.joint, "channel": self.channel, "text": self.text,
                "probability": self.probability, "sets": [weighed.to_dict() for weighed in self.sets],
                "when": self.when, "share": self.share}


@dataclass(frozen=True, repr=False)
class Diagnosis(Summarised):
    """The result of a diagnosis: causes, their contributions, and the residual.

    Attributes:
        verdict: ``effects``, ``none``, ``unknown`` where a relevant residual has no known cause, or ``undecided`` where
            the recording moves too little.
        channels: errors before and after.
        effects: effects of the library, the best set of them.
        unknown: learned terms.
        held_out: kind and duration of the held-out data.
        undecided: joints with too little motion, and why.
        before, remaining: dependences of the residual at the start and at the end, strongest first.
        warnings: for people.
        model: the extended model.
        traces: names of channels and their series for plots, of each domain.
        unused: columns that measure something but took no part, with the reason.
        taken_for: hypothesis about a given model's parameters: of the same arm, or of another of its type; empty
            without a model.
        moved: parameters of a given model that are others in this recording, the largest first.
        arguments: why each cause is in the best set.
    """

    verdict: str
    channels: tuple[ChannelResult, ...]
    effects: tuple[FoundEffect, ...]
    unknown: tuple[FoundEffect, ...]
    held_out_how: str
    held_out_seconds: float
    undecided: dict[int, str] = field(default_factory=dict)
    before: tuple[Structure, ...] = ()
    remaining: tuple[Structure, ...] = ()
    warnings: tuple[str, ...] = ()
    model: Model | None = None
    traces: tuple[tuple[tuple[str, ...], Traces], ...] = ()
    unused: dict[str, str] = field(default_factory=dict)
    taken_for: str = ""
    moved: tuple[MovedParameter, ...] = ()
    arguments: tuple[Argument, ...] = ()

    @property
    def unexplained(self) -> tuple[ChannelResult, ...]:
        """Channels with a relevant unexplained residual."""
        return tuple(c for c in self.channels if c.unexplained)

    def summary(self) -> list[tuple[str, str]]:
        """Causes, and errors before and after, as rows of label and value."""
        effects = [f"{effect.fitted.name} in {effect.fitted.channel}" for effect in self.effects]
        learned = [f"a dependence of {f.fitted.channel} on {' and '.join(f.depends_on)}" for f in self.unknown]
        named = ", ".join([*effects, *learned][:8]) or "nothing to add"
        errors = [f"{c.channel} {c.rms_before:.3g} → {c.rms_after:.3g} {c.unit}" for c in self.channels]
        return [("verdict", f"{self.verdict}: {named}"), ("error on held-out data", ", ".join(errors[:6]))]

    def plot(self) -> Figure:
        """Residual of each channel over time, before and after what was added.

        Raises:
            InputError: there is no residual, for no joint moves enough.
        """
        if not self.traces:
            raise InputError("no joint moves enough, so there is no residual to draw", field="diagnosis",
                             value=self.verdict)
        names, first = self.traces[0]
        units = {result.channel: result.unit for result in self.channels}
        panels = [(f"{name} [{units[name]}]", [("residual before", before), ("after", after)])
                  for name, before, after in zip(names, first.residual_before.T, first.residual_after.T, strict=True)]
        return over_time(first.t, panels, self.summary()[0][1])

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: the documented keys, and a few more."""
        return plain({
            "verdict": self.verdict,
            "channels": [c.to_dict() for c in self.channels],
            "effects": [e.to_dict() for e in self.effects],
            "unknown": [{"joint": u.fitted.joint, "depends_on": list(u.depends_on), "rms_before": u.rms_before,
                         "rms_after": u.rms_after, "channel": u.fitted.channel, "nats": u.nats,
                         "transfers": u.transfers} for u in self.unknown],
            "held_out": {"how": self.held_out_how, "seconds": self.held_out_seconds},
            "undecided": [{"joint": joint, "reason": reason} for joint, reason in sorted(self.undecided.items())],
            "residual_before": self.before, "residual_after": self.remaining,
            "warnings": list(self.warnings),
            "unused": [{"columns": names, "reason": reason} for names, reason in self.unused.items()],
            "explained": [a.to_dict() for a in self.arguments],
            "parameters_taken_for": self.taken_for, "moved_parameters": list(self.moved),
            "unexplained": [c.channel for c in self.unexplained],
            "above_noise": [c.channel for c in self.channels if c.above_noise],
        })
