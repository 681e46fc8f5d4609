"""The page of a diagnosis: what the model lacks, what to do next, and the reasons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ideal_robot.diagnosis.validation.result import ChannelResult, Diagnosis, FoundEffect, Traces
from ideal_robot.effects import SENSOR
from ideal_robot.registry import in_words
from scenes.diagnosis.figures import (
    arguments_figure,
    channel_of,
    contributions,
    effect_figure,
    over_signals,
    over_time,
    shown_in,
    unit_of,
    without_each_figure,
)
from scenes.report.call import UNKNOWN, Call
from scenes.report.page import Report

_SAID = 2
"""Channels that the summary names one by one; of more, how many there are and the foremost one."""
_WORDS = {
    "effects": "The model misses {effects}.",
    "none": "Nothing is missing: what the model leaves in this recording shows no dependence on anything that was "
            "looked at, above the smallest effect that is claimed.",
    "quiet": "No effect could be named: what the model leaves in this recording shows no dependence on anything that "
             "was looked at, above the smallest effect that is claimed.",
    "loud": "No effect could be named, though the model leaves more than the noise of the measurement.",
    "unknown": "The model misses {effects}; {unknown} has a cause that the effect library does not have.",
    "left": "The model misses {effects}.",
    "undecided": "No joint moves in this recording: it decides nothing of the arm.",
}
_EFFECTS = {"degressive": "degressive friction", "stribeck": "Stribeck friction"}
"""Effects whose names say the law alone."""


def diagnosis_page(diagnosis: Diagnosis, title: str, call: Call = UNKNOWN) -> Report:
    """The report of a diagnosis.

    Args:
        diagnosis: the diagnosis.
        title: of the page.
        call: the command that was run, for the commands of the next steps.
    """
    page = Report(title, summary(diagnosis))
    add_diagnosis(page, diagnosis, next_steps(diagnosis, call))
    return page


def next_steps(diagnosis: Diagnosis, call: Call) -> list[tuple[str, str]]:
    """The next steps after a diagnosis, each a sentence and its command.

    Args:
        diagnosis: the diagnosis.
        call: the command that was run.
    """
    steps = []
    if any(e.indistinguishable_from for e in (*diagnosis.effects, *diagnosis.unknown)):
        steps.append(("Some causes explain the recording equally well: record the motion that decides.",
                      f"ideal-robot plan-diagnosis {call}"))
    if diagnosis.undecided:
        steps.append(("Record a motion in which every joint moves.",
                      f"ideal-robot plan-identification {call.of_robot}"))
    if any(map(_lowers, diagnosis.effects)):
        steps += [("Write a model that has what was found.",
                   f"ideal-robot diagnose {call} --model-out better.json"),
                  ("Correct a path with it.",
                   f"ideal-robot precorrect PATH.csv {call.of_robot} --model better.json -o corrected.csv")]
    elif diagnosis.verdict == "none":
        steps.append(("The model may stay as it is: correct a path with it.",
                      f"ideal-robot precorrect PATH.csv {call.of_robot} --model MODEL.json -o corrected.csv"))
    return steps or [("See what the recording holds, and whether it fits the arm.",
                      f"ideal-robot inspect {call.recorded}")]


def add_diagnosis(page: Report, diagnosis: Diagnosis, then: Sequence[tuple[str, str]] = ()) -> None:
    """Adds the sections of a diagnosis to a page: answer with picture, next steps, and the reasons folded.

    Args:
        page: the page to which they are added.
        diagnosis: the diagnosis.
        then: the next steps, each a sentence and its command; empty where the page has them already.
    """
    poor = [f"Joint {joint} {reason}." for joint, reason in sorted(diagnosis.undecided.items())]
    moved = f"Parameters that changed: {'; '.join(p.text for p in diagnosis.moved)}." if diagnosis.moved else ""
    # For a joint that moves too little one sentence is enough.
    said = [warning for warning in diagnosis.warnings
            if not any(warning.startswith(f"joint-never-moves: joint {joint} ") for joint in diagnosis.undecided)]
    for warning in filter(None, (*poor, *said, unexplained(diagnosis), moved)):
        page.warning(warning)
    if diagnosis.effects or diagnosis.unknown:
        page.figure(without_each_figure(diagnosis), "The error on held-out data before, with all causes but one, and "
                    "with all of them; dashed: the noise of the measurement, below which no model can get.")
    if then:
        page.next(*then)
    _effects(page, diagnosis)
    shown = contributions(diagnosis)
    if shown:
        page.heading("The effects that were found", folded=True)
    for e, contribution in shown:
        page.figure(*effect_figure(e, contribution, unit_of(diagnosis, contribution[0][contribution[2]])))
    page.heading("Error before and after, on held-out data", folded=True)
    page.text(f"Held out: {diagnosis.held_out_how}; {diagnosis.held_out_seconds:.1f} s.")
    page.table(["channel", "measured, rms", "before", "parameters refitted", "after", "noise of the measurement",
                "unit", "before %", "after %", "samples used %"],
               [[c.channel, *_told(c.unit, c.rms_signal, c.rms_before, c.rms_refit, c.rms_after, c.noise_floor),
                 *_relative(c), 100.0 * c.counted] for c in diagnosis.channels],
               "tau_i: torque of joint i; qa_i: its arm angle; x, y, z: the tool. Relative errors are 100·‖y − ŷ‖/‖y‖, "
               "of torques alone. Samples are used where a joint moves, apart from reversals, rests and the ends of "
               "the recording.")
    if diagnosis.unused:
        page.text(f"Not used: {unused(diagnosis)}.")
    _arguments(page, diagnosis)
    for names, traces in diagnosis.traces:
        _traces(page, diagnosis, names, traces)
    _remaining(page, diagnosis)


def summary(diagnosis: Diagnosis) -> str:
    """The result in a sentence or two."""
    named = _named([e for e in diagnosis.effects if _lowers(e)])
    doubtful = _named([e for e in diagnosis.effects if not _lowers(e)])
    unknown = [f"a dependence of {_where(u)} on {' and '.join(u.depends_on)}" for u in diagnosis.unknown]
    words = diagnosis.verdict
    if words == "unknown" and not unknown:
        words = "left" if named else "loud"
    above = _above_noise(diagnosis)
    if words == "none" and above:
        words = "quiet"
    text = _WORDS[words].format(effects=_listed(named) or "no effect that the library has", unknown=_listed(unknown))
    if doubtful:
        words = _listed(doubtful)
        text += (f" {words[:1].upper()}{words[1:]} was fitted too, but the error on data that had no part in finding "
                 "it does not fall: that it is missing is not claimed.")
    shown = _own(diagnosis)
    if shown and diagnosis.verdict in ("effects", "unknown"):
        # With many channels only the one that falls most is named; the table has all.
        most = min(shown, key=lambda c: c.rms_after / max(c.rms_before, 1e-300))
        lower = sum(c.rms_after < c.rms_before for c in shown)
        words = (f"the error of {_listed([_change(c) for c in shown])}" if len(shown) <= _SAID else
                 f"the error is smaller in {lower} of {len(shown)} channels; that of {_change(most)}")
        text += f" On data that had no part in finding it {words}."
    return f"{text} {above}" if above else text


def _change(c: ChannelResult) -> str:
    """A channel's error before and after, in words."""
    before, after, unit = _told(c.unit, c.rms_before, c.rms_after)
    return f"{c.channel} goes from {before:.3g} to {after:.3g} {unit}"


def _own(diagnosis: Diagnosis) -> list[ChannelResult]:
    """The channels in which something was found; those where the error falls if it has none."""
    channels = {e.fitted.channel for e in (*diagnosis.effects, *diagnosis.unknown) if _lowers(e)}
    # An effect of the whole arm has the name that all its channels begin with.
    own = [c for c in diagnosis.channels if {c.channel, c.channel.rpartition("_")[0]} & channels]
    return own or [c for c in diagnosis.channels if c.rms_after < 0.98 * c.rms_before]


def _above_noise(diagnosis: Diagnosis) -> str:
    """What is left above the noise of the measurement, in a sentence; empty where nothing is."""
    channels = [] if diagnosis.verdict == "undecided" else [c for c in diagnosis.channels if c.above_noise]
    entries = [(c, *_told(c.unit, c.rms_after)) for c in channels]
    if not entries:
        return ""
    # With many channels only the one farthest above its noise is named; the table of errors has all.
    loudest = max(entries, key=lambda entry: entry[0].times_noise)
    named = _listed([f"{c.channel} ({value:.3g} {unit}, {c.times_noise:.2g} times)"
                     for c, value, unit in (entries if len(entries) <= _SAID else [loudest])])
    if len(entries) > _SAID:
        named = f"{len(entries)} channels, most {named}"
    return f"Left above the noise of the measurement: {named}."


def unexplained(diagnosis: Diagnosis) -> str:
    """The residual far above the noise that no effect explains, in a sentence; empty if there is none."""
    if diagnosis.verdict == "undecided" or not diagnosis.unexplained:
        return ""
    loud = _listed([f"{c.channel} ({_times(c)})" for c in diagnosis.unexplained])
    return (f"What remains is several times the noise of the measurement in {loud}, and no signal that was looked at "
            "predicts it: short spikes, a filtered or saturated signal, or a cause that is not in the recording.")


def unused(diagnosis: Diagnosis) -> str:
    """The parts of the recording that were not used, and why, in words."""
    return "; ".join(f"{names} ({reason})" for names, reason in diagnosis.unused.items())


def _relative(c: ChannelResult) -> tuple[float | None, float | None]:
    """Errors before and after relative to the signal [%], for torques."""
    if not c.channel.startswith("tau"):
        return None, None
    return 100 * c.rms_before / max(c.rms_signal, 1e-300), 100 * c.rms_after / max(c.rms_signal, 1e-300)


def _times(c: ChannelResult) -> str:
    share = f", {100 * c.rms_after / c.spread:.0f} % of its spread" if np.isfinite(c.spread) and c.spread > 0 else ""
    return f"{c.rms_after / c.noise_floor:.0f} times{share}"


def _lowers(e: FoundEffect) -> bool:
    """Whether the error on data that had no part in finding the effect falls with it."""
    return e.rms_after < e.rms_before and e.transfers is not False


def _where(e: FoundEffect) -> str:
    nowhere = "the sensor" if e.fitted.domain == SENSOR else "the whole arm"
    return f"joint {e.fitted.joint}" if e.fitted.joint else nowhere


def _named(effects: list[FoundEffect]) -> list[str]:
    """Each effect once, with all the joints it is in, whatever channels show it there."""
    places: dict[tuple[str, str], set[int]] = {}
    for e in effects:
        key = _EFFECTS.get(e.fitted.name, in_words(e.fitted.name)), "" if e.fitted.joint else _where(e)
        places.setdefault(key, set()).add(e.fitted.joint)
    return [f"{name} in {where or ('joints ' if len(at) > 1 else 'joint ') + _listed(list(map(str, sorted(at))))}"
            for (name, where), at in places.items()]


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1] if parts else ""


def _effects(page: Report, diagnosis: Diagnosis) -> None:
    if not diagnosis.effects and not diagnosis.unknown:
        return
    page.heading("What the model lacks")
    effects = (*diagnosis.effects, *diagnosis.unknown)
    rows = [[in_words(e.fitted.name) + (f" ({', '.join(e.depends_on)})" if e.depends_on else ""), _where(e),
             channel_of(diagnosis, e),
             *_told(unit_of(diagnosis, channel_of(diagnosis, e)), e.rms_before, e.rms_after), e.nats, e.probability,
             "; ".join(p.text for p in e.fitted.parameters), in_words(", ".join(e.indistinguishable_from)) or "–",
             {None: "–", True: "yes", False: "no"}[e.transfers]] for e in effects]
    titles = ["effect", "where", "channel", "error without", "error with", "unit", "nats", "probability",
              "parameters", "not distinguishable from", "lowers the error of the other recording"]
    said = [i for i in range(len(titles)) if any(row[i] != "–" for row in rows)]
    page.table([titles[i] for i in said], [[row[i] for i in said] for row in rows],
               "Errors are on held-out data, all other causes being in the model. Nats: by how much the score is lower "
               "without it; the probability is that against everything else that was weighed in its place.")
    for e in effects:
        if e.would_tell:
            page.text(f"What distinguishes {in_words(e.fitted.name)} in {_where(e)} from "
                      f"{in_words(', '.join(e.indistinguishable_from))}: {e.would_tell}.")
        if e.transfers is False:
            page.warning(f"{e.fitted.name} in {_where(e)} does not lower the error of the validation recording: "
                         "it may be specific to the first recording.")


def _arguments(page: Report, diagnosis: Diagnosis) -> None:
    if not diagnosis.arguments:
        return
    page.heading("Why each was named", folded=True)
    for argument in diagnosis.arguments:
        page.text(f"{argument.text[:1].upper()}{argument.text[1:]}")
    page.figure(arguments_figure(diagnosis.arguments[:6]),
                "How much worse the score is with something else in the place of a named cause: log density of blocks "
                "of time that took no part in the fit and log prior, in nats, with two standard errors to either side. "
                "Blue: the data do not reject it.")


def _traces(page: Report, diagnosis: Diagnosis, names: tuple[str, ...], traces: Traces) -> None:
    touched = [j for j, c in enumerate(names) if any(d.channel == c and d.rms_after < 0.99 * d.rms_before
                                                     for d in diagnosis.channels)]
    if not touched:
        touched = [j for j, c in enumerate(names) if any(d.channel == c for d in diagnosis.channels)][:1]
    page.heading(f"Measured, and the residual: {' to '.join(dict.fromkeys((names[0], names[-1])))}", folded=True)
    for place, j in enumerate(touched[:7]):
        # The first one is shown as an example, the others are folded.
        folded = (f"{names[j]} over time", f"{names[j]} over position, velocity and time") if place else ("", "")
        page.figure(over_time(traces, j, names[j], unit_of(diagnosis, names[j])),
                    f"{names[j]}: the measurement (grey) and what the model leaves of it before (red) and after "
                    "(blue). Shaded: held-out stretches.", folded[0])
        if j < traces.q.shape[1]:
            page.figure(over_signals(traces, j, names[j], unit_of(diagnosis, names[j])),
                        f"{names[j]}: the residual over position, velocity and time. Lines are means of equally filled "
                        "bins with their standard errors; a flat line at zero is what nothing missing looks like.",
                        folded[1])


def _told(unit: str, *values: float) -> list[Any]:
    """Values as a person reads them, and their unit behind them."""
    scale, unit = shown_in(unit)
    return [*(scale * value for value in values), unit]


def _remaining(page: Report, diagnosis: Diagnosis) -> None:
    page.heading("What the residual depends on", folded=True)
    for words, relations in (("before", diagnosis.before), ("after", diagnosis.remaining)):
        if not relations:
            page.text(f"Residual {words}: no dependence on a single signal stands out of chance.")
            continue
        page.table(["channel", "depends on", "share of squares", "by chance", "p-value"],
                   [[s.channel, " and ".join(s.depends_on), s.share, s.share_by_chance, s.p_value] for s in relations],
                   f"Residual {words}: smooth curves over single signals; by chance: with the signs of whole blocks of "
                   "time flipped at random.")
