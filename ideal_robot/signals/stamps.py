"""Stamps that jitter about regular instants of sampling, and the instants behind them.

A logger that samples by a clock and stamps late makes positions that are smooth over their number and rough over their
stamps; one that samples irregularly and stamps well makes the opposite. The positions decide.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import interpolate, ndimage

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording

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

    The stamps themselves and zero, unless the positions say that sampling was regular.

    Args:
        t: stamps ``(N,)`` [s], increasing.
        q: positions ``(N, n)``.
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
    """How far every second sample is from a smooth curve through the others, fastest joints first.

    Args:
        t: times of the samples ``(N,)`` [s], increasing.
        q: positions ``(N, n)``.
    """
    moved = np.median(np.abs(interpolate.CubicSpline(t[::2], q[::2], axis=0)(t[1::2]) - q[1::2])[2:-2], axis=0)
    return float(np.sqrt(np.mean(moved**2)))


def on_its_clock(recording: Recording) -> Recording:
    """The recording with the instants of sampling for stamps, or as it is."""
    t, jitter = regular_stamps(recording.t, recording.joints("q"))
    return replace(recording, columns={**recording.columns, "t": np.ascontiguousarray(t)}) if jitter else recording
