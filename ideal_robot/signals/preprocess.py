"""From a raw recording to signals a least-squares fit can use ([J] 3).

Position is low-passed without phase, velocity and acceleration are central differences of it, and the torque and
every column of the regressor go through the same decimation filter ("parallel decimation"), which takes away what
the model does not claim to explain. Both cut-offs are chosen from the data unless given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise

import numpy as np
import scipy

from ideal_robot.arrays import Array, interpolated
from ideal_robot.errors import InputError
from ideal_robot.jit import jit
from ideal_robot.signals.filters import filtered_at, forwards_and_backwards, not_zero
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import on_its_clock

ORDER = 4
"""Order of the Butterworth filter; run forwards and backwards it acts as twice that."""

_FINE = 10.0
"""Samples a period of the cut-off that are enough for motion below it."""
_MINIMUM_SAMPLES = 100  # ten times what has to be left
_FEWEST = 10
"""Samples that have to be left after filtering and decimation."""
_GAP = 5.0
"""A pause longer than this many sampling steps is a hole; nothing near it is trusted."""


@dataclass(frozen=True)
class FilteredSignals:
    """Uniformly sampled, filtered signals of one recording.

    Attributes:
        t: ``(N,)`` [s].
        q, qd, qdd: filtered position and its central differences ``(N, n)`` [rad, rad/s, rad/s²].
        tau: motor torque, not yet decimated, ``(N, n)`` [N m]; NaN where the recording has none.
        factor: decimation factor.
        cutoff: of the position filter [Hz].
        cutoff_decimation: half-power frequency of the decimation filter [Hz].
        keep: mask ``(ceil(N / factor),)`` of decimated samples away from edges and holes.
        source: where the recording came from.
        columns: further columns of the recording on the same time grid, ``(N,)`` each (unfiltered).
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    factor: int
    cutoff: float
    cutoff_decimation: float
    keep: np.ndarray
    source: str
    columns: dict[str, Array] = field(default_factory=dict, repr=False)

    @property
    def dt(self) -> float:
        """Sampling step [s]."""
        return float(self.t[1] - self.t[0])

    def decimate(self, values: Array) -> Array:
        """Filters and decimates ``(N, …)`` along the first axis and drops edges: ``(M, …)``, all columns alike."""
        return decimated(values, self.factor)[self.keep]

    @property
    def stride(self) -> int:
        """Samples from one to the next that are enough for the motion: it has nothing above its cut-off."""
        return max(1, min(int(1.0 / (self.dt * _FINE * self.cutoff)), self.factor // 5))

    def decimate_motion(self, columns: Callable[[slice], Array], block: int = 20_000) -> Array:
        """As ``decimate``, of smooth functions of the motion made piece by piece at every ``stride``-th sample alone.

        Long recordings need little more memory than short ones: ``columns`` makes the rows ``(k, …)`` of a slice of
        samples, ``block`` of them at a time.
        """
        if self.factor == 1:
            return columns(slice(None))[self.keep]
        stride, reach = self.stride, 10 * self.factor
        outputs = np.arange(0, len(self.t), self.factor)
        pieces = []
        for some in np.array_split(outputs, -(-len(self.t) // block)):
            first = max(0, some[0] - reach) // stride * stride
            rows = columns(slice(first, min(len(self.t), some[-1] + reach + 1), stride))
            pieces.append(filtered_at(rows, (some - first) / stride, decimation_taps(self.factor), fine=stride))
        return np.concatenate(pieces)[self.keep]

    @property
    def temperature(self) -> Array | None:
        """Gear temperatures ``(N, n)`` [°C]; zero throughout for a joint without, None where no joint has one."""
        known = [self.columns.get(f"temp_{j + 1}") for j in range(self.q.shape[1])]
        usable = [values if values is not None and np.all(np.isfinite(values)) else None for values in known]
        if all(values is None for values in usable):
            return None
        return np.column_stack([np.zeros(len(self.t)) if values is None else values for values in usable])

    @property
    def t_decimated(self) -> Array:
        """Times of the decimated samples ``(M,)`` [s]."""
        return self.t[:: self.factor][self.keep]


@dataclass(frozen=True)
class EvenSignals:
    """A recording brought to evenly spaced instants, not yet filtered.

    Attributes:
        t: ``(N,)`` [s].
        hole: mask ``(N,)`` of the instants at which nothing was recorded.
        q: positions ``(N, n)`` [rad].
        tau: motor torque ``(N, n)`` [N m]; NaN where the recording has none.
        source: where the recording came from.
        columns: further columns, ``(N,)`` each.
    """

    t: Array
    hole: np.ndarray
    q: Array
    tau: Array
    source: str
    columns: dict[str, Array] = field(default_factory=dict, repr=False)

    def filtered(self, cutoff: float | None = None, cutoff_decimation: float | None = None) -> FilteredSignals:
        """Filters and differentiates; arguments and errors as for ``preprocess``."""
        dt = float(self.t[1] - self.t[0])
        rate = 1.0 / dt
        lowest = 0.0 if cutoff is None else 1.0 / (len(self.t) * dt)
        cutoff = chosen_cutoff(self.q, dt) if cutoff is None else float(cutoff)
        if not lowest < cutoff < 0.5 * rate:
            raise InputError(f"cut-off must lie between {lowest:.3g} Hz, one oscillation of the recording, and "
                             f"{0.5 * rate:.4g} Hz, half the sampling rate", file=self.source, field="cutoff",
                             value=cutoff)
        q = lowpass(self.q, dt, cutoff)
        qd = np.gradient(q, dt, axis=0)
        qdd = np.gradient(qd, dt, axis=0)
        wanted = 0.5 * cutoff if cutoff_decimation is None else float(cutoff_decimation)
        if cutoff_decimation is not None and not wanted * len(self.t) * dt > 1.0:
            raise InputError("the band that is kept must hold more than one oscillation of the recording: "
                             f"above {1.0 / (len(self.t) * dt):.3g} Hz", file=self.source, field="cutoff_decimation",
                             value=cutoff_decimation)
        factor, keep = self._thinning(cutoff, wanted)
        if keep.sum() < _FEWEST:
            raise InputError("too short: after filtering and removing the edges fewer than 10 samples are left",
                             file=self.source, field="t", value=f"{self.t[-1] - self.t[0]:.3g} s")
        return FilteredSignals(self.t, q, qd, qdd, self.tau, factor, cutoff, 0.5 * rate / factor, keep, self.source,
                               self.columns)

    def long_enough(self, cutoff: float) -> bool:
        """Whether ends and holes leave samples enough under a cut-off [Hz] and a decimation at half of it."""
        return bool(self._thinning(cutoff, 0.5 * cutoff)[1].sum() >= _FEWEST)

    def _thinning(self, cutoff: float, wanted: float) -> tuple[int, np.ndarray]:
        """Factor of decimation, and which decimated samples are clear of ends and holes."""
        rate = 1.0 / float(self.t[1] - self.t[0])
        factor = max(1, round(0.5 * rate / wanted))
        # The ends of the recording are felt as far as the memory of both filters reaches.
        return factor, _kept(self.hole, factor, edge=math.ceil(max(rate / cutoff, 5.0 * factor)))


def evenly_sampled(recording: Recording, *, columns: bool = True) -> EvenSignals:
    """A recording at evenly spaced instants, with its other columns or without; raises InputError for too few samples.

    It needs ``t`` and ``q_i``; ``tau_i`` may be missing.
    """
    if len(recording.t) > 1 and np.all(np.diff(recording.t) > 0):
        recording = on_its_clock(recording)
    t, hole = uniform_time(recording)
    if len(t) < _MINIMUM_SAMPLES:
        raise InputError(f"too short: at least {_MINIMUM_SAMPLES} samples are needed", file=recording.source, field="t",
                         value=len(t))
    q = resampled(recording.t, recording.joints("q"), t, smooth=True)
    tau = (resampled(recording.t, recording.joints("tau"), t) if recording.has("tau") else np.full_like(q, np.nan))
    names = [name for name in recording.columns if name != "t" and columns]
    values = (resampled(recording.t, np.array([recording.columns[name] for name in names]).T, t) if names
              else np.empty((0, 0)))
    return EvenSignals(t, hole, q, tau, recording.source, dict(zip(names, values.T, strict=True)))


def preprocess(recording: Recording, *, cutoff: float | None = None,
               cutoff_decimation: float | None = None) -> FilteredSignals:
    """Filters and differentiates a recording.

    Raises InputError for too few samples, or a cut-off the sampling rate does not allow.

    Args:
        recording: needs ``t`` and ``q_i``; ``tau_i`` may be missing (then ``tau`` is NaN).
        cutoff: of the position filter [Hz]; chosen from the data if None.
        cutoff_decimation: half-power frequency of the decimation filter [Hz]; half of ``cutoff`` if None.
    """
    return evenly_sampled(recording).filtered(cutoff, cutoff_decimation)


def gap_free(recording: Recording, prefixes: Sequence[str], fewest: int) -> list[Recording]:
    """The stretches between a recording's gaps, each at even instants; the recording itself where it is even already.

    A gap is what is a hole to ``uniform_time``; fewer lost rows are filled in from those around them. Raises InputError
    where a column is missing.

    Args:
        recording, prefixes: with ``t`` and ``q_i``, time increasing; the quantities of the joints that are needed.
        fewest: samples without which a stretch is of no use and left out, at least two.
    """
    recording = on_its_clock(recording)
    t, steps = recording.t, np.diff(recording.t)
    # Lost rows do not lengthen the cycle.
    cycle = float(np.mean(steps[steps < 1.5 * np.median(steps)])) if len(steps) else 1.0
    stretches = []
    for begin, end in pairwise([0, *(np.flatnonzero(steps > _GAP * cycle) + 1), len(t)]):
        times = t[begin:end]
        grid = np.linspace(times[0], times[-1], round((times[-1] - times[0]) / cycle) + 1)
        if len(grid) < fewest:
            continue
        if len(grid) == len(t) and np.allclose(t, grid, atol=1e-3 * cycle, rtol=0.0):
            return [recording]
        stretches.append(Recording.from_arrays(grid, meta=recording.meta, source=recording.source, **{
            prefix: resampled(times, recording.joints(prefix, slice(begin, end)), grid, smooth=prefix != "tau")
            for prefix in prefixes}))
    return stretches


def uniform_time(recording: Recording) -> tuple[Array, np.ndarray]:
    """A uniform time grid at the recording's median step, and a mask of grid points that lie in holes."""
    t = recording.t
    steps = np.diff(t)
    if len(steps) == 0 or np.any(steps <= 0):
        raise InputError("time must increase from sample to sample", file=recording.source, field="t")
    # The mean of the ordinary steps, not the median, so that jittering stamps do not stretch the grid.
    dt = float(np.mean(steps[steps < _GAP * np.median(steps)]))
    count = int(np.floor((t[-1] - t[0]) / dt + 1e-6)) + 1
    grid = t[0] + dt * np.arange(count)
    hole = np.zeros(count, dtype=bool)
    for k in np.flatnonzero(steps > _GAP * dt):
        hole |= (grid > t[k]) & (grid < t[k + 1])
    return grid, hole


def resampled(t: Array, values: Array, grid: Array, smooth: bool = False) -> Array:
    """Values at the grid's times ``(M, m)``; smooth ones by cubic splines, noisy ones linearly.

    Args:
        t, values: times ``(N,)`` [s] and values ``(N, m)``.
        grid, smooth: times asked for ``(M,)`` [s], and whether the values are free of noise.
    """
    if len(t) == len(grid) and np.allclose(t, grid, atol=1e-3 * (grid[1] - grid[0]), rtol=0.0):
        return np.array(values, dtype=float)
    if smooth:
        return np.asarray(scipy.interpolate.CubicSpline(t, values, axis=0)(grid))
    return interpolated(grid, t, values)


def lowpass(values: Array, dt: float, cutoff: float) -> Array:
    """Zero-phase Butterworth low-pass along the first axis.

    Args:
        values, dt: ``(N, …)``, evenly spaced in time, and the time step [s].
        cutoff: [Hz].
    """
    sos = _sections(2.0 * cutoff * dt)
    # Padding as long as the filter remembers; the default is too short for low cut-offs.
    pad = min(len(values) - 1, int(np.ceil(1.5 / (cutoff * dt))) + 3 * (ORDER + 1))
    values = np.asarray(values, dtype=float)
    return forwards_and_backwards(sos, values.reshape(len(values), -1), pad).reshape(values.shape)


@cache
def _sections(share: float) -> Array:
    """The low-pass in sections of second order; ``share`` is its cut-off over half the sampling rate."""
    return np.asarray(scipy.signal.butter(ORDER, share, output="sos"))


def decimated(values: Array, factor: int) -> Array:
    """Every ``factor``-th sample of the zero-phase FIR-filtered values ``(N, …)``."""
    if factor == 1:
        return np.asarray(values, dtype=float)
    live, rows = decimated_columns(values, factor)
    result = np.zeros((rows.shape[1], len(live)))
    result[:, live] = rows.T
    return result.reshape(len(result), *np.shape(values)[1:])


def decimated_columns(values: Array, factor: int) -> tuple[np.ndarray, Array]:
    """Which columns of ``values (N, …)`` are not zero throughout ``(m,)``, and these decimated ``(r, M)``.

    Zeros, most of what acts on one joint and half of a regressor, stay what they are without being filtered.
    """
    columns = np.asarray(values, dtype=float).reshape(len(values), -1).T
    live = not_zero(columns)
    rows = np.ascontiguousarray(columns[live])
    return live, rows if factor == 1 else np.asarray(_thinned_out(rows, decimation_taps(factor), factor))


# Sums in any order: the compiler takes several products at a time.
@jit(fastmath={"reassoc", "contract"})
def _thinned_out(rows: Array, taps: Array, factor: int) -> Array:
    """``y_m = Σ_j h_j x_{mf - 10f + j}`` of rows ``(r, N)``, zero beyond their ends, as scipy's ``resample_poly``."""
    N, reach = rows.shape[1], len(taps) // 2
    count = -(-N // factor)
    out = np.empty((len(rows), count))
    for r in range(len(rows)):
        for m in range(count):
            start = m * factor - reach
            first = max(0, -start)
            weights = taps[first : min(len(taps), N - start)]
            x = rows[r, start + first : start + first + len(weights)]
            total = 0.0
            for j in range(len(weights)):
                total += weights[j] * x[j]
            out[r, m] = total
    return out


@cache
def decimation_taps(factor: int) -> Array:
    """Hamming-windowed low-pass with half power at the new half sampling rate: what ``scipy.signal.decimate`` uses."""
    return np.asarray(scipy.signal.firwin(20 * factor + 1, 1.0 / factor, window="hamming"))


def chosen_cutoff(q: Array, dt: float) -> float:
    """Cut-off of the position filter [Hz] from the data: ten times the bandwidth of the motion.

    The bandwidth holds 99.9 % of a joint's velocity power; the median over joints counts. Ten times as much keeps
    what reversals of friction add. Never more than the noise allows (where the acceleration still stands clear of
    the noise floor), nor a fifth of the sampling rate, where central differences lose a tenth of the amplitude.
    """
    rate = 1.0 / dt
    qd = np.gradient(q, dt, axis=0)
    f, power = scipy.signal.welch(qd, fs=rate, nperseg=min(len(q), max(256, int(4.0 * rate))), axis=0)
    moves = np.std(qd, axis=0) > 1e-2 * np.max(np.std(qd, axis=0))
    share = np.cumsum(power[:, moves], axis=0) / np.sum(power[:, moves], axis=0)
    bandwidth = float(np.median(f[np.argmax(share > 0.999, axis=0)]))
    # White position noise is flat in position and grows with f^4 in acceleration.
    level = power[1:, moves] / (2.0 * np.pi * f[1:, None]) ** 2
    floor = np.median(level[f[1:] > 0.35 * rate], axis=0)
    clear = f[1:][np.any(level > 10.0 * floor, axis=1)]
    noise_limit = float(clear[-1]) if len(clear) else rate
    return float(np.clip(10.0 * bandwidth, 2.0, max(2.0, min(noise_limit, 0.2 * rate))))


def _kept(hole: np.ndarray, factor: int, edge: int) -> np.ndarray:
    bad = hole.copy()
    if hole.any():
        bad = np.convolve(hole, np.ones(2 * edge + 1), mode="same") > 0
    bad[:edge] = True
    bad[len(bad) - edge :] = True
    return ~bad[::factor]
