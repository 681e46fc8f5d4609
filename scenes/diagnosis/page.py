"""The page of a diagnosis: what was expected and measured, what remained, what that looked like, what was added."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.validation.result import Diagnosis, FoundEffect, Traces
from ideal_robot.effects import SENSOR
from scenes.report.page import Report

_WORDS = {
    "effects": "The model misses {effects}.",
    "none": "Nothing is missing: what the model leaves in this recording shows no dependence on anything that was "
            "looked at, above the smallest effect that is claimed.",
    "loud": "No effect could be named, though the model leaves more than the noise of the measurement.",
    "unknown": "The model misses {effects}; {unknown} has a cause that the effect library does not have.",
    "undecided": "This recording moves too little to decide anything.",
}
_BEFORE, _AFTER = "#b0413e", "#2f6690"


def diagnosis_page(diagnosis: Diagnosis, title: str) -> Report:
    """The report of a diagnosis."""
    page = Report(title, summary(diagnosis))
    page.figures([("verdict", diagnosis.verdict), ("effects", str(len(diagnosis.effects))),
                  ("learned terms", str(len(diagnosis.unknown))),
                  ("held-out data", f"{diagnosis.held_out_seconds:.1f} s")])
    for joint, reason in sorted(diagnosis.undecided.items()):
        page.warning(f"Joint {joint} is left out: it {reason}.")
    for warning in diagnosis.warnings:
        page.warning(warning)
    if loud := unexplained(diagnosis):
        page.warning(loud)
    page.heading("Error before and after, on held-out data")
    page.text(f"Held out: {diagnosis.held_out_how}.")
    page.table(["channel", "measured, rms", "before", "parameters refitted", "after", "noise of the measurement",
                "unit", "before %", "after %"],
               [[c.channel, c.rms_signal, c.rms_before, c.rms_refit, c.rms_after, c.noise_floor, c.unit,
                 100 * c.rms_before / max(c.rms_signal, 1e-300), 100 * c.rms_after / max(c.rms_signal, 1e-300)]
                for c in diagnosis.channels], "Relative errors are 100·‖y − ŷ‖/‖y‖.")
    _effects(page, diagnosis)
    if diagnosis.not_transferred:
        page.heading("Found, but not added")
        page.table(["effect", "where", "channel", "p-value", "error without", "error with"],
                   [[d.effect, f"joint {d.joint}" if d.joint else "the whole arm", d.channel, f"{d.p_value:.1e}",
                     d.rms_without, d.rms_with] for d in diagnosis.not_transferred],
                   "These lower the error of the recording they were found in, but not that of the other recording "
                   "(errors are on the blocks of it that decide): a phase that starts anew, or a habit of the motion.")
    for names, traces in diagnosis.traces:
        _traces(page, diagnosis, names, traces)
    _remaining(page, diagnosis)
    return page


def summary(diagnosis: Diagnosis) -> str:
    """The result in a sentence or two."""
    named = [f"{e.fitted.name.replace('_', ' ')} in {_where(e)}" for e in diagnosis.effects]
    unknown = [f"a dependence of {_where(u)} on {' and '.join(u.depends_on)}" for u in diagnosis.unknown]
    words = "loud" if diagnosis.verdict == "none" and diagnosis.unexplained else diagnosis.verdict
    text = _WORDS[words].format(effects=_listed(named) or "no effect that the library has", unknown=_listed(unknown))
    falls = [(c.channel, c.rms_before, c.rms_after, c.unit) for c in diagnosis.channels
             if c.rms_after < 0.98 * c.rms_before]
    if falls and diagnosis.verdict in ("effects", "unknown"):
        name, before, after, unit = max(falls, key=lambda f: f[1] / max(f[2], 1e-300))
        text += (f" On data that had no part in finding it the error of {name} falls from {before:.3g} to {after:.3g} "
                 f"{unit}.")
    return text


def unexplained(diagnosis: Diagnosis) -> str:
    """What remains far above the noise and has no name, in a sentence; empty if there is nothing."""
    if diagnosis.verdict == "undecided" or not diagnosis.unexplained:
        return ""
    loud = _listed([f"{c.channel} ({c.rms_after / c.noise_floor:.0f} times)" for c in diagnosis.unexplained])
    return (f"What remains is several times the noise of the measurement in {loud}, and no signal that was looked at "
            "predicts it: short spikes, a filtered or saturated signal, or a cause that is not in the recording.")


def _where(e: FoundEffect) -> str:
    nowhere = "the sensor" if e.fitted.domain == SENSOR else "the whole arm"
    return f"joint {e.fitted.joint}" if e.fitted.joint else nowhere


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1] if parts else ""


def _effects(page: Report, diagnosis: Diagnosis) -> None:
    if not diagnosis.effects and not diagnosis.unknown:
        return
    page.heading("What was added, in the order in which it was found")
    rows = []
    for e in (*diagnosis.effects, *diagnosis.unknown):
        name = e.fitted.name + (f" ({', '.join(e.depends_on)})" if e.depends_on else "")
        numbers = "; ".join(f"{p.name} {p.value:.4g} ± {p.std:.2g} {p.unit}" for p in e.fitted.parameters)
        told = {None: "–", True: "yes", False: "no"}[e.transfers]
        rows.append([name, _where(e), e.fitted.channel, e.rms_before, e.rms_after, f"{e.p_value:.1e}", numbers,
                     ", ".join(e.indistinguishable_from) or "–", told])
    page.table(["effect", "where", "channel", "error without", "error with", "p-value", "parameters",
                "these data cannot tell it from", "lowers the error of the other recording"], rows,
               "Errors are on held-out data, each effect with those before it in the model. The p-value is paid for "
               "all values of nonlinear parameters that were tried.")
    for e in (*diagnosis.effects, *diagnosis.unknown):
        if e.would_tell:
            page.text(f"To tell {e.fitted.name} in {_where(e)} from {', '.join(e.indistinguishable_from)}: "
                      f"{e.would_tell}.")
        if e.transfers is False:
            page.warning(f"{e.fitted.name} in {_where(e)} does not lower the error of the validation recording: "
                         "it may be a habit of the first recording.")


def _traces(page: Report, diagnosis: Diagnosis, names: tuple[str, ...], traces: Traces) -> None:
    touched = [j for j, c in enumerate(names) if any(d.channel == c and d.rms_after < 0.99 * d.rms_before
                                                     for d in diagnosis.channels)] or [0]
    page.heading("Measured, and what remained")
    for j in touched[:7]:
        page.figure(_over_time(traces, j, names[j]),
                    f"{names[j]}: the measurement (grey) and what the model leaves of it before (red) and after "
                    "(blue). Shaded: held-out stretches.")
        if j < traces.q.shape[1]:
            page.figure(_over_signals(traces, j, names[j]),
                        f"{names[j]}: the residual over position, velocity and time. Lines are means of equally filled "
                        "bins with their standard errors; a flat line at zero is what nothing missing looks like.")


def _over_time(traces: Traces, j: int, name: str) -> Figure:
    figure = Figure(figsize=(10, 3.6))
    top, low = figure.subplots(2, 1, sharex=True)
    mask = traces.use[:, j]
    t = traces.t
    top.plot(t, traces.measured[:, j], color="0.5", lw=0.7)
    top.set_ylabel(name)
    low.plot(t, np.where(mask, traces.residual_before[:, j], np.nan), color=_BEFORE, lw=0.6, label="before")
    low.plot(t, np.where(mask, traces.residual_after[:, j], np.nan), color=_AFTER, lw=0.6, label="after")
    limit = 1.3 * np.nanpercentile(np.abs(traces.residual_before[mask, j]), 99.5) if mask.any() else 1.0
    low.set_ylim(-limit, limit)
    low.set_ylabel("residual")
    low.set_xlabel("t [s]")
    low.legend(loc="upper right", ncols=2, fontsize=8)
    if not traces.held_out.all():
        for axis in (top, low):
            axis.fill_between(t, 0, 1, where=traces.held_out, transform=axis.get_xaxis_transform(), color="0.92", lw=0)
    figure.tight_layout()
    return figure


def _over_signals(traces: Traces, j: int, name: str) -> Figure:
    figure = Figure(figsize=(10, 3.0))
    axes = figure.subplots(1, 3, sharey=True)
    mask = traces.use[:, j]
    for axis, x, label in zip(axes, (traces.q[:, j], traces.qd[:, j], traces.t),
                              (f"q_{j + 1}", f"qd_{j + 1}", "t [s]"), strict=True):
        for r, color in ((traces.residual_before[:, j], _BEFORE), (traces.residual_after[:, j], _AFTER)):
            if color == _BEFORE:
                axis.plot(x[mask], r[mask], ".", ms=1, color=color, alpha=0.15, rasterized=True)
            centre, mean, error = binned(x[mask], r[mask])
            axis.errorbar(centre, mean, error, color=color, lw=1.4, elinewidth=0.8)
        axis.axhline(0.0, color="0.6", lw=0.6)
        axis.set_xlabel(label)
    limit = 1.2 * np.nanpercentile(np.abs(traces.residual_before[mask, j]), 98) if mask.any() else 1.0
    axes[0].set_ylim(-limit, limit)
    axes[0].set_ylabel(f"residual of {name}")
    figure.tight_layout()
    return figure


def binned(x: Array, y: Array, bins: int = 24) -> tuple[Array, Array, Array]:
    """Centres, means and standard errors of ``y`` in equally filled bins of ``x``."""
    if len(x) < bins:
        return x, y, np.zeros_like(y)
    order = np.argsort(x)
    parts = np.array_split(order, bins)
    return (np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts]),
            np.array([y[p].std() / np.sqrt(len(p)) for p in parts]))


def _remaining(page: Report, diagnosis: Diagnosis) -> None:
    page.heading("What the residual depends on")
    for words, found in (("before", diagnosis.before), ("after", diagnosis.remaining)):
        if found:
            page.table(["channel", "depends on", "share of squares", "by chance", "p-value"],
                       [[s.channel, " and ".join(s.depends_on), s.share, s.expected, f"{s.p_value:.1e}"]
                        for s in found],
                       f"Residual {words}: smooth curves over single signals; by chance: with the signs of whole "
                       "blocks of time flipped at random.")
        else:
            page.text(f"Residual {words}: no dependence on a single signal stands out of chance.")
