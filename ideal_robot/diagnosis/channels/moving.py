"""Which samples of a recording count: those at which a joint moves, apart from its reversals and from the ends."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import FilteredSignals
from ideal_robot.signals.recording import Recording

_SLOW = 0.004
"""Share of its top speed below which a joint rests or touches zero. If that takes longer than a period of the position
filter's cut-off, friction hangs on a direction that the filter has blurred, and those samples do not count."""
_BRISTLES = 0.003
"""Travel since a reversal or rest that does not count [rad or m]: three times the millimetre or milliradian over which
the bristles of a drive yield."""
_BRISTLES_SHARE = 0.01
"""The same as a share of the range of a joint that moves little."""
_EDGE = 3.0
"""Memory of the position filter in periods of its cut-off; effects differentiate the load, which it made, once more."""


def moving_samples(t: Array, q: Array, qd: Array, v_small: Array, rest: float,
                   robot: Robot) -> tuple[Array, dict[int, str]]:
    """Samples at which each joint moves ``(N, n)``, and joints that move too little, with the reason.

    Args:
        t: times ``(N,)`` [s], evenly spaced.
        q: positions ``(N, n)`` [rad or m].
        qd: velocities ``(N, n)`` [rad/s or m/s].
        v_small: velocities below which the direction is lost in noise ``(n,)`` [rad/s].
        rest: passages through low speed shorter than that count as motion [s].
        robot: which joints slide.
    """
    dt = float(t[1] - t[0])
    moving = np.ones(q.shape, dtype=bool)
    undecided: dict[int, str] = {}
    for j in range(q.shape[1]):
        speed = np.abs(qd[:, j])
        slow = speed < np.maximum(2.0 * v_small[j], _SLOW * np.percentile(speed, 99))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], slow.astype(int), [0]])))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if (stop - start) * dt > rest:
                moving[start:stop, j] = False
        seconds = float(np.sum(moving[:, j]) * dt)
        travel = float(np.ptp(q[:, j]))
        turns = int(np.sum(np.diff(np.sign(qd[moving[:, j], j])) != 0))
        noise_travel = 20.0 * v_small[j] * dt
        if seconds < 2.0 or travel < max(noise_travel, 0.004 if robot.prismatic[j] else 0.02):
            unit = "m" if robot.prismatic[j] else "rad"
            undecided[j + 1] = (f"moves only {seconds:.1f} s over {travel:.2g} {unit}; "
                                "at least 2 s and 0.02 rad (4 mm) are needed")
        elif turns < 2:
            undecided[j + 1] = f"reverses {turns} times; at least two reversals tell friction from gravity and offset"
    return moving, undecided


def apart_from_reversals(q: Array, qd: Array, moving: np.ndarray, width: float, dt: float) -> np.ndarray:
    """Mask ``(N, n)`` of moving samples apart from each change of direction and each rest, in time and in travel.

    How friction goes through zero there is another matter in every drive, and no cause may be built on it. Filters
    remember it for a time, bristles for a travel, which slow motion is long in covering.

    Args:
        q: positions ``(N, n)`` [rad or m].
        qd: velocities ``(N, n)`` [rad/s or m/s].
        moving: samples at which each joint moves ``(N, n)``.
        width: time left out to either side [s].
        dt: between samples [s].
    """
    near = ~moving
    change = np.diff(np.sign(qd), axis=0) != 0
    near[:-1] |= change
    near[1:] |= change
    half = max(1, round(width / dt))
    apart = ~ndimage.maximum_filter1d(near, 2 * half + 1, axis=0, mode="nearest")
    last = np.maximum.accumulate(np.where(near, np.arange(len(q))[:, None], 0), axis=0)
    travel = np.abs(q - np.take_along_axis(q, last, axis=0))
    return np.asarray(apart & (travel > np.minimum(_BRISTLES, _BRISTLES_SHARE * np.ptp(q, axis=0))))


def apart_from_ends(filtered: FilteredSignals) -> np.ndarray:
    """Mask ``(N,)`` without what the position filter does not know at both ends; at most a tenth is left out."""
    t = filtered.t_decimated
    first, last = float(filtered.t[0]), float(filtered.t[-1])
    edge = min(_EDGE / filtered.cutoff, 0.05 * (last - first))
    return np.asarray((t > first + edge) & (t < last - edge))


def small_velocity(recording: Recording, filtered: FilteredSignals) -> Array:
    """Velocity below which its sign is not known ``(n,)``: twice the noise that the position filter lets through."""
    raw = np.column_stack([np.interp(filtered.t, recording.t, recording.columns[f"q_{j + 1}"])
                           for j in range(recording.n)])
    noise = np.std(np.diff(raw, 3, axis=0), axis=0) / np.sqrt(20.0)
    # White position noise through the low-pass, differentiated: integral of (2 pi f)^2 up to the cut-off.
    share = 2.0 * np.pi * filtered.cutoff * np.sqrt(2.0 * filtered.cutoff * filtered.dt / 3.0)
    top = np.percentile(np.abs(filtered.qd), 99, axis=0)
    return np.maximum(np.minimum(2.0 * noise * share, 0.02 * top), 1e-4 * top + 1e-9)
