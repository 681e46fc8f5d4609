"""From a raw recording to signals a least-squares fit can use ([J] 3).

Position is low-passed without phase, velocity and acceleration are central differences of it, and the torque and every
column of the regressor go through the same decimation filter ("parallel decimation"), which removes frequencies that
the model does not explain. Both cut-offs are chosen from the data unless given.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.signals.filters import decimated, decimation_taps, filtered_at, lowpass
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import on_its_clock, resampled, uniform_time

_FINE = 10.0
"""Samples a period of the cut-off that are enough for motion below it."""
_MINIMUM_SAMPLES = 100  # ten times the least number of samples
_FEWEST = 10
"""Samples that have to be left after filtering and decimation."""


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
        source: the file that the recording came from.
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
        """Stride of samples that suffices for the motion, which has nothing above its cut-off."""
        return max(1, min(int(1.0 / (self.dt * _FINE * self.cutoff)), self.factor // 5))

    def decimate_motion(self, columns: Callable[[slice], Array], block: int = 20_000) -> Array:
        """As ``decimate``, for smooth functions of the motion, computed block by block at every ``stride``-th sample.

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
        """Gear temperatures ``(N, n)`` [°C]; zero for a joint without a sensor, None where no joint has one."""
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
    """A recording resampled to evenly spaced instants, not yet filtered.

    Attributes:
        t: ``(N,)`` [s].
        hole: mask ``(N,)`` of the instants at which nothing was recorded.
        q: positions ``(N, n)`` [rad].
        tau: motor torque ``(N, n)`` [N m]; NaN where the recording has none.
        source: the file that the recording came from.
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
        """Whether enough samples remain between ends and gaps for a cut-off [Hz] and a decimation at half of it."""
        return bool(self._thinning(cutoff, 0.5 * cutoff)[1].sum() >= _FEWEST)

    def _thinning(self, cutoff: float, wanted: float) -> tuple[int, np.ndarray]:
        """Factor of decimation, and which decimated samples are clear of ends and holes."""
        rate = 1.0 / float(self.t[1] - self.t[0])
        factor = max(1, round(0.5 * rate / wanted))
        # The ends of the recording have an influence as long as the memory of both filters.
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


def chosen_cutoff(q: Array, dt: float) -> float:
    """Cut-off of the position filter [Hz] from the data: ten times the bandwidth of the motion.

    The bandwidth has 99.9 % of a joint's velocity power; the median over joints is used. Ten times as much preserves
    reversals of friction. The cut-off is at most where the acceleration exceeds the noise floor, and at most a fifth of
    the sampling rate, where central differences lose a tenth of the amplitude.
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
