"""Instants of sampling: stamps that jitter, motion that jitters, and stretches of long recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import interpolate, ndimage

from ideal_robot.arrays import Array
from ideal_robot.row_log import let_go
from ideal_robot.signals.recording import Recording

# Stamps that jitter about regular instants of sampling, and the instants behind them.
#
# A logger that samples by a clock and stamps late makes positions that are smooth over their number and rough over
# their stamps; one that samples irregularly and stamps well makes the opposite. The positions decide.

_FOLLOWS = 0.05
"""Share of a stamp's deviation that the clock is moved by: it drifts slowly, stamps jump."""
_LOST = 0.75
"""A stamp later than this share of a step belongs to a later sample: rows were lost."""
WINDOW = 51
"""Samples over which the clock's phase is averaged."""
_CLEARLY = 0.85
"""Positions over regular instants must be this much less rough than over their stamps."""


def regular_stamps(t: Array, q: Array) -> tuple[Array, float]:
    """Times of sampling ``(N,)`` [s] and the standard deviation of the stamps about them [s].

    The increasing stamps themselves and zero, unless the positions ``(N, n)`` say that sampling was regular.
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    # Lost rows apart: the mean of the ordinary steps is the clock's, whatever the jitter.
    ordinary = steps[steps < 3.0 * usual]
    if len(t) < 2 * WINDOW or np.std(ordinary) < 1e-3 * usual:
        return t, 0.0
    regular = _behind(t, usual)
    if np.any(np.diff(regular) <= 0.0) or roughness(regular, q) > _CLEARLY * roughness(t, q):
        return t, 0.0
    return regular, float(np.std(t - regular))


def _behind(t: Array, step: float) -> Array:
    """Instants of a clock that loses rows and drifts."""
    number = np.zeros(len(t))
    expected = t[0]
    for k in range(1, len(t)):
        error = t[k] - expected - step
        lost = max(0, round(error / step)) if error > _LOST * step else 0
        number[k] = number[k - 1] + 1 + lost
        expected += (1 + lost) * step + _FOLLOWS * (error - lost * step)
    slope, start = np.polyfit(number, t, 1)
    line = start + slope * number
    return np.asarray(line + ndimage.uniform_filter1d(t - line, WINDOW, mode="nearest"))


def roughness(t: Array, q: Array) -> float:
    """How far every second sample ``(N, n)`` is from a smooth curve through the others, fastest joints first."""
    moved = np.median(np.abs(interpolate.CubicSpline(t[::2], q[::2], axis=0)(t[1::2]) - q[1::2])[2:-2], axis=0)
    return float(np.sqrt(np.mean(moved**2)))


def on_its_clock(recording: Recording) -> Recording:
    """The recording with the instants of sampling for stamps, or as it is."""
    t, jitter = regular_stamps(recording.t, recording.joints("q"))
    return replace(recording, columns={**recording.columns, "t": np.ascontiguousarray(t)}) if jitter else recording


MOST = 500_000
"""Samples that are used at most, 17 minutes at 500 Hz: a fit takes about three kilobytes for each."""
STRETCH = 50_000
"""Samples of a stretch, so many that what filters lose at its ends does not count."""
_PAUSE, _STEPS = 0.9, 20.0
"""Between two stretches that are joined at least: a time [s], and steps of sampling; a pause, but none to be named."""
_TIMES = ("t", "cam_t")
"""Columns that hold times."""
FEWEST = 5_000
"""Samples that are used of each recording at least, where it has so many."""


def stretches(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], list[str]]:
    """The recordings, or of more than ``MOST`` samples stretches of each, and a warning that says so."""
    total = sum(len(recording.t) for recording in recordings)
    if total <= MOST:
        return tuple(recordings), []
    parts, used = [], 0
    for recording in recordings:
        share = max(MOST * len(recording.t) // total, min(FEWEST, len(recording.t)))
        rows = min(STRETCH, share)
        starts = np.linspace(0, len(recording.t) - rows, share // max(rows, 1)).astype(int)
        parts += [_part(recording, int(start), rows) for start in starts]
        used += rows * len(starts)
    return tuple(parts), [f"long-recording: of {total} samples {used} are used, in {len(parts)} stretches spread "
                          "evenly; give shorter recordings to choose which"]


def shortened(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording, or of more than ``MOST`` samples its stretches as one recording, and a warning that says so.

    The time between stretches is taken out: they follow each other after a pause, near which nothing is used.
    """
    parts, warnings = stretches([recording])
    if not warnings:
        return recording, []
    shifts: list[float] = []
    end = 0.0
    for part in parts:
        step = float(part.t[-1] - part.t[0]) / max(len(part.t) - 1, 1)
        begin = end + max(_PAUSE, _STEPS * step) if shifts else float(part.t[0])
        shifts.append(begin - float(part.t[0]))
        end = float(part.t[-1]) + shifts[-1]
    columns = {name: np.concatenate([part.columns[name] + (shift if name in _TIMES else 0.0)
                                     for part, shift in zip(parts, shifts, strict=True)])
               for name in recording.columns}
    for values in columns.values():
        values.setflags(write=False)
    return replace(recording, columns=columns), [f"{warnings[0]}; the time between them is taken out"]


def _part(recording: Recording, start: int, rows: int) -> Recording:
    columns = {name: np.array(values[start : start + rows]) for name, values in recording.columns.items()}
    let_go(*recording.columns.values())
    for values in columns.values():
        values.setflags(write=False)
    t = columns["t"]
    return replace(recording, columns=columns, source=f"{recording.source} ({t[0]:.0f} to {t[-1]:.0f} s)")
