"""A clamped recording as motor angles, motor torques and wrench on one clock, at a low common rate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.signal import butter, sosfiltfilt

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import WRENCH, Recording
from ideal_robot.tolerances import CLOCKS_APART

FILTER_HZ = 10.0
"""Cut-off of the Butterworth filter, [J] 4.3."""
FEWEST = 16
"""Rows that a filter of fourth order needs, forward and backward: more than the 3 (4 + 1) of its padding."""
DECIMATE_HZ = 5.0
"""Cut-off of the decimation filter, [J] 4.3; samples are kept at twice that."""


@dataclass(frozen=True)
class Clock:
    """The sensor's clock against the controller's: ``t = offset + (1 + drift) · t_wrench`` [s]."""

    offset: float
    drift: float


@dataclass(frozen=True)
class ClampedSignals:
    """One clamped recording, filtered and decimated to ``2 · DECIMATE_HZ``.

    Attributes:
        source: the file that the recording came from.
        t: time on the controller's clock ``(N,)`` [s].
        q_m: motor angles ``(N, n)`` [rad].
        tau: motor torques from current and data-sheet gain, [J] (9), ``(N, n)`` [N m], as recorded where no gain is
            known; in A where neither is; None if not recorded.
        wrench: F_e of the arm on the environment, tool frame ``(N, 6)`` [N, N m]; components that were not
            measured are zero ([J] 4.2); NaN rows where the sensor was silent; None if not recorded.
        measured: which components were measured.
        q_0: motor angles before contact ``(n,)`` [rad], where the Jacobian is taken, [J] (3).
        clamped: samples at which the flange is loaded, so that it certainly is at rest ``(N,)``.
        clock: estimated relation of the sensor's clock to the controller's.
    """

    source: str
    t: Array
    q_m: Array
    tau: Array | None
    wrench: Array | None
    measured: tuple[str, ...]
    q_0: Array
    clamped: NDArray[np.bool_]
    clock: Clock


def clamped_signals(recording: Recording, robot: Robot) -> ClampedSignals:
    """Filters, synchronises and decimates a clamped recording as [J] 4.3.

    Raises InputError for another joint count than the robot's, no torque and no wrench, or too short a recording.
    """
    if recording.n != robot.n:
        raise InputError(f"recording has {recording.n} joints, the robot {robot.n}", file=recording.source, field="q_i")
    t = recording.t
    q_raw = recording.joints("q")
    tau_raw = None
    if recording.has("current") and (robot.knows_drive_gains or not recording.has("tau")):
        tau_raw = recording.joints("current") * robot.drive_gain
    elif recording.has("tau"):
        tau_raw = recording.joints("tau")
    measured = tuple(name for name in WRENCH if name in recording.columns)
    if tau_raw is None and not measured:
        raise InputError("neither current_i nor tau_i nor a wrench (fx fy fz mx my mz) is recorded",
                         file=recording.source, field="current_i")
    lasts = float(t[-1] - t[0]) if len(t) else 0.0
    if lasts < 5.0 or len(t) < FEWEST:
        raise InputError(f"a clamped recording needs at least 5 s of force levels in {FEWEST} rows",
                         file=recording.source, field="t", value=f"{lasts:g} s in {len(t)} rows")
    rate = 1 / float(np.median(np.diff(t)))
    keep = np.arange(0, len(t), max(1, round(rate / (2 * DECIMATE_HZ))))
    q_m = lowpass(q_raw, rate)[keep]
    tau = None if tau_raw is None else lowpass(tau_raw, rate)[keep]
    clock, wrench = Clock(0.0, 0.0), None
    if measured:
        t_sensor, sensed = _sensor_series(recording, measured)
        if "t_wrench" in recording.columns:
            clock = synchronise(t[keep], q_m, t_sensor, sensed)
        wrench = np.zeros((len(keep), 6))
        columns = [WRENCH.index(name) for name in measured]
        wrench[:, columns] = _resampled(t[keep], clock.offset + (1 + clock.drift) * t_sensor, sensed)
    load = _load(tau, wrench)
    unloaded = np.argsort(load)[: max(5, len(load) // 50)]
    return ClampedSignals(recording.source, t[keep], q_m, tau, wrench, measured, q_m[unloaded].mean(axis=0),
                          load > 0.05, clock)


def lowpass(values: Array, rate: float) -> Array:
    """Zero-phase Butterworth at ``FILTER_HZ``, then at ``DECIMATE_HZ`` before decimation ([J] 4.3)."""
    for cut_off in (FILTER_HZ, DECIMATE_HZ):
        if cut_off < 0.45 * rate:
            values = sosfiltfilt(_butterworth(cut_off, round(rate, 6)), values, axis=0)
    return values


@cache
def _butterworth(cut_off: float, rate: float) -> Array:
    return np.asarray(butter(4, cut_off, fs=rate, output="sos"))


def _sensor_series(recording: Recording, measured: tuple[str, ...]) -> tuple[Array, Array]:
    t_sensor = recording.columns.get("t_wrench", recording.t)
    sensed = np.column_stack([recording.columns[name] for name in measured])
    good = np.isfinite(t_sensor) & np.all(np.isfinite(sensed), axis=1)
    if np.count_nonzero(good) < 50:
        raise InputError("fewer than 50 wrench samples", file=recording.source, field=measured[0])
    return t_sensor[good], sensed[good]


def _resampled(t: Array, t_sensor: Array, values: Array) -> Array:
    """Low-passed wrench ``(N, c)`` at times ``t``, filtered block by block between silences; NaN in the silences."""
    step = float(np.median(np.diff(t_sensor)))
    result = np.full((len(t), values.shape[1]), np.nan)
    for block in np.split(np.arange(len(t_sensor)), np.flatnonzero(np.diff(t_sensor) > 3 * step) + 1):
        if len(block) < 50:
            continue
        smooth = lowpass(values[block], 1 / step)
        inside = (t >= t_sensor[block[0]]) & (t <= t_sensor[block[-1]])
        for column in range(values.shape[1]):
            result[inside, column] = np.interp(t[inside], t_sensor[block], smooth[:, column])
    return result


def synchronise(t: Array, q_m: Array, t_sensor: Array, sensed: Array) -> Clock:
    """Offset and drift of the sensor's clock ([J] 4.3: synchronised off line).

    The flange does not move, so with the right clock the wrench is an affine function of the motor angles; the clock is
    the one that leaves the least of the wrench unexplained.

    Args:
        t, q_m: controller time ``(N,)`` [s], and motor angles ``(N, n)``.
        t_sensor, sensed: sensor time ``(M,)`` [s], and measured wrench components ``(M, c)``.
    """
    thin = max(1, round(0.1 / float(np.median(np.diff(t_sensor)))))
    t_thin, wrench = t_sensor[::thin], sensed[::thin]
    span = np.ptp(wrench, axis=0)
    wrench = wrench / np.where(span > 0, span, 1.0)
    # Joints that move together (one push) would make the regression singular, so principal motions are used.
    centred = q_m - q_m.mean(axis=0)
    U, s, _ = np.linalg.svd(centred, full_matrices=False)
    motions = U[:, s > 1e-3 * s[0]]
    motions = motions / np.max(np.abs(motions), axis=0)

    def unexplained(offset: float, drift: float) -> float:
        times = offset + (1 + drift) * t_thin
        inside = (times >= t[0]) & (times <= t[-1])
        if np.count_nonzero(inside) < 0.5 * len(times):
            return float("inf")
        index = np.clip(np.searchsorted(t, times[inside]), 1, len(t) - 1)
        share = ((times[inside] - t[index - 1]) / (t[index] - t[index - 1]))[:, None]
        W = (1 - share) * motions[index - 1] + share * motions[index]
        W, y = W - W.mean(axis=0), wrench[inside] - wrench[inside].mean(axis=0)
        # Principal motions are nearly orthogonal, so the normal equations are accurate enough.
        rho = y - W @ np.linalg.solve(W.T @ W, W.T @ y)
        return float(np.sum(rho * rho) / len(rho))

    coarse = np.arange(-CLOCKS_APART, CLOCKS_APART + 1e-9, 0.1)
    start = float(coarse[np.argmin([unexplained(offset, 0.0) for offset in coarse])])
    # Drift scaled so that a unit of either variable is a similar shift in time.
    length = max(float(t_sensor[-1] - t_sensor[0]), 1.0)
    best = minimize(lambda x: unexplained(x[0], x[1] / length), np.array([start, 0.0]), method="Nelder-Mead",
                    options={"initial_simplex": [[start, 0.0], [start + 0.08, 0.0], [start, 0.02]],
                             "xatol": 2e-4, "fatol": 1e-12, "maxfev": 200})
    return Clock(float(best.x[0]), float(best.x[1] / length))


def _load(tau: Array | None, wrench: Array | None) -> Array:
    """How hard the flange is loaded ``(N,)``, 0 … 1; NaN where the sensor was silent.

    What motors carry and the sensor shows in the first half second, without load, is gravity and bias.
    """
    first = round(DECIMATE_HZ)
    if wrench is not None:
        known = np.flatnonzero(np.all(np.isfinite(wrench), axis=1))
        signal = wrench - wrench[known[:first]].mean(axis=0)
        span = np.nanmax(np.abs(signal), axis=0)
        load = np.max(np.abs(signal) / np.where(span > 0.1 * np.max(span[:3]), span, np.inf), axis=1)
    else:
        assert tau is not None
        signal = tau - tau[:first].mean(axis=0)
        load = np.linalg.norm(signal, axis=1)
    return load / np.nanmax(load)
