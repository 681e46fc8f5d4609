"""Errors of velocity and acceleration: encoder steps, jittering stamps and noise after the filters.

Position errors are assumed white; the position filter, the central differences and the decimation filter shape them,
which gives a standard deviation for every sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.signals.channels import lattice
from ideal_robot.signals.filters import ORDER, decimation_taps
from ideal_robot.signals.preprocess import FilteredSignals
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import WINDOW, regular_stamps, resampled

_LINES = 4096
"""Lines of the spectrum that gains are summed over."""


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
    t, jitter = regular_stamps(recording.t, q)
    step = _steps(q)
    noise = _noise(resampled(t, q, s.t, smooth=True), s.dt, step)
    # The clock's error is averaged over many stamps.
    remaining = jitter / np.sqrt(WINDOW)
    position = np.sqrt(noise**2 + (remaining * s.qd[:: s.factor][s.keep]) ** 2)
    first, second = _gains(s)
    return ErrorBudget(step, noise, jitter, first * position, second * position)


def position_noise(recording: Recording, q: Array, dt: float) -> Array:
    """Standard deviation of a measured position, encoder steps included ``(n,)`` [rad or m].

    Args:
        recording: with ``q_i``.
        q, dt: its positions at even instants ``(N, n)`` [rad or m], and their distance [s].
    """
    return _noise(q, dt, _steps(recording.joints("q")))


def _steps(q: Array) -> Array:
    """Distances between the levels of positions ``(N, n)``, 0 where there are none ``(n,)`` [rad or m]."""
    return np.array([lattice(q[:, j]) for j in range(q.shape[1])])


def _noise(q: Array, dt: float, step: Array) -> Array:
    """Standard deviation of positions ``(N, n)`` that are ``dt`` [s] apart: noise, or steps ``(n,)`` ``(n,)``."""
    return np.maximum(_white_level(q, dt), step / np.sqrt(12.0))


def _white_level(q: Array, dt: float) -> Array:
    """Standard deviation of the white part of the positions ``(n,)``, from the top of their spectrum."""
    f, power = signal.welch(np.diff(q, 2, axis=0), fs=1.0 / dt, nperseg=min(len(q) - 2, 1024), axis=0)
    top = (f > 0.35 / dt) & (f < 0.48 / dt)
    # The second difference has the gain (2 sin(π f dt))⁴; without it leakage of the motion would appear as noise.
    level = np.median(power[top] / (2.0 * np.sin(np.pi * f[top, None] * dt)) ** 4, axis=0)
    return np.asarray(np.sqrt(0.5 * level / dt))


def _gains(s: FilteredSignals) -> tuple[float, float]:
    """Standard deviations of velocity and acceleration per unit of white position noise, after all filters."""
    f = (np.arange(_LINES) + 0.5) * 0.5 / s.dt / _LINES
    _, H = signal.sosfreqz(signal.butter(ORDER, 2.0 * s.cutoff * s.dt, output="sos"), worN=f, fs=1.0 / s.dt)
    passed = np.abs(H) ** 2
    if s.factor > 1:
        # Taps are wrapped, as those a whole transform apart have the same phase.
        taps = decimation_taps(s.factor)
        whole = np.zeros(-(-len(taps) // (4 * _LINES)) * 4 * _LINES)
        whole[: len(taps)] = taps
        passed = passed * np.abs(np.fft.rfft(whole.reshape(-1, 4 * _LINES).sum(axis=0))[1::2])
    derivative = np.abs(np.sin(2.0 * np.pi * f * s.dt) / s.dt)
    return (float(np.sqrt(np.mean((passed * derivative) ** 2))),
            float(np.sqrt(np.mean((passed * derivative**2) ** 2))))
