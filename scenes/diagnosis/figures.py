"""Figures of a diagnosis: errors without each cause, each cause with the residual it explains, residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.validation.result import Argument, Diagnosis, FoundEffect, Traces
from ideal_robot.effects.base import TCP_POSITION, prefix_of
from ideal_robot.estimate.score import TOLD
from ideal_robot.registry import in_words

_BEFORE, _AFTER, _EFFECT, _SOFT = "#b0413e", "#2f6690", "#e06a00", "#8893a1"
_CURVE = 0.5
"""Share of an effect that a curve over one signal has to explain for the effect to be drawn over it."""
_RIVALS = 4
"""Rivals of a cause that are drawn: the best ones, which a reader asks about; the JSON has all."""
Contribution = tuple[tuple[str, ...], Traces, int, Array]
"""Names of the channels of a domain, their traces, the channel, and what an effect adds there ``(N,)``."""


def without_each_figure(diagnosis: Diagnosis) -> Figure:
    """Figure of held-out errors: before, with all causes but one, with all; one panel per channel, with the noise."""
    effects = _in_order(diagnosis)
    channels = list(dict.fromkeys(channel_of(diagnosis, e) for e in effects))[:6]
    rows = {name: [e for e in effects if channel_of(diagnosis, e) == name] for name in channels}
    figure = Figure(figsize=(4.6, 0.7 + sum(0.95 + 0.32 * len(rows[name]) for name in channels)), layout="constrained")
    panels = figure.subplots(len(channels), 1, squeeze=False,
                             height_ratios=[2.2 + len(rows[name]) for name in channels])[:, 0]
    for axes, name in zip(panels, channels, strict=True):
        own = next((c for c in diagnosis.channels if c.channel == name), None)
        steps = [("before", own.rms_before)] if own else []
        steps += [(f"all but {in_words(e.fitted.name)}" +
                   (f" ({', '.join(e.depends_on)})" if e.depends_on else ""), e.rms_before) for e in rows[name]]
        steps += [("all", rows[name][0].rms_after)]
        scale, unit = shown_in(unit_of(diagnosis, name))
        steps = [(word, scale * error) for word, error in steps]
        places = range(len(steps))
        axes.barh(places, [error for _, error in steps], height=0.62,
                  color=[_SOFT] * bool(own) + [_EFFECT] * len(rows[name]) + [_AFTER])
        for place, (_, error) in zip(places, steps, strict=True):
            axes.text(error, place, f" {error:.3g}", va="center", fontsize=9)
        axes.set_yticks(places, [word for word, _ in steps], fontsize=9)
        axes.invert_yaxis()
        if own is not None and own.noise_floor > 0:
            axes.axvline(scale * own.noise_floor, color="0.2", ls="--", lw=1.0)
        axes.set_xlabel(f"RMS error of {name}" + (f" [{unit}]" if unit else ""))
        axes.set_xlim(0, 1.12 * max(error for _, error in steps))
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def channel_of(diagnosis: Diagnosis, effect: FoundEffect) -> str:
    """The measured channel that an effect is in, such as ``tau_6`` for an effect fitted in ``tau_bell_6``."""
    name = effect.fitted.channel
    measured = f"{name.partition('_')[0]}_{name.rpartition('_')[2]}"
    return measured if any(c.channel == measured for c in diagnosis.channels) else name


def unit_of(diagnosis: Diagnosis, name: str) -> str:
    """Unit of a channel, or of all channels whose names begin with ``name``; empty if there is none."""
    # The tool's channels are called x, y and z.
    names = ("x",) if name.partition("_")[0] == TCP_POSITION.prefix else (name,)
    return next((c.unit for c in diagnosis.channels if c.channel in names or c.channel.rpartition("_")[0] in names), "")


def shown_in(unit: str) -> tuple[float, str]:
    """Factor and unit for showing values to people: positions in thousandths."""
    return {"m": (1e3, "mm"), "rad": (1e3, "mrad")}.get(unit, (1.0, unit))


def arguments_figure(arguments: Sequence[Argument]) -> Figure:
    """Figure of how much worse each set of causes is when a named one is replaced or left out."""
    rows = [[*claim.rivals[:_RIVALS], *(other for other in claim.sets if not other.name)] for claim in arguments]
    figure = Figure(figsize=(6.2, 0.6 + sum(0.75 + 0.26 * len(row) for row in rows)), layout="constrained")
    panels = figure.subplots(len(rows), 1, squeeze=False, sharex=True, height_ratios=[2 + len(row) for row in rows])
    for axes, claim, sets in zip(panels[:, 0], arguments, rows, strict=True):
        for place, other in enumerate(sets):
            axes.errorbar(other.nats, place, xerr=TOLD * other.std, color=_EFFECT if other.rejected else _AFTER,
                          marker="o", ms=4.5, lw=0, elinewidth=1.4)
        axes.set_yticks(range(len(sets)), [other.words for other in sets], fontsize=9)
        axes.set_ylim(len(sets) - 0.4, -0.6)
        axes.axvline(0.0, color="0.2", lw=1.0)
        axes.set_title(f"{claim.name}, {claim.place}", fontsize=10, loc="left")
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xscale("symlog", linthresh=10.0)
    panels[-1, 0].set_xlabel("worse than the best set by … nats (two standard errors)")
    return figure


def _in_order(diagnosis: Diagnosis) -> list[FoundEffect]:
    """Effects in the order in which they were taken, which is that of what they add to their channels."""
    return sorted((*diagnosis.effects, *diagnosis.unknown), key=lambda e: e.taken)


def contributions(diagnosis: Diagnosis) -> list[tuple[FoundEffect, Contribution]]:
    """The effects that the diagnosis kept, each with its contribution to its channel."""
    shown = []
    for names, traces in diagnosis.traces:
        domain = TCP_POSITION.prefix if names[0] == "x" else prefix_of(names[0])
        # An effect may be reported under another name than that of its channel.
        here = [e for e in _in_order(diagnosis) if e.fitted.channel in names or e.fitted.domain.prefix == domain]
        for e, added in zip(here, traces.added, strict=True) if len(here) == len(traces.added) else ():
            j = int(np.argmax(np.sum(added**2, axis=0)))
            shown.append((e, (names, traces, j, added[:, j])))
    return shown


def effect_figure(effect: FoundEffect, contribution: Contribution, unit: str) -> tuple[Figure, str]:
    """Figure of the residual without one effect, over its main signal, with the effect drawn through it.

    An effect that is no curve over one signal is drawn over what it predicts itself.

    Args:
        effect, contribution: the effect, and its contribution.
        unit: of its channel, as text.

    Returns:
        The picture, and the sentence that says what to see in it.
    """
    names, traces, j, added = contribution
    mask = traces.use[:, j]
    signals = {"t [s]": traces.t}
    if j < traces.q.shape[1]:
        position, velocity = _of_joint(j, unit)
        acceleration = f"acceleration of joint {j + 1} [{'m/s²' if unit == 'N' else 'rad/s²'}]"
        signals = {velocity: traces.qd[:, j], position: traces.q[:, j],
                   acceleration: np.gradient(traces.qd[:, j], traces.t), **signals}
    shares = {label: _explained(x[mask], added[mask]) for label, x in signals.items()}
    label = max(shares, key=lambda key: shares[key])
    word = in_words(effect.fitted.name)
    curve = shares[label] >= _CURVE
    x = signals[label] if curve else added
    # The model's residual without this effect alone.
    without = traces.residual_after[:, j] + added
    figure = Figure(figsize=(4.6, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.plot(x[mask], without[mask], ".", ms=2, color=_SOFT, alpha=0.35, rasterized=True, label="residual without it")
    centre, mean, error = _binned(x[mask], without[mask], 30)
    axes.errorbar(centre, mean, error, color=_AFTER, lw=0, elinewidth=1.2, marker="o", ms=3.5, label="its mean in bins")
    centre, mean, _ = _binned(x[mask], added[mask], 60)
    axes.plot(centre, mean, color=_EFFECT, lw=2.2, label=word)
    axes.axhline(0.0, color="0.6", lw=0.6)
    limit = 1.15 * float(np.percentile(np.abs(without[mask]), 99)) if mask.any() else 1.0
    axes.set_ylim(-limit, limit)
    axes.set(xlabel=label if curve else f"what {word} predicts [{unit}]", ylabel=f"{names[j]} [{unit}]")
    axes.legend(fontsize=9, frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    axes.spines[["top", "right"]].set_visible(False)
    text = f"{word}: what remains of {names[j]} without it (grey, means blue), and the effect (orange)"
    if not curve:
        text += ("; it depends on several signals at once, so it is drawn over what it predicts: the nearer the means "
                 "are to the line, the better")
    return figure, text + "."


def _of_joint(j: int, unit: str) -> tuple[str, str]:
    length = "m" if unit == "N" else "rad"
    return f"position of joint {j + 1} [{length}]", f"velocity of joint {j + 1} [{length}/s]"


def _explained(x: Array, y: Array) -> float:
    """Share of the squares of ``y`` that a curve of 40 steps over ``x`` explains."""
    total = float(np.sum((y - y.mean()) ** 2)) if len(y) else 0.0
    if total <= 0 or len(y) < 160:
        return 0.0
    parts = np.array_split(np.argsort(x), 40)
    return 1.0 - sum(float(np.sum((y[part] - y[part].mean()) ** 2)) for part in parts) / total


def over_time(traces: Traces, j: int, name: str, unit: str) -> Figure:
    """Figure of a channel's measurement over time, with the model's residual before and after below it.

    Args:
        traces, j: series of a domain, and the channel, from 0.
        name, unit: of the channel.
    """
    figure = Figure(figsize=(10, 3.6))
    top, low = figure.subplots(2, 1, sharex=True)
    mask, t = traces.use[:, j], traces.t
    top.plot(t, traces.measured[:, j], color="0.5", lw=0.7)
    top.set_ylabel(f"{name} [{unit}]")
    for r, color, label in _residuals(traces, j):
        low.plot(t, np.where(mask, r, np.nan), color=color, lw=0.6, label=label)
    _within(low, 1.3, traces, j, 99.5)
    low.set(xlabel="t [s]", ylabel=f"residual [{unit}]")
    low.legend(loc="upper right", ncols=2, fontsize=8)
    if not traces.held_out.all():
        for axis in (top, low):
            axis.fill_between(t, 0, 1, where=traces.held_out, transform=axis.get_xaxis_transform(), color="0.92", lw=0)
    figure.tight_layout()
    return figure


def over_signals(traces: Traces, j: int, name: str, unit: str) -> Figure:
    """Figure of a channel's residual over position and velocity of the joint and over time.

    Args:
        traces, j: series of a domain, and the channel, from 0.
        name, unit: of the channel.
    """
    figure = Figure(figsize=(10, 3.0))
    axes = figure.subplots(1, 3, sharey=True)
    mask = traces.use[:, j]
    for axis, x, label in zip(axes, (traces.q[:, j], traces.qd[:, j], traces.t),
                              (*_of_joint(j, unit), "t [s]"), strict=True):
        for r, color, _ in _residuals(traces, j):
            if color == _BEFORE:
                axis.plot(x[mask], r[mask], ".", ms=1, color=color, alpha=0.15, rasterized=True)
            axis.errorbar(*_binned(x[mask], r[mask]), color=color, lw=1.4, elinewidth=0.8)
        axis.axhline(0.0, color="0.6", lw=0.6)
        axis.set_xlabel(label)
    _within(axes[0], 1.2, traces, j, 98)
    axes[0].set_ylabel(f"residual of {name} [{unit}]")
    figure.tight_layout()
    return figure


def _residuals(traces: Traces, j: int) -> list[tuple[Array, str, str]]:
    return [(traces.residual_before[:, j], _BEFORE, "before"), (traces.residual_after[:, j], _AFTER, "after")]


def _within(axis: Axes, times: float, traces: Traces, j: int, percent: float) -> None:
    """Limits about zero, as far as the residual before mostly goes."""
    residual = traces.residual_before[traces.use[:, j], j]
    limit = times * np.nanpercentile(np.abs(residual), percent) if len(residual) else 1.0
    axis.set_ylim(-limit, limit)


def _binned(x: Array, y: Array, bins: int = 24) -> tuple[Array, Array, Array]:
    """Centres, means and standard errors of ``y (N,)`` in equally filled bins of ``x (N,)``; as it is if too few."""
    if len(x) < bins:
        return x, y, np.zeros_like(y)
    parts = np.array_split(np.argsort(x), bins)
    return (np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts]),
            np.array([y[p].std() / np.sqrt(len(p)) for p in parts]))
