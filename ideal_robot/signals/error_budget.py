"""How well velocity and acceleration are known: encoder steps, jittering stamps and noise through the filters.

An error of position is taken as white from sample to sample; the position filter, the central differences and the
decimation filter shape it, and what is left of it is a standard deviation for every sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import interpolate, signal

from ideal_robot.arrays import Array
from ideal_robot.signals.channels import lattice
from ideal_robot.signals.preprocess import ORDER, FilteredSignals, decimation_taps, resampled, uniform_time
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class ErrorBudget:
    """Errors of one recording's motion after its filters.

    Attributes:
        step: distance between the positions' levels ``(n,)`` [rad or m], 0 where there are none.
        noise: standard deviation of a position sample, steps included ``(n,)`` [rad or m].
        jitter: standard deviation of the stamps about the instants of sampling [s].
        velocity, acceleration: standard deviations at the decimated instants ``(M, n)`` [rad/s, rad/s²].
    """

    step: Array
    noise: Array
    jitter: float
    velocity: Array
    acceleration: Array


def error_budget(recording: Recording, s: FilteredSignals) -> ErrorBudget:
    """The error budget of a recording's filtered signals ``s``."""
    q = recording.joints("q")
    grid, _ = uniform_time(recording)
    jitter = stamp_jitter(recording.t, q)
    step = np.array([lattice(q[:, j]) for j in range(q.shape[1])])
    floor = _white_level(resampled(recording.t, q, grid, smooth=True), s.dt)
    speed = np.sqrt(np.mean(s.qd**2, axis=0))
    noise = np.maximum(np.sqrt(np.maximum(floor**2 - (jitter * speed) ** 2, 0.0)), step / np.sqrt(12.0))
    position = np.sqrt(noise**2 + (jitter * s.qd[:: s.factor][s.keep]) ** 2)
    first, second = _gains(s)
    return ErrorBudget(step, noise, jitter, first * position, second * position)


def stamp_jitter(t: Array, q: Array) -> float:
    """Standard deviation of the stamps about regular instants [s], 0 if the positions say that the stamps are right.

    Sampled regularly and stamped late, positions are smooth over their number and rough over their stamps; sampled
    irregularly it is the other way round. The rougher one has the larger third differences.
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    late = steps > 1.5 * usual
    if np.std(steps[~late]) < 1e-3 * usual:
        return 0.0
    # Between long steps: the stamps' distance from a straight line, and which time base the positions prefer.
    spread, rough = [], np.zeros(2)
    for part in np.split(np.arange(len(t)), np.flatnonzero(late) + 1):
        if len(part) < 50:
            continue
        number = np.arange(len(part), dtype=float)
        for rows in np.array_split(np.arange(len(part)), max(1, len(part) // 200)):
            line = np.polyval(np.polyfit(number[rows], t[part][rows], 1), number[rows])
            spread.append(float(np.mean((t[part][rows] - line) ** 2)))
        uniform = np.linspace(t[part][0], t[part][-1], len(part))
        for i, base in enumerate((t[part], uniform)):
            smooth = interpolate.CubicSpline(base[::2], q[part][::2], axis=0)(base[1::2])
            rough[i] += float(np.sum((q[part][1::2] - smooth)[2:-2] ** 2))
    if not spread or rough[0] <= rough[1]:
        return 0.0
    return float(np.sqrt(np.median(spread)))


def _white_level(q: Array, dt: float) -> Array:
    """Standard deviation of the white part of the positions ``(n,)``, from the top of their spectrum."""
    f, power = signal.welch(np.diff(q, 2, axis=0), fs=1.0 / dt, nperseg=min(len(q), 1024), axis=0)
    top = (f > 0.35 / dt) & (f < 0.48 / dt)
    # The second difference has the gain (2 sin(π f dt))⁴; without it, leakage of the motion would count as noise.
    level = np.median(power[top] / (2.0 * np.sin(np.pi * f[top, None] * dt)) ** 4, axis=0)
    return np.asarray(np.sqrt(0.5 * level / dt))


def _gains(s: FilteredSignals) -> tuple[float, float]:
    """Standard deviations of velocity and acceleration per unit of white position noise, after all filters."""
    f = (np.arange(4096) + 0.5) * 0.5 / s.dt / 4096
    _, H = signal.sosfreqz(signal.butter(ORDER, 2.0 * s.cutoff * s.dt, output="sos"), worN=f, fs=1.0 / s.dt)
    passed = np.abs(H) ** 2
    if s.factor > 1:
        passed = passed * np.abs(signal.freqz(decimation_taps(s.factor), worN=f, fs=1.0 / s.dt)[1])
    derivative = np.abs(np.sin(2.0 * np.pi * f * s.dt) / s.dt)
    return (float(np.sqrt(np.mean((passed * derivative) ** 2))),
            float(np.sqrt(np.mean((passed * derivative**2) ** 2))))
