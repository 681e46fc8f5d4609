"""How well velocity and acceleration are known: encoder steps, jittering stamps and noise through the filters.

An error of position is taken as white from sample to sample; the position filter, the central differences and the
decimation filter shape it, and what is left of it is a standard deviation for every sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import interpolate, signal

from ideal_robot.arrays import Array
from ideal_robot.signals.channels import lattice
from ideal_robot.signals.preprocess import ORDER, FilteredSignals, decimation_taps, lowpass, resampled
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import WINDOW, regular_stamps, roughness

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
    step = np.array([lattice(q[:, j]) for j in range(q.shape[1])])
    noise = np.maximum(_white_level(resampled(t, q, s.t, smooth=True), s.dt), step / np.sqrt(12.0))
    # The clock behind the stamps is known from many of them.
    remaining = jitter / np.sqrt(WINDOW)
    position = np.sqrt(noise**2 + (remaining * s.qd[:: s.factor][s.keep]) ** 2)
    first, second = _gains(s)
    return ErrorBudget(step, noise, jitter, first * position, second * position)


def _white_level(q: Array, dt: float) -> Array:
    """Standard deviation of the white part of the positions ``(n,)``, from the top of their spectrum."""
    f, power = signal.welch(np.diff(q, 2, axis=0), fs=1.0 / dt, nperseg=min(len(q) - 2, 1024), axis=0)
    top = (f > 0.35 / dt) & (f < 0.48 / dt)
    # The second difference has the gain (2 sin(π f dt))⁴; without it, leakage of the motion would count as noise.
    level = np.median(power[top] / (2.0 * np.sin(np.pi * f[top, None] * dt)) ** 4, axis=0)
    return np.asarray(np.sqrt(0.5 * level / dt))


def _gains(s: FilteredSignals) -> tuple[float, float]:
    """Standard deviations of velocity and acceleration per unit of white position noise, after all filters."""
    f = (np.arange(_LINES) + 0.5) * 0.5 / s.dt / _LINES
    _, H = signal.sosfreqz(signal.butter(ORDER, 2.0 * s.cutoff * s.dt, output="sos"), worN=f, fs=1.0 / s.dt)
    passed = np.abs(H) ** 2
    if s.factor > 1:
        # Taps a whole transform apart belong to the same phase of each of its lines.
        taps = decimation_taps(s.factor)
        whole = np.zeros(-(-len(taps) // (4 * _LINES)) * 4 * _LINES)
        whole[: len(taps)] = taps
        passed = passed * np.abs(np.fft.rfft(whole.reshape(-1, 4 * _LINES).sum(axis=0))[1::2])
    derivative = np.abs(np.sin(2.0 * np.pi * f * s.dt) / s.dt)
    return (float(np.sqrt(np.mean((passed * derivative) ** 2))),
            float(np.sqrt(np.mean((passed * derivative**2) ** 2))))


# Samples taken at irregular instants, and stamped as if they were regular: the motion itself tells the instants.
#
# A sample that is taken late by ``delta`` has every joint further along its way by ``qd delta``. What all joints have
# in common of the fast part of their positions, each in proportion to its speed, is the clock's; what they do not have
# in common is vibration, friction or noise of a joint. Joints that are moved in step have their motion in common as
# well; that is smooth, however, and a clock's scatter is not.

_MOTION = 5.0
"""Frequency above which positions hold more of a jitter of the clock than of the motion [Hz]."""
_SHARE = 0.5
"""Share of the fast part of the positions that the other joints have to foretell, for it to be the clock's."""
_SMOOTH = 0.5
"""Correlation of neighbouring samples' lateness from which on it is motion of the joints in step, not the clock's."""
_FARTHEST = 0.45
"""Instants are moved by less than that share of a step; samples keep their order."""
_FEWEST = 200
"""Samples of which anything is said, at least."""
_ON_GRID = 1e-7
"""Instants within this share of a step of an even grid are on it."""
_ROUNDS = 3
"""Times the smooth motion is drawn through the moved samples again."""


def sampling_instants(t: Array, q: Array) -> tuple[Array, float]:
    """Instants at which samples were taken ``(N,)`` [s], and their standard deviation about the stamps [s].

    The increasing stamps themselves and zero, unless the positions ``(N, n)`` of all joints say the same of a clock
    that scatters.
    """
    if len(t) < _FEWEST or q.shape[1] < 2 or not np.all(np.isfinite(q)):
        return t, 0.0
    dt = float(np.median(np.diff(t)))
    if 0.2 / dt < _MOTION:
        return t, 0.0
    products = _Products(*_fast_part(t, t, q, dt))
    if _foretold(products) < _SHARE or _smoothness(_common(products)) > _SMOOTH:
        return t, 0.0
    late = np.zeros(len(t))
    for _ in range(_ROUNDS):
        late = np.clip(late + _common(products), -_FARTHEST * dt, _FARTHEST * dt)
        if np.any(np.diff(t + late) <= 0.0):
            return t, 0.0
        products = _Products(*_fast_part(t + late, t, q, dt))
    return t + late, float(np.std(late))


def at_sampling_instants(recording: Recording) -> tuple[Recording, float]:
    """The recording stamped with the instants of sampling, and how far these are from the stamps; or as it is."""
    q = recording.joints("q")
    t, spread = sampling_instants(recording.t, q)
    if spread == 0.0:
        return recording, 0.0
    # A clock that is less rough than jittering stamps need not be the one that sampled.
    regular, jitter = regular_stamps(recording.t, q)
    if jitter > 0.0 and roughness(regular, q) <= roughness(t, q):
        return recording, 0.0
    return replace(recording, columns={**recording.columns, "t": np.ascontiguousarray(t)}), spread


def _fast_part(at: Array, t: Array, q: Array, dt: float) -> tuple[Array, Array]:
    """Fast part and speed of the positions ``q (N, n)`` taken at ``at (N,)``, both ``(N, n)``."""
    grid = t[0] + dt * np.arange(round((t[-1] - t[0]) / dt) + 1)
    if len(at) == len(grid) and np.max(np.abs(at - grid)) < _ON_GRID * dt:
        low = lowpass(q, dt, _MOTION)
        slow = interpolate.CubicSpline(grid, low, axis=0)
        # Knots and their slopes; the last one ends an interval.
        return q - low, np.concatenate([slow.c[2], slow(grid[-1:], 1)])
    slow = interpolate.CubicSpline(grid, lowpass(interpolate.CubicSpline(at, q, axis=0)(grid), dt, _MOTION), axis=0)
    return q - slow(at), slow(at, 1)


class _Products:
    """Mean squares and products of fast part and speed ``(N, n)``, from which joints' clocks follow quickly."""

    def __init__(self, fast: Array, speed: Array) -> None:
        self.fast, self.speed = fast, speed
        self.squared, self.product = speed**2, fast * speed
        self._size = np.mean(fast**2, axis=0)

    def precision(self, late: Array | None = None) -> Array:
        """1/σ² of what is left of each joint's fast part ``(n,)`` with samples late by ``late (N,)``."""
        squares = self._size
        if late is not None:
            squares = squares - (2.0 * late @ self.product - late**2 @ self.squared) / len(late)
        return np.asarray(1.0 / np.maximum(squares, 1e-18))


def _common(of: _Products, without: int | None = None) -> Array:
    """By how much each sample is late ``(N,)`` [s], most likely, by all joints or ``without`` one of them.

    Little is said where no joint moves.
    """
    weights = of.precision()
    for _ in range(2):
        if without is not None:
            weights[without] = 0.0
        gain, raw = of.squared @ weights, of.product @ weights
        # The clock's own scatter, as what the samples say less what their noise makes of it.
        strong = gain > np.median(gain)
        if not strong.any():
            return np.zeros(len(gain))
        variance = max(float(np.mean((raw[strong] / gain[strong]) ** 2 - 1.0 / gain[strong])), 1e-18)
        late = raw / (gain + 1.0 / variance)
        weights = of.precision(late)
    return np.asarray(late)


def _smoothness(late: Array) -> float:
    """Correlation of neighbours in ``late (N,)``."""
    return float(late[1:] @ late[:-1]) / max(float(late @ late), 1e-300)


def _foretold(of: _Products) -> float:
    """Share of the squares of the joints' fast parts that the other joints' foretell, in the median over joints."""
    shares = []
    for j in range(of.fast.shape[1]):
        foretold, own = _common(of, j) * of.speed[:, j], of.fast[:, j]
        shares.append(float(foretold @ own) ** 2 / max(float(foretold @ foretold) * float(own @ own), 1e-300)
                      if foretold @ own > 0.0 else 0.0)
    return float(np.median(shares))
