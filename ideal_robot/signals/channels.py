"""Checks channels before a fit: dead, quantised, clipped, or filtered before logging.

Each finding has a remedy. None changes the data; a dead channel is not fitted.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from ideal_robot.arrays import Array
from ideal_robot.signals.preprocess import FilteredSignals
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import regular_stamps, resampled, uniform_time

DEAD, STEPPED, CLIPPED, FILTERED, IRREGULAR = "dead", "stepped", "clipped", "filtered", "irregular-stamps"

_ZEROS = 0.6
"""A torque that is exactly zero in more of its samples than this does not measure the joint."""
_SHORTEST_BRAKED, _RARE = 10, 10.0
"""Samples of a run of exact zeros, and how many times the usual run of equal values it is as long, for brakes."""
_HELD = 1e-3
"""A joint that a brake holds stays within this [rad or m]."""
_RESTS = 0.2
"""Time within which a joint that stands stays where it is [s]: a drive at its limit moves it by more."""
_LEVELS = 8
"""Levels from which on the ends of a channel's range are limits; of fewer the ends are visited by rounding."""
_COARSE = 0.05
"""Steps of the torque count from this share of its standard deviation on."""
_COARSE_POSITION = 1e-4
"""Steps of a position count from here on [rad or m]."""
_AT_LIMIT = 0.005
"""Share of the samples at an end of a channel's range from which on it is cut off there."""
_SILENT = 1e-12
"""Power above a third of the sampling rate, relative to the largest, that no measured channel falls below by itself."""
_JITTER = 0.02
"""Spread of the time steps, over the usual one, from which on it is told."""


@dataclass(frozen=True)
class ChannelFinding:
    """A finding about one column.

    Attributes:
        kind: ``dead``, ``stepped``, ``clipped``, ``filtered`` or ``irregular-stamps``.
        column: e.g. ``tau_3``.
        joint: counted from 0; -1 for the time stamps.
        text: the finding and its remedy in one sentence.
    """

    kind: str
    column: str
    joint: int
    text: str

    @property
    def warning(self) -> str:
        """The named warning."""
        return f"{self.kind if self.joint < 0 else self.kind + '-channel'}: {self.text}"


def channel_findings(recording: Recording) -> tuple[ChannelFinding, ...]:
    """Findings about the stamps, positions and torques of a recording with ``t``, ``q_i`` and ``tau_i``."""
    notes = [*_stamps(recording)]
    tau, q = recording.joints("tau"), recording.joints("q")
    grid, _ = uniform_time(recording)
    rate = 1.0 / float(grid[1] - grid[0])
    edges = filtered_above(resampled(recording.t, tau, grid), rate)
    for j in range(recording.n):
        name, values = f"tau_{j + 1}", tau[:, j]
        zeros = float(np.mean(values == 0.0))
        if zeros > _ZEROS or np.ptp(values) == 0.0:
            how = f"is exactly zero in {100 * zeros:.0f} % of the samples" if zeros > _ZEROS else "never changes"
            notes.append(ChannelFinding(DEAD, name, j, f"{name} {how}; joint {j + 1} is left out, its friction and "
                                        "rotor stay unknown"))
            continue
        step = lattice(values)
        if step > _COARSE * np.std(values):
            notes.append(ChannelFinding(STEPPED, name, j, f"{name} comes in steps of {step:.3g}, "
                                        f"{100 * step / np.std(values):.0f} % of its standard deviation"))
        clipped = at_limits(values, step, stands(recording.t, q[:, j]))
        if clipped > _AT_LIMIT:
            notes.append(ChannelFinding(CLIPPED, name, j, f"{name} stands at its extreme value in {100 * clipped:.1f} "
                                        "% of the samples; the drive was at its limit, a slower motion avoids it"))
        edge = edges[j]
        if edge is not None:
            notes.append(ChannelFinding(FILTERED, name, j, f"{name} was filtered before it was logged: it holds "
                                        f"nothing above {edge:.2g} Hz; its lag would be taken for friction"))
        step = lattice(q[:, j])
        if step > _COARSE_POSITION:
            notes.append(ChannelFinding(STEPPED, f"q_{j + 1}", j, f"q_{j + 1} comes in steps of {step:.3g}; velocity "
                                        "and acceleration are as good as the position filter makes them"))
    return tuple(notes)


def dead_share() -> float:
    """Share of samples without a value above which a torque is treated as not measured."""
    return _ZEROS


def braked(recording: Recording) -> np.ndarray:
    """Mask ``(N, n)`` of samples at which a torque is exactly zero for some time while its joint is at rest.

    A torque that comes in steps is zero for a while by itself: only runs are used that are much longer than usual runs
    of equal values. A dead channel has none.
    """
    held = np.zeros((len(recording.t), recording.n), dtype=bool)
    for j in range(recording.n):
        tau, q = recording.columns[f"tau_{j + 1}"], recording.columns[f"q_{j + 1}"]
        zero = tau == 0.0
        if not 0.0 < zero.mean() <= _ZEROS:
            continue
        lengths = [(stop - start, start, stop) for start, stop in runs(np.cumsum(np.diff(tau, prepend=tau[0]) != 0.0))]
        usual = float(np.quantile([length for length, start, _ in lengths if not zero[start]] or [1], 0.99))
        for length, start, stop in lengths:
            if (zero[start] and length >= max(_SHORTEST_BRAKED, _RARE * usual)
                    and np.ptp(q[start:stop]) < _HELD):
                held[start:stop, j] = True
    return held


def dead_joints(findings: tuple[ChannelFinding, ...]) -> list[int]:
    """Joints, counted from 0, whose torque channel is dead."""
    return sorted({f.joint for f in findings if f.kind == DEAD})


def lattice(values: Array) -> float:
    """Step of the quantisation levels of values ``(N,)``, as an encoder's; 0 where they are not quantised."""
    levels = np.unique(values)
    span = levels[-1] - levels[0]
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * span] if span > 0 else gaps[:0]
    if len(gaps) < 5:
        return 0.0
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    places = gaps / step
    return step if np.mean(np.abs(places - np.round(places)) < 0.1) > 0.95 else 0.0


def stands(t: Array, q: Array) -> np.ndarray:
    """Mask ``(N,)`` of samples around which a joint is at rest, where a torque may stay at one level.

    Args:
        t, q: instants [s] and positions of the joint [rad or m] ``(N,)``.
    """
    half = max(1, round(0.5 * _RESTS / max(float(np.median(np.diff(t))), 1e-9)))
    width = 2 * half + 1
    still = maximum_filter1d(q, width) - minimum_filter1d(q, width) < _HELD
    # All samples of a window in which the joint is at rest.
    return np.asarray(maximum_filter1d(still.astype(np.uint8), width) > 0)


def at_limits(values: Array, step: float, still: np.ndarray | None = None) -> float:
    """Share of samples in runs of three or more at the largest or the smallest value ``(N,)``.

    With levels ``step`` apart, an extreme level is a limit only if it is more frequent than the next one.

    Args:
        values, step: of a torque, and the step that it comes in.
        still: samples with the joint at rest ``(N,)``, which are not used; None for none.
    """
    moves = np.ones(len(values), dtype=bool) if still is None else ~still
    return float(sum(np.mean(top[:-2] & top[1:-1] & top[2:]) for top in _limits(values, step, moves)))


def clipped(values: Array, still: np.ndarray | None = None) -> np.ndarray:
    """Mask ``(N,)`` of samples at a limit, if a channel ``(N,)`` reaches it often enough to be clipped there.

    Args:
        values, still: see ``at_limits``.
    """
    step = lattice(values)
    if at_limits(values, step, still) <= _AT_LIMIT:
        return np.zeros(len(values), dtype=bool)
    moves = np.ones(len(values), dtype=bool) if still is None else ~still
    return np.any(list(_limits(values, step, moves)), axis=0)


def _limits(values: Array, step: float, moves: np.ndarray) -> Iterator[np.ndarray]:
    """Yields the samples ``(N,)`` that stand at a limit while the joint ``moves``, for each side that has one."""
    if len(np.unique(values[: 20 * _LEVELS])) <= _LEVELS and len(np.unique(values)) <= _LEVELS:
        return
    for side in (values, -values):
        top = (side >= side.max()) & moves
        below = (side < side.max()) & (side >= side.max() - 1.5 * step) & moves
        if top.sum() > 2 * below.sum():
            yield top


def filtered_above(values: Array, rate: float) -> list[float | None]:
    """Frequency above which each channel ``(N, n)``, sampled at ``rate`` [Hz], has no signal, not even noise [Hz].

    None if there is none, or where it cannot be computed: for a channel of zeros, or of numbers whose squares overflow.
    """
    f, spectra = signal.welch(np.ascontiguousarray(values.T), fs=rate, window="blackmanharris",
                              nperseg=min(len(values), 1024))
    edges: list[float | None] = []
    for power in spectra:
        largest = float(np.max(power[1:]))
        nothing = 0.0 < largest < np.inf and np.median(power[f > 0.35 * rate]) <= _SILENT * largest
        edges.append(float(f[np.flatnonzero(power > 1e-8 * largest)[-1]]) if nothing else None)
    return edges


def _stamps(recording: Recording) -> list[ChannelFinding]:
    steps = np.diff(recording.t)
    usual = float(np.median(steps))
    ordinary = steps[steps < 1.5 * usual]
    spread, lost = float(np.std(ordinary)), int(np.sum(steps > 1.5 * usual))
    if spread < _JITTER * usual and not lost:
        return []
    text = f"stamps are {1e3 * usual:.3g} ms apart with a spread of {1e3 * spread:.2g} ms"
    if lost:
        text += f", {lost} steps are longer than one and a half"
    _, jitter = regular_stamps(recording.t, recording.joints("q"))
    text += (f"; the positions were sampled regularly and stamped late: {1e3 * jitter:.2g} ms of jitter are taken out"
             if jitter else "; the positions agree with them and are brought to a uniform grid")
    return [ChannelFinding(IRREGULAR, "t", -1, text)]


@dataclass(frozen=True)
class Segment:
    """An interval of samples ``start … stop - 1`` of one joint.

    Attributes:
        joint: joint, counted from 0.
        kind: ``rest``, ``constant`` (velocity), ``reversal`` or ``other``.
        start, stop: sample range.
        velocity: mean velocity in it [rad/s].
    """

    joint: int
    kind: str
    start: int
    stop: int
    velocity: float


def moving(s: FilteredSignals) -> np.ndarray:
    """Mask ``(N, n)`` of joints in motion: faster than a hundredth of their own largest speed, and than 2 mrad/s."""
    fastest = np.max(np.abs(s.qd), axis=0)
    return np.asarray(np.abs(s.qd) > np.maximum(0.01 * fastest, 2e-3))


def segments(s: FilteredSignals) -> list[Segment]:
    """Cuts every joint's motion into segments.

    At rest or at constant velocity they last 0.08 s at least; constant means that the acceleration is below a twentieth
    of the joint's largest.
    """
    result, shortest = [], 0.08
    moves = moving(s)
    for j in range(s.q.shape[1]):
        steady = np.abs(s.qdd[:, j]) < 0.05 * max(float(np.max(np.abs(s.qdd[:, j]))), 1e-9)
        near = _near_reversal(s.qd[:, j], moves[:, j], round(shortest / s.dt))
        label = np.where(near, 2, np.where(~moves[:, j], 0, np.where(steady, 1, 3)))
        for start, stop in runs(label):
            kind = ("rest", "constant", "reversal", "other")[label[start]]
            if kind in ("rest", "constant") and (stop - start) * s.dt < shortest:
                kind = "other"
            result.append(Segment(j, kind, start, stop, float(np.mean(s.qd[start:stop, j]))))
    return result


def runs(label: np.ndarray) -> list[tuple[int, int]]:
    """Ranges ``(start, stop)`` of equal neighbouring values."""
    edges = np.flatnonzero(np.diff(label)) + 1
    return list(zip([0, *edges.tolist()], [*edges.tolist(), len(label)], strict=True))


def alone(s: FilteredSignals, joint: int) -> list[tuple[int, int]]:
    """Index ranges in which only this joint moves, from its first to its last motion between those of other joints."""
    moves = moving(s)
    busy = np.any(np.delete(moves, joint, axis=1), axis=1) if moves.shape[1] > 1 else np.zeros(len(s.t), dtype=bool)
    ranges = []
    for start, stop in runs(busy.astype(int)):
        if busy[start]:
            continue
        own = np.flatnonzero(moves[start:stop, joint])
        if len(own):
            ranges.append((start + int(own[0]), start + int(own[-1]) + 1))
    return ranges


def _near_reversal(qd: Array, moves: np.ndarray, width: int) -> np.ndarray:
    """Samples within ``width`` of a change of direction, standstills between two directions included."""
    sign = np.where(moves, np.sign(qd), 0.0)
    known = np.flatnonzero(sign)
    near = np.zeros(len(qd), dtype=bool)
    for a, b in itertools.pairwise(known.tolist()):
        if sign[a] != sign[b] and b - a <= 4 * width:
            near[max(0, a - width): b + width] = True
    return near
