"""Linear filters: the low-pass of positions and the decimation of torques."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy  # scipy.signal is large, so it is loaded where it is used

from ideal_robot.arrays import Array
from ideal_robot.jit import jit

ORDER = 4
"""Order of the Butterworth filter; run forwards and backwards it acts as twice that."""


def lowpass(values: Array, dt: float, cutoff: float) -> Array:
    """Zero-phase Butterworth low-pass along the first axis.

    Args:
        values, dt: ``(N, …)``, evenly spaced in time, and the time step [s].
        cutoff: [Hz].
    """
    sos = _sections(2.0 * cutoff * dt)
    # Padding as long as the filter's memory; the default is too short for low cut-offs.
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
    """Mask of the columns of ``values (N, …)`` that are not all zero ``(m,)``, and these decimated ``(r, M)``.

    Columns of zeros, which are half of a regressor, need no filtering.
    """
    columns = np.asarray(values, dtype=float).reshape(len(values), -1).T
    live = not_zero(columns)
    rows = np.ascontiguousarray(columns[live])
    return live, rows if factor == 1 else np.asarray(_thinned_out(rows, decimation_taps(factor), factor))


# The order of the sum is free, so that the compiler can vectorise it.
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
    """Hamming-windowed low-pass with half power at the new half sampling rate, as in ``scipy.signal.decimate``."""
    return np.asarray(scipy.signal.firwin(20 * factor + 1, 1.0 / factor, window="hamming"))


# A recursive filter run forwards and backwards over many columns at once, as ``scipy.signal.sosfiltfilt`` has it.
#
# The numbers are identical bit by bit and the speed is several times higher: steps depend on the one before, while
# columns are independent.

def forwards_and_backwards(sections: Array, values: Array, pad: int) -> Array:
    """Values ``(N, m)`` filtered forwards and backwards, without phase, along the first axis.

    Args:
        sections, values: second-order sections ``(S, 6)``; the values to filter.
        pad: samples by which the values are continued, turned about their first and last.
    """
    x = np.concatenate([2.0 * values[0] - values[pad:0:-1], values, 2.0 * values[-1] - values[-2 : -pad - 2 : -1]])
    x = np.ascontiguousarray(x)
    settled = scipy.signal.sosfilt_zi(sections)
    _run(sections, x, settled, False)
    _run(sections, x, settled, True)
    return x[pad : len(x) - pad]


@jit()
def _run(sections: Array, x: Array, settled: Array, backwards: bool) -> None:
    """Filters ``x (N, m)`` in place, from the state ``settled (S, 2)`` of a constant of the first value's size."""
    N, m = x.shape
    S = len(sections)
    first, second = np.empty((S, m)), np.empty((S, m))
    start = N - 1 if backwards else 0
    for s in range(S):
        for j in range(m):
            first[s, j], second[s, j] = settled[s, 0] * x[start, j], settled[s, 1] * x[start, j]
    for i in range(N):
        k = N - 1 - i if backwards else i
        for s in range(S):
            b0, b1, b2 = sections[s, 0], sections[s, 1], sections[s, 2]
            a1, a2 = sections[s, 4], sections[s, 5]
            for j in range(m):
                value = x[k, j]
                out = b0 * value + first[s, j]
                first[s, j] = b1 * value - a1 * out + second[s, j]
                second[s, j] = b2 * value - a2 * out
                x[k, j] = out


# Linear filters whose output is needed at few instants only: weighted sums of the samples around each.
#
# Outputs are products of matrices, block by block, which is several times as fast as sample by sample where few of the
# outputs are kept.

_BLOCK = 16
"""Outputs whose windows are taken together."""
_SAME = 1e-6
"""Instants closer than this, in samples, are the same."""


def filtered_at(values: Array, place: Array, kernel: Array, *, fine: int = 1, odd: bool = False) -> Array:
    """Values filtered at given places: ``y_m = Σ_k κ(k - place_m) x_k`` of ``values (K, …)``: ``(M, …)``.

    Args:
        values: evenly spaced in time; quickest where samples of an element are neighbours in memory.
        place: instants of the outputs in samples ``(M,)``, rising.
        kernel: κ, symmetric, at every ``1 / fine`` of a sample about its middle ``(2 L + 1,)``, linear in between. It
            is scaled so that constants are preserved.
        fine: entries of the kernel a sample.
        odd: goes on beyond the ends as the values turned about their first and last; else with zeros.
    """
    shape = np.shape(values)
    rows = np.asarray(values, dtype=float).reshape(shape[0], -1).T
    live = not_zero(rows)
    used = rows if live.all() else rows[live]
    out = np.empty((len(used), len(place)))
    known: dict[tuple[int, int], tuple[int, Array]] = {}
    for start in range(0, len(place), _BLOCK):
        block = place[start: start + _BLOCK]
        floor = int(np.floor(block[0]))
        # Evenly spaced outputs use the same weights, which are cached.
        even = len(block) == _BLOCK and np.ptp(np.diff(block)) < _SAME
        key = round((block[0] - floor) / _SAME), round((block[1] - block[0]) / _SAME) if even else -start
        if key not in known:
            known[key] = _weights(block - floor, kernel, fine)
        before, weight = known[key]
        first = floor + before
        last = first + len(weight)
        if odd and (first < 0 or last > shape[0]):
            weight = _folded(weight, first, shape[0])
        else:
            weight = weight[max(0, -first): len(weight) - max(0, last - shape[0])]
        out[:, start: start + _BLOCK] = used[:, max(0, first): min(shape[0], last)] @ weight
    if not live.all():
        result = np.zeros((len(rows), len(place)))
        result[live] = out
        out = result
    return out.T.reshape(len(place), *shape[1:])


def _weights(at: Array, kernel: Array, fine: int) -> tuple[int, Array]:
    """The first sample that a block of outputs at ``at (B,)`` looks at, and the weights from there on ``(T, B)``."""
    reach = len(kernel) // 2
    k = np.arange(int(np.ceil(at[0] - reach / fine)), int(np.floor(at[-1] + reach / fine)) + 1)
    # Samples are at whole numbers, so all have the same fraction between the kernel's entries.
    offset = at * fine
    whole = np.ceil(offset - _SAME).astype(int)
    share = np.maximum(whole - offset, 0.0)
    # Zero padding on both sides, as a block's window is wider than that of a single output.
    margin = fine * len(k)
    table = np.concatenate([np.zeros(margin), kernel, np.zeros(margin)])
    index = fine * k[:, None] - whole + reach + margin
    weight = (1.0 - share) * table[index] + share * table[index + 1]
    return int(k[0]), weight / weight.sum(axis=0)


def not_zero(rows: Array) -> np.ndarray:
    """Mask of the rows ``(m, N)`` that are not all zero."""
    mask = np.asarray(rows[:, rows.shape[1] // 2] != 0.0)
    for k in np.flatnonzero(~mask):
        mask[k] = rows[k].any()
    return mask


def _folded(weight: Array, first: int, count: int) -> Array:
    """Weights ``(T, B)`` of the samples from ``first`` on as weights of those there are; beyond: ``2 x_0 - x_{-k}``."""
    before, after = max(0, -first), max(0, first + len(weight) - count)
    inner = weight[before: len(weight) - after].copy()
    if before:
        beyond = weight[:before][::-1]
        inner[1: before + 1] -= beyond
        inner[0] += 2.0 * beyond.sum(axis=0)
    if after:
        beyond = weight[len(weight) - after:]
        inner[-1 - after: -1] -= beyond[::-1]
        inner[-1] += 2.0 * beyond.sum(axis=0)
    return inner
