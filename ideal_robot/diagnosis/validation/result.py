"""What a diagnosis found, as plain values; plots are made elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.statistics.least_squares import CLEAR, TOLD
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.results import Summarised, over_time, plain

if TYPE_CHECKING:
    from ideal_robot.results import Figure


@dataclass(frozen=True)
class MovedParameter:
    """A parameter of the given model before and after refitting; ``sigmas``: the change over the former's deviation."""

    name: str
    unit: str
    value: float
    refitted: float
    sigmas: float


@dataclass(frozen=True)
class RefitExplains:
    """A joint whose error falls by refitting the given model alone.

    Attributes:
        joint, channel: from 1, and its torque.
        rms_before, rms_refit: held-out error of the model as given, and refitted.
        moved, would_tell: the parameters that moved far and count most for it, and what motion would decide.
    """

    joint: int
    channel: str
    rms_before: float
    rms_refit: float
    moved: tuple[MovedParameter, ...]
    would_tell: str

    @property
    def text(self) -> str:
        """In a sentence."""
        moved = ", ".join(f"{p.name} from {p.value:.3g} to {p.refitted:.3g} {p.unit} ({p.sigmas:+.0f} σ)"
                          for p in self.moved) or "none of them far"
        return (f"the error of {self.channel} falls from {self.rms_before:.3g} to {self.rms_refit:.3g} by refitting "
                f"the given model alone (moved: {moved}). Whether the arm has changed or a cause is missing, this "
                f"recording does not tell; a motion would in which {self.would_tell}")


_MATTERS = 0.10
"""Error over the spread of a torque from which on that matters. Friction near standstill, vibrations and a rigid body
for an elastic one leave up to 6 % in closed loops of other engines in which nothing is undeclared."""


@dataclass(frozen=True)
class ChannelResult:
    """Error of one channel on held-out data.

    Attributes:
        channel, unit: e.g. ``tau_1``, ``N m``.
        rms_before: of the model as it was given or, without one, of the baseline identified from the same recording.
        rms_refit, rms_after: with its parameters fitted to this recording, and with what was added.
        noise_floor: level of the measurement's own noise in the same band.
        rms_signal, spread: rms and standard deviation of what was measured; the latter is not known everywhere.
        counted: share of all samples that counted, 0 to 1: in motion, apart from reversals, rests and ends.
        usual: what changes from sample to sample of the error all the time, as noise.
        judged: whether all that may cause its error was looked at; not the arm's geometry where an axis of the tool's
            place is missing.
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
        """Error over the noise of the measurement, and of what else is never still; NaN where no noise is known."""
        noise = max(self.noise_floor, self.usual)
        return self.rms_after / noise if noise > 0.0 else float("nan")

    @property
    def above_noise(self) -> bool:
        """Whether more of the error's power lies above the noise than in it."""
        return self.times_noise**2 > 2.0

    @property
    def loud(self) -> bool:
        """Whether the error is still several times the noise of the measurement, and of what else is never still."""
        return self.noise_floor > 0.0 and self.times_noise > CLEAR

    @property
    def unexplained(self) -> bool:
        """Whether it is loud and, of a torque, a part of it that matters."""
        whole = self.spread if np.isfinite(self.spread) else self.rms_signal
        return self.loud and self.judged and (not self.channel.startswith("tau") or self.rms_after > _MATTERS * whole)

    def to_dict(self) -> dict[str, Any]:
        """For JSON, relative errors 100·‖y − ŷ‖/‖y‖ included."""
        scale = 100.0 / self.rms_signal if self.rms_signal > 0 else float("nan")
        return {"channel": self.channel, "unit": self.unit, "rms_before": self.rms_before, "rms_after": self.rms_after,
                "noise_floor": self.noise_floor, "rms_refit": self.rms_refit, "rms_signal": self.rms_signal,
                "samples_counted_percent": 100.0 * self.counted, "times_noise": self.times_noise,
                "relative_error_percent_before": scale * self.rms_before,
                "relative_error_percent_refit": scale * self.rms_refit,
                "relative_error_percent_after": scale * self.rms_after}


@dataclass(frozen=True)
class FoundEffect:
    """One effect, in the order in which it was taken.

    Attributes:
        fitted, p_value: with its numbers, and corrected for all values of theta that were tried.
        rms_before, rms_after: of its channel on held-out data without and with it, those before it being in the model.
        indistinguishable_from, would_tell: effects that these data cannot tell from it, and the motion that would.
        transfers: whether it also lowers the error on the validation recording; None without one.
        depends_on: for a learned term, the signals it is a curve of.
        taken: how many effects of its channels were taken before it, learned terms included.
    """

    fitted: FittedEffect
    rms_before: float
    rms_after: float
    p_value: float
    indistinguishable_from: tuple[str, ...] = ()
    would_tell: str = ""
    transfers: bool | None = None
    depends_on: tuple[str, ...] = ()
    taken: int = 0

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"effect": self.fitted.name, "joint": self.fitted.joint, "channel": self.fitted.channel,
                "rms_before": self.rms_before, "rms_after": self.rms_after, "p_value": self.p_value,
                "parameters": [p.to_dict() for p in self.fitted.parameters],
                "indistinguishable_from": list(self.indistinguishable_from), "would_tell": self.would_tell,
                "transfers": self.transfers}


@dataclass(frozen=True)
class NotTransferred:
    """An effect that was found but is not added, as data that had no part in finding it do not bear it out.

    Attributes:
        effect, joint, channel, p_value: as in ``FoundEffect``.
        rms_without, rms_with: of its channel on the data that decide.
        why: in words, where it is not these errors.
    """

    effect: str
    joint: int
    channel: str
    p_value: float
    rms_without: float
    rms_with: float
    why: str = ""

    @property
    def reason(self) -> str:
        """Why it was not added."""
        return self.why or (f"with it the error on data that had no part in finding it is {self.rms_with:.3g} instead "
                            f"of {self.rms_without:.3g}")

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"effect": self.effect, "joint": self.joint, "channel": self.channel, "p_value": self.p_value,
                "rms_without": self.rms_without, "rms_with": self.rms_with, "reason": self.reason}


@dataclass(frozen=True)
class Structure:
    """A dependence of a channel's residual on signals: the share of squares it explains, and what chance would."""

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


@dataclass(frozen=True)
class Weighed:
    """One set of causes: the named one with something else, or nothing, in the place of a cause.

    Attributes:
        name, joint: of what stands there; no name where nothing does.
        nats: by which the set is worse than the named one.
        std: standard error of that, over blocks of time.
        learned: whether it is a curve without a physical cause.
    """

    name: str
    joint: int
    nats: float
    std: float
    learned: bool = False

    @property
    def told(self) -> bool:
        """Whether the data tell it from the named one."""
        return abs(self.nats) > TOLD * self.std

    @property
    def words(self) -> str:
        """What stands there, with its joint."""
        return f"{self.name} of joint {self.joint}" if self.joint else self.name or "nothing"

    @property
    def amount(self) -> str:
        """The difference, to what its standard error allows."""
        digits = 0 if self.std >= 1.0 else 1
        return f"{abs(self.nats):.{digits}f} ± {self.std:.{digits}f} nats {'worse' if self.nats >= 0.0 else 'better'}"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"effect": self.name or None, "joint": self.joint, "nats_worse": self.nats, "std": self.std,
                "told_apart": self.told}


@dataclass(frozen=True)
class Argument:
    """Why one cause was named.

    Attributes:
        name, joint, channel: of the cause.
        place: where it sits, in words.
        sets: every set that was weighed, the best first.
        band: octaves that hold half of the difference to the next best one [Hz].
        when: in which quarter of the time most of that difference lies.
        share: of the difference in that quarter.
    """

    name: str
    joint: int
    channel: str
    place: str
    sets: tuple[Weighed, ...]
    band: tuple[float, float]
    when: str
    share: float

    @property
    def rivals(self) -> tuple[Weighed, ...]:
        """The sets with another cause in its place, the best first."""
        return tuple(weighed for weighed in self.sets if weighed.name)

    @property
    def text(self) -> str:
        """The argument in a few sentences."""
        parts = [f"{self.place}: {self.name} in {self.channel}."]
        best = next((rival for rival in self.rivals if not rival.learned), None)
        if best is not None:
            what = best.words if best.joint != self.joint else best.name
            low, high = self.band
            between = (f"above {low:g} Hz" if not np.isfinite(high) else
                       f"between {low:g} and {high:g} Hz" if low else f"below {high:g} Hz")
            where = (f"half of the difference lies {between}, {100.0 * min(self.share, 1.0):.0f} % of it in the "
                     f"quarter of the time {self.when}.")
            parts.append(
                f"Not told from {what}, {best.amount}." if not best.told else
                f"Next best is {what}, {best.amount}: {where}" if best.nats > 0.0 else
                f"With {what} it is {best.amount}: {where} Where both explain nearly the same, the likelier cause or "
                "the one with fewer parameters is named.")
        parts += [f"With {rival.name}, which has no cause, {rival.amount}." for rival in self.rivals if rival.learned]
        parts += [f"With nothing in its place {weighed.amount}." for weighed in self.sets if not weighed.name]
        return f"{' '.join(parts)} Sets weighed: {len(self.sets) + 1}."

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        low, high = self.band
        return {"effect": self.name, "joint": self.joint, "channel": self.channel, "text": self.text,
                "sets": [weighed.to_dict() for weighed in self.sets],
                "next_best_decided": {"from_hz": low, "to_hz": high if np.isfinite(high) else None, "when": self.when,
                                      "share": self.share}}


@dataclass(frozen=True, repr=False)
class Diagnosis(Summarised):
    """The whole answer.

    Attributes:
        verdict: ``effects``, ``none``, ``unknown`` where something remains that matters and has no name, or
            ``undecided`` where the recording moves too little.
        channels: errors before and after.
        effects: effects of the library, in the order in which they were taken.
        unknown: learned terms.
        held_out: how the reported data were kept apart, and how many seconds they are.
        undecided: joints that move too little, with the reason.
        before, remaining: dependences of the residual at the start and of what is left, strongest first.
        warnings: for people.
        model: the extended model.
        traces: names of channels and their series for plots, of each domain.
        not_transferred: effects that were found but are a habit of the recording.
        unused: columns that measure something but took no part, with the reason.
        refitted: joints whose error refitting the given model explains alone, so that a cause may hide in it.
        beside_known: where the given model's parameters do not hold and were fitted anew, what explains most of the
            recording with them as they were: one or two sets of effects, the sizes of each fitted together.
        arguments: why each cause was named, where that was asked for.
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
    not_transferred: tuple[NotTransferred, ...] = ()
    unused: dict[str, str] = field(default_factory=dict)
    refitted: tuple[RefitExplains, ...] = ()
    beside_known: tuple[tuple[FittedEffect, ...], ...] = ()
    arguments: tuple[Argument, ...] = ()

    @property
    def unexplained(self) -> tuple[ChannelResult, ...]:
        """Channels in which something remains that matters."""
        return tuple(c for c in self.channels if c.unexplained)

    def summary(self) -> list[tuple[str, str]]:
        """What was found, and the errors before and after."""
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
        """For JSON: the keys that were promised, and a few more."""
        return plain({
            "verdict": self.verdict,
            "channels": [c.to_dict() for c in self.channels],
            "effects": [e.to_dict() for e in self.effects],
            "unknown": [{"joint": u.fitted.joint, "depends_on": list(u.depends_on), "rms_before": u.rms_before,
                         "rms_after": u.rms_after, "channel": u.fitted.channel, "p_value": u.p_value,
                         "transfers": u.transfers} for u in self.unknown],
            "held_out": {"how": self.held_out_how, "seconds": self.held_out_seconds},
            "not_transferred": [d.to_dict() for d in self.not_transferred],
            "undecided": [{"joint": joint, "reason": reason} for joint, reason in sorted(self.undecided.items())],
            "residual_before": self.before, "residual_after": self.remaining,
            "warnings": list(self.warnings),
            "unused": [{"columns": names, "reason": reason} for names, reason in self.unused.items()],
            **({"explained": [a.to_dict() for a in self.arguments]} if self.arguments else {}),
            "explained_by_refitting": self.refitted,
            "with_parameters_held": [[{"effect": e.name, "joint": e.joint, "parameters": [p.text for p in e.parameters]}
                                      for e in effects] for effects in self.beside_known],
            "unexplained": [c.channel for c in self.unexplained],
            "above_noise": [c.channel for c in self.channels if c.above_noise],
        })
