"""Chooses filters by held-out error: the cut-off with which a linear model predicts torque best.

Every candidate filters positions at its cut-off and is fitted to the torque below half of it. All are compared in the
same way: in one band of the torque that does not depend on the candidate, on blocks of time that the fit has not seen.
Encoder steps and jittering stamps, which look like motion in a spectrum, only make such a prediction worse.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, signal

from ideal_robot.arrays import Array
from ideal_robot.signals.filters import decimated, decimation_taps, filtered_at, lowpass, not_zero
from ideal_robot.signals.preprocess import EvenSignals, FilteredSignals, evenly_sampled
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import resampled, uniform_time

CANDIDATES = (4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 80.0)
"""Cut-offs that are tried [Hz]; those above a fifth of the sampling rate, or far above the band of judgement, are
left out."""

Columns = Callable[[FilteredSignals, int], Array]
"""Makes the observation matrix ``(K, n, P)`` of signals at samples so many apart, without what is too quick for samples
so far apart; filtered soonest where the samples of an element are neighbours in memory."""

_FOLDS = 8
"""Stretches of the recordings, each held back once."""
_LONGEST = 60.0
"""Seconds of all recordings together that the choice looks at."""
_SHORTEST = 15.0
"""Seconds of a recording that it looks at, at least: the slowest filters lose one or two at each end and hole."""
_FINE = 6.0
"""Samples a period of the cut-off that distinguish candidates: errors are within 0.3 % of those of all samples."""
_WORSE = 1.15
"""Candidates beyond one whose error is this many times the best are not tried any more."""
_BEYOND = 8.0
"""What a filter lets pass this many times above the band of judgement does not show in it."""
_AS_GOOD = 1.04
"""Candidates whose error is within this factor of the least are as good as the best."""
_FLAT = 3.0
"""A filter with its cut-off this many times above the band is flat in it; what it lets pass beyond is of no use."""
_BANDWIDTHS = 10.0
"""The band of judgement in bandwidths of the motion: what reversals of friction add lies within."""
_SLOW, _FAST = 2.0, 10.0
"""Limits of the band of judgement [Hz]."""
_REMEMBERED = 3.0
"""Periods of the band after which its filter has forgotten all but a thousandth."""
_SURE = 1e-4
"""Pivots of scaled normal equations from which on they are solved as they stand."""


@dataclass(frozen=True)
class CutoffChoice:
    """The filters with the best prediction, and the errors of the others.

    Attributes:
        cutoff: of the positions [Hz].
        cutoff_decimation: of torque and columns in the fit [Hz].
        band: frequency band in which all candidates were compared [Hz].
        errors: held-out error of each candidate, geometric mean over joints of std(residual) / std(torque).
        limit: ``lower`` or ``upper`` where the choice is the first or last candidate, empty otherwise.
    """

    cutoff: float
    cutoff_decimation: float
    band: float
    errors: dict[float, float]
    limit: str = ""

    @property
    def warning(self) -> str:
        """A named warning where the choice stands at a limit, empty otherwise."""
        if not self.limit:
            return ""
        why = ("still slower filters might predict better; the motion may be too slow to tell" if self.limit == "lower"
               else "a faster one might predict better; a higher sampling rate would be needed, or give --cutoff")
        return (f"cutoff-at-limit: the position filter of {self.cutoff:g} Hz is the {self.limit} limit of the choice; "
                f"{why}")


def choose_cutoff(recordings: Sequence[Recording], columns: Columns, *, start: Array,
                  information: Array) -> CutoffChoice:
    """The cut-off with the least held-out error; of equally good ones, the lowest that is flat in the band.

    Args:
        recordings: with ``q_i`` and ``tau_i``; a channel whose torque is NaN throughout is not used.
        columns: the model's observation matrix.
        start, information: prior mean of the parameters ``(P,)``, and its inverse covariance.
    """
    # Only a few of many recordings, evenly spread, so that each provides enough seconds.
    some = np.linspace(0, len(recordings) - 1, min(len(recordings), int(_LONGEST / _SHORTEST))).astype(int)
    parts = [_first(recordings[i], _LONGEST / len(some)) for i in some]
    rate = min(1.0 / _step(r) for r in parts)
    band = min(float(np.median([motion_band(r) for r in parts])), 0.1 * rate)
    even = [evenly_sampled(r, columns=False) for r in parts]
    usable = [c for c in CANDIDATES if c <= min(0.2 * rate, _BEYOND * band)] or [0.2 * rate]
    # For a short recording only the faster filters are usable; if none is, the last reports the error.
    usable = [c for c in usable if all(signals.long_enough(c) for signals in even)] or usable[-1:]
    errors: dict[float, float] = {}
    under = [_Judged(signals, columns, band, usable[0]) for signals in even]
    for cutoff in usable:
        moved = [recording.moved(cutoff) for recording in under]
        held = np.any([not_zero(m.elements) for m in moved], axis=0)
        fits, judged = zip(*[recording.rows(m, held) for recording, m in zip(under, moved, strict=True)], strict=True)
        errors[cutoff] = _held_out(fits, judged, held.reshape(-1, len(start)), start, information)
        if errors[cutoff] > _WORSE * min(errors.values()):
            break
    best = min(errors.values())
    good = [c for c, error in errors.items() if error <= _AS_GOOD * best]
    cutoff = min(good, key=lambda c: abs(np.log(c / (_FLAT * band))))
    limit = ""
    if len(usable) > 1 and len(good) < len(usable):
        limit = "lower" if good[-1] == usable[0] else "upper" if good[0] == usable[-1] else ""
    return CutoffChoice(cutoff, 0.5 * cutoff, band, errors, limit)


def motion_band(recording: Recording) -> float:
    """The band of the comparison [Hz]: ten times the frequency below which 90 % of the velocity's power lies.

    Not more than 90 %, as differentiated noise is a large part of the rest.
    """
    grid, _ = uniform_time(recording)
    dt = float(grid[1] - grid[0])
    q = resampled(recording.t, recording.joints("q"), grid, smooth=True)
    slow = lowpass(q, dt, min(_FAST, 0.2 / dt))
    # Fastest with the samples of a joint contiguous in memory.
    f, by_joint = signal.welch(np.ascontiguousarray(np.gradient(slow, dt, axis=0).T), fs=1.0 / dt,
                               nperseg=min(len(q), int(8.0 / dt)))
    power = by_joint.T
    moves = np.ptp(slow, axis=0) > 1e-2 * np.max(np.ptp(slow, axis=0))
    share = np.cumsum(power[:, moves], axis=0) / np.maximum(np.sum(power[:, moves], axis=0), 1e-300)
    return float(np.clip(_BANDWIDTHS * np.median(f[np.argmax(share > 0.9, axis=0)]), _SLOW, _FAST))


def _step(recording: Recording) -> float:
    grid, _ = uniform_time(recording)
    return float(grid[1] - grid[0])


def _first(recording: Recording, seconds: float) -> Recording:
    mask = recording.t <= recording.t[0] + seconds
    if mask.all():
        return recording
    return replace(recording, columns={name: np.ascontiguousarray(values[mask])
                                       for name, values in recording.columns.items()})


@dataclass(frozen=True)
class _Moved:
    """Signals under a cut-off, and the observation matrix's elements ``(n P, K)`` at samples ``stride`` apart."""

    signals: FilteredSignals
    stride: int
    elements: Array


@dataclass(frozen=True)
class _Rows:
    """Held elements of the regressor ``(E, M)``, torque ``(M, n)``, place in the recording ``(M,)``, 0 to 1."""

    elements: Array
    y: Array
    when: Array


class _Judged:
    """One recording under several cut-offs, judged in a band at the same instants."""

    def __init__(self, even: EvenSignals, columns: Columns, band: float, slowest: float) -> None:
        self._even = even
        self._columns, self._band = columns, band
        t, step = self._even.t, float(self._even.t[1] - self._even.t[0])
        # Away from the ends and from gaps by the memory of the slowest filter.
        edge = 1.0 / min(band, slowest)
        times = np.arange(t[0] + edge, t[-1] - edge, 0.25 / band)
        for instant in t[self._even.hole]:
            times = times[np.abs(times - instant) > edge]
        self._place, self._when = (times - t[0]) / step, (times - t[0]) / (t[-1] - t[0])
        reach = min(len(t) - 1, round(_REMEMBERED / (band * step)))
        self._kernel = lowpass(np.eye(1, 2 * reach + 1, reach)[0], step, band)
        self._y = self._below(self._even.tau, 1)

    def moved(self, cutoff: float) -> _Moved:
        """The motion under a cut-off."""
        s = self._even.filtered(cutoff)
        stride = max(1, int(1.0 / (s.dt * _FINE * max(cutoff, self._band))))
        W = self._columns(s, stride)
        return _Moved(s, stride, W.reshape(len(W), -1).T)

    def rows(self, moved: _Moved, held: np.ndarray) -> tuple[_Rows, _Rows]:
        """Rows to fit, below half the cut-off, and rows to judge, below the band, of the elements ``held (n P,)``."""
        s, stride, W = moved.signals, moved.stride, moved.elements[held].T
        places = np.flatnonzero(s.keep) * s.factor
        fitted = filtered_at(W, places / stride, decimation_taps(s.factor), fine=stride)
        fit = _Rows(fitted.T, s.decimate(s.tau), (s.t_decimated - s.t[0]) / (s.t[-1] - s.t[0]))
        return fit, _Rows(self._below(W, stride).T, self._y, self._when)

    def _below(self, values: Array, stride: int) -> Array:
        """Every ``stride``-th sample ``(K, …)``, below the band at the instants of judgement ``(M, …)``."""
        return filtered_at(values, self._place / stride, self._kernel, fine=stride, odd=True)


def thinned(s: FilteredSignals, stride: int) -> FilteredSignals:
    """Every ``stride``-th sample, as the motion has nothing above its cut-off; the torque is filtered first."""
    if stride == 1:
        return s
    stride = min(stride, s.factor)
    factor = max(1, s.factor // stride)
    keep = np.interp(s.t[:: stride][:: factor], s.t[:: s.factor], s.keep.astype(float)) > 0.999
    return replace(s, t=s.t[::stride], q=s.q[::stride], qd=s.qd[::stride], qdd=s.qdd[::stride],
                   tau=decimated(s.tau, stride), factor=factor, keep=keep, columns={})


def _held_out(fits: Sequence[_Rows], judged: Sequence[_Rows], held: np.ndarray, start: Array,
              information: Array) -> float:
    """Geometric mean over joints of the error on blocks of time that were left out; ``held (n, P)`` says of what."""
    W, y, block = _in_blocks(fits)
    judged_W, judged_y, judged_block = _in_blocks(judged)
    ends = np.concatenate([[0], np.cumsum(held.sum(axis=1))])
    joints = [(np.flatnonzero(columns), slice(first, last))
              for columns, (first, last) in zip(held, itertools.pairwise(ends), strict=True)]
    live = ~np.isnan(judged_y).any(axis=0) & (np.std(judged_y, axis=0) > 0)
    rest, judged_rest = (y - _times(W, joints, start))[:, live], (judged_y - _times(judged_W, joints, start))[:, live]
    joints = [joint for joint, counts in zip(joints, live, strict=True) if counts]
    noise = np.maximum(np.std(rest, axis=0), 1e-12)
    # Normal equations of each block and joint, once; the joints' weights come on top.
    grams, sides = np.zeros((len(joints), _FOLDS, *information.shape)), np.zeros((len(joints), _FOLDS, len(start)))
    for j, (columns, span) in enumerate(joints):
        for k in range(_FOLDS):
            part = W[span, block[k]]
            grams[j, k][np.ix_(columns, columns)] = part @ part.T
            sides[j, k, columns] = part @ rest[block[k], j]
    for _ in range(3):
        weight = 1.0 / noise**2
        A, b = np.tensordot(weight, grams, axes=1), np.tensordot(weight, sides, axes=1)
        p = _solved(A.sum(axis=0) + information, b.sum(axis=0))
        noise = np.maximum(np.std(rest - _times(W, joints, p), axis=0),
                           1e-9 * np.maximum(np.std(y[:, live], axis=0), 1e-12))
    error = np.empty_like(judged_rest)
    for k in range(_FOLDS):
        rows, training = judged_block[k], np.arange(_FOLDS) != k
        p = _solved(A[training].sum(axis=0) + information, b[training].sum(axis=0))
        error[rows] = judged_rest[rows] - _times(judged_W[:, rows], joints, p)
    ratio = np.sqrt(np.mean(error**2, axis=0)) / np.std(judged_y[:, live], axis=0)
    return float(np.exp(np.mean(np.log(np.maximum(ratio, 1e-9)))))


def _times(W: Array, joints: Sequence[tuple[np.ndarray, slice]], p: Array) -> Array:
    """Product of an observation matrix and parameters ``(M, n)``.

    Args:
        W: its elements that are not zero ``(E, M)``.
        joints: columns and elements of each joint.
        p: parameters.
    """
    return np.column_stack([p[columns] @ W[span] for columns, span in joints])


def _in_blocks(parts: Sequence[_Rows]) -> tuple[Array, Array, list[slice]]:
    """Elements and torque of all recordings, samples of a block of time together, and where each block is."""
    number = np.concatenate([(_FOLDS * np.clip(rows.when, 0.0, 1.0 - 1e-9)).astype(int) for rows in parts])
    W, y = parts[0].elements, parts[0].y
    if len(parts) > 1:
        order = np.argsort(number, kind="stable")
        W = np.concatenate([rows.elements for rows in parts], axis=1)[:, order]
        y, number = np.concatenate([rows.y for rows in parts])[order], number[order]
    ends = np.searchsorted(number, np.arange(_FOLDS + 1))
    return W, y, [slice(first, last) for first, last in itertools.pairwise(ends)]


def _solved(A: Array, b: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A / np.outer(size, size)
    factor, info = linalg.lapack.dpotrf(scaled, lower=True)
    if info == 0 and np.min(np.diag(factor)) > _SURE:
        return np.asarray(linalg.cho_solve((factor, True), b / size) / size)
    return np.asarray(np.linalg.lstsq(scaled, b / size, rcond=1e-12)[0] / size)
