"""Sampling instants: jitter of stamps or of sampling, resampling, and excerpts of long recordings."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy import interpolate, ndimage

from ideal_robot.arrays import Array, interpolated
from ideal_robot.errors import InputError
from ideal_robot.row_log import let_go
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.recording import Recording

# Stamps that jitter about regular instants of sampling, and the instants behind them.
#
# A logger that samples by a clock and stamps late gives positions that are smooth over the sample number and rough over
# the stamps; one that samples irregularly and stamps accurately gives the opposite. The positions decide.

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
    # The clock's step is the mean of ordinary steps, without lost rows, whatever the jitter.
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
    """Distance of every second sample ``(N, n)`` from a smooth curve through the others, fastest joints first."""
    moved = np.median(np.abs(interpolate.CubicSpline(t[::2], q[::2], axis=0)(t[1::2]) - q[1::2])[2:-2], axis=0)
    return float(np.sqrt(np.mean(moved**2)))


def on_its_clock(recording: Recording) -> Recording:
    """The recording with estimated sampling instants as stamps, or unchanged."""
    t, jitter = regular_stamps(recording.t, recording.joints("q"))
    return replace(recording, columns={**recording.columns, "t": np.ascontiguousarray(t)}) if jitter else recording


# Repairs stamps that do not rise: a few bad ones, or stamps with fewer digits than the sampling clock.

LONGEST_PAUSE = 600.0
"""Longest time between two samples [s]; the clock was set, or two recordings joined, where it is longer."""
_MOST_BAD = 0.05
"""Share of stamps that are a handful: more are not left out."""
_TIES = 0.2
"""Share of stamps equal to the one before from which on the stamps are coarser than the sampling."""


def rising_stamps(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with rising stamps, and the changes; unchanged where they cannot be repaired.

    Recordings one after another, each with a clock of its own, are joined with a pause between them. A few samples with
    falling stamps are removed; of two with the same stamp the one that does not fit the motion. Stamps of too few
    digits, many of them alike, are put on a clock: an even one, or one that spreads the samples of a stamp evenly,
    whichever the positions are smoother over.
    """
    t = recording.t
    if len(t) < 2 or not np.all(np.isfinite(t)):
        return recording, []
    steps = np.diff(t)
    if np.all(steps > 0.0) and np.max(steps) <= LONGEST_PAUSE:
        return recording, []
    ties = float(np.mean(steps == 0.0))
    if ties >= _TIES and np.all(steps >= 0.0) and np.count_nonzero(steps) > WINDOW:
        quantum = float(np.median(steps[steps > 0.0]))
        even, spread = _even_clock(t, quantum), _spread(t)
        q = recording.joints("q")
        clock = even if even is not None and roughness(even, q) <= roughness(spread, q) else spread
        step = float(np.median(np.diff(clock)))
        how = "an even clock, with which the positions agree" if clock is even else "instants evenly between them"
        return (replace(recording, columns={**recording.columns, "t": np.ascontiguousarray(clock)}),
                [f"coarse-stamps: stamps come in steps of {1e3 * quantum:.3g} ms, samples every {1e3 * step:.3g} ms; "
                 f"they are put on {how}"])
    if (joined := _joined(recording)) is not None:
        return joined
    rising = _longest_rising(t)
    rising &= _together(t, rising)
    rising = _of_ties(t, recording.joints("q"), rising)
    bad = int((~rising).sum())
    if bad > _MOST_BAD * len(t):
        return recording, []
    first = int(np.argmax(~rising))
    return (replace(recording, columns={name: np.ascontiguousarray(values[rising])
                                        for name, values in recording.columns.items()}),
            [f"bad-stamps: {bad} samples whose stamps are not among the others' are left out (first: sample "
             f"{first + 1}, t = {t[first]:.6g} s)"])


def _joined(recording: Recording) -> tuple[Recording, list[str]] | None:
    """The recording with one clock for all of its parts, each of which has its own; None where it is not made so."""
    t, steps = recording.t, np.diff(recording.t)
    begins = np.concatenate([[0], np.flatnonzero((steps < 0.0) | (steps > LONGEST_PAUSE)) + 1])
    ends = np.concatenate([begins[1:], [len(t)]])
    parts = [t[begin:end] for begin, end in zip(begins, ends, strict=True)]
    if len(parts) < 2 or min(map(len, parts)) < WINDOW or any(np.any(np.diff(part) <= 0.0) for part in parts):
        return None
    shifts = _one_after_another(parts)
    shift = np.repeat(shifts, ends - begins)
    columns = {name: np.ascontiguousarray(values + shift) if name in _TIMES else values
               for name, values in recording.columns.items()}
    return replace(recording, columns=columns), [
        f"joined: the clock starts anew {len(parts) - 1} times, first at sample {begins[1] + 1}; the parts follow each "
        "other after a pause"]


def _even_clock(t: Array, quantum: float) -> Array | None:
    """An even clock ``(N,)`` that stays within a step of the stamps, or None where rows were lost."""
    number = np.arange(len(t))
    slope, start = np.polyfit(number, t - t[0], 1)
    clock = t[0] + start + slope * number
    return clock if np.max(np.abs(t - clock)) <= quantum else None


def _spread(t: Array) -> Array:
    """Samples of equal stamps spread evenly up to the next stamp ``(N,)``."""
    begins = np.concatenate([[0], np.flatnonzero(np.diff(t) > 0.0) + 1])
    usual = float(np.median(np.diff(t[begins])))
    ends = np.concatenate([begins[1:], [len(t)]])
    until = np.concatenate([np.minimum(t[begins[1:]], t[begins[:-1]] + 1.5 * usual), [t[-1] + usual]])
    width = np.repeat((until - t[begins]) / (ends - begins), ends - begins)
    return t + width * (np.arange(len(t)) - np.repeat(begins, ends - begins))


def _together(t: Array, rising: np.ndarray) -> np.ndarray:
    """Mask ``(N,)`` of the longest run of rising time stamps without a pause above ``LONGEST_PAUSE``."""
    places = np.flatnonzero(rising)
    parts = np.split(places, np.flatnonzero(np.diff(t[places]) > LONGEST_PAUSE) + 1)
    mask = np.zeros(len(t), dtype=bool)
    mask[max(parts, key=len)] = True
    return mask


def _longest_rising(t: Array) -> np.ndarray:
    """Mask ``(N,)`` of a longest rising subsequence: without the fewest stamps the others rise."""
    tails: list[float] = []
    places: list[int] = []
    before = np.full(len(t), -1)
    for k, value in enumerate(t.tolist()):
        at = bisect_left(tails, value)
        before[k] = places[at - 1] if at else -1
        tails[at : at + 1] = [value]
        places[at : at + 1] = [k]
    rising = np.zeros(len(t), dtype=bool)
    k = places[-1]
    while k >= 0:
        rising[k] = True
        k = int(before[k])
    return rising


def _of_ties(t: Array, q: Array, rising: np.ndarray) -> np.ndarray:
    """The mask ``rising (N,)`` with that one of neighbours with one stamp whose positions of ``q (N, n)`` are its."""
    begins = np.concatenate([[0], np.flatnonzero(np.diff(t)) + 1])
    ends = np.concatenate([begins[1:], [len(t)]])
    single = np.repeat(ends - begins == 1, ends - begins) & rising
    if np.count_nonzero(single) < WINDOW:
        return rising
    chosen, motion = rising.copy(), interpolate.CubicSpline(t[single], q[single], axis=0)
    for begin, end in zip(begins, ends, strict=True):
        if end - begin > 1 and rising[begin:end].any():
            off = np.linalg.norm(q[begin:end] - motion(t[begin]), axis=1)
            chosen[begin:end] = np.arange(end - begin) == np.argmin(off)
    return chosen


# Samples taken at irregular instants but stamped regularly: the instants are estimated from the motion.
#
# In a sample taken late by ``delta`` every joint is ahead by ``qd delta``. The common fast part of all joints'
# positions, in proportion to their speeds, is caused by the clock; the rest is vibration, friction or noise of a joint.
# Synchronous motion is common, too, but it is smooth, and a clock's jitter is not.

_MOTION = 5.0
"""Frequency above which positions hold more of a jitter of the clock than of the motion [Hz]."""
_SHARE = 0.5
"""Share of the fast part of the positions that the other joints have to foretell, for it to be the clock's."""
_SMOOTH = 0.5
"""Correlation of neighbouring samples' delays from which on it is motion of the joints in step, not the clock's."""
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

    The increasing stamps themselves and zero, unless the positions ``(N, n)`` of all joints show that the sampling
    itself was jittering.
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
    """The recording stamped with the sampling instants, and their standard deviation from the stamps; or unchanged."""
    q = recording.joints("q")
    t, spread = sampling_instants(recording.t, q)
    if spread == 0.0:
        return recording, 0.0
    # A regular clock that is smoother than the jittering stamps need not be the right one, so both are compared.
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
        """1/σ² of the residual of each joint's fast part ``(n,)`` with samples late by ``late (N,)``."""
        squares = self._size
        if late is not None:
            squares = squares - (2.0 * late @ self.product - late**2 @ self.squared) / len(late)
        return np.asarray(1.0 / np.maximum(squares, 1e-18))


def _common(of: _Products, without: int | None = None) -> Array:
    """The likeliest delay of each sample ``(N,)`` [s], by all joints, or all but ``without``.

    Little is said where no joint moves.
    """
    weights = of.precision()
    for _ in range(2):
        if without is not None:
            weights[without] = 0.0
        gain, raw = of.squared @ weights, of.product @ weights
        # The clock's jitter: the estimated one less the part caused by the samples' noise.
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


# Resampling to even instants.

_GAP = 5.0
"""A pause longer than this many sampling steps is a hole; nothing near it is trusted."""


def uniform_time(recording: Recording) -> tuple[Array, np.ndarray]:
    """A uniform time grid at the recording's median step, and a mask of grid points within gaps."""
    t = recording.t
    steps = np.diff(t)
    if len(steps) == 0 or np.any(steps <= 0):
        raise InputError("time must increase from sample to sample", file=recording.source, field="t")
    # The mean of ordinary steps, not the median, so that jittering stamps do not stretch the grid.
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
        grid, smooth: times of the result ``(M,)`` [s], and whether the values are free of noise.
    """
    if len(t) == len(grid) and np.allclose(t, grid, atol=1e-3 * (grid[1] - grid[0]), rtol=0.0):
        return np.array(values, dtype=float)
    if smooth:
        return np.asarray(interpolate.CubicSpline(t, values, axis=0)(grid))
    return interpolated(grid, t, values)


def gap_free(recording: Recording, prefixes: Sequence[str], fewest: int) -> list[Recording]:
    """The intervals between a recording's gaps, each at even instants; the recording itself if it is even.

    A gap is one of ``uniform_time``; shorter losses are interpolated. Raises InputError where a column is missing.

    Args:
        recording, prefixes: with ``t`` and ``q_i``, time increasing; the quantities of the joints that are needed.
        fewest: least number of samples of an interval, at least two; shorter ones are dropped.
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


# Excerpts of long recordings.

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
    """The recordings, or excerpts of each if they have more than ``MOST`` samples, and a warning about it."""
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
    """The recording, or excerpts of it joined to one if it has more than ``MOST`` samples, and a warning.

    The time between excerpts is removed: they follow each other after a pause, near which no samples are used.
    """
    parts, warnings = stretches([recording])
    if not warnings:
        return recording, []
    shifts = _one_after_another([part.t for part in parts])
    columns = {name: np.concatenate([part.columns[name] + (shift if name in _TIMES else 0.0)
                                     for part, shift in zip(parts, shifts, strict=True)])
               for name in recording.columns}
    for values in columns.values():
        values.setflags(write=False)
    return replace(recording, columns=columns), [f"{warnings[0]}; the time between them is taken out"]


def _one_after_another(parts: Sequence[Array]) -> list[float]:
    """What is added to the times of recordings, so that each follows the one before after a pause [s]."""
    shifts: list[float] = []
    end = 0.0
    for t in parts:
        step = float(t[-1] - t[0]) / max(len(t) - 1, 1)
        begin = end + max(_PAUSE, _STEPS * step) if shifts else float(t[0])
        shifts.append(begin - float(t[0]))
        end = float(t[-1]) + shifts[-1]
    return shifts


def _part(recording: Recording, start: int, rows: int) -> Recording:
    columns = {name: np.array(values[start : start + rows]) for name, values in recording.columns.items()}
    let_go(*recording.columns.values())
    for values in columns.values():
        values.setflags(write=False)
    t = columns["t"]
    return replace(recording, columns=columns, source=f"{recording.source} ({t[0]:.0f} to {t[-1]:.0f} s)")
