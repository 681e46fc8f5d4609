"""The size of an effect: how much of it nothing in the model class can take, against what that class leaves anyway.

The model class is what an identification fits: rigid body with free inertial parameters, rotor, dry and viscous
friction and an offset of every joint. On the *healthy twin* (the same plant, motion, logger and noise without the
effect) it leaves a residual h below ``BAND``; on the recording with the effect it leaves e. The effect's own share is
rms(e - h). One times *visible* is a quarter of rms(h): a sixteenth of the squares that are left anyway. Where
a model is known before, its parameters come from another healthy recording and are not fitted again: then nothing is
absorbed, and the whole difference of the two torques counts.

Encoder steps, noise, jitter and lost rows are the same in both recordings, so they raise rms(h) and leave e - h alone.
Spikes are left out of the comparison: they cost weight, and a few of them must not hide what is plain to see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording

BAND = 12.0
"""[Hz] below which a model of an arm says anything; a third of the sampling rate where that is lower."""
SHARE = 0.25
"""Of the healthy residual's rms, one times visible."""
_ROWS = 1200


@dataclass(frozen=True)
class Reading:
    """A recording in the band: torque ``(M, n)``, and for every joint the columns ``(M, c)`` of the model class.

    Attributes:
        tau: ``(M, n)`` [N m].
        columns: of each joint.
        twist: arm angles less motor angles ``(M, n)``; NaN where they were not recorded.
    """

    tau: Array
    columns: tuple[Array, ...]
    twist: Array


def read(recording: Recording, model: pin.Model) -> Reading:
    """Filters a recording and computes the columns of the model class.

    Args:
        recording: as it was logged, spikes aside.
        model: kinematics.
    """
    n = recording.n
    rate = 1.0 / float(np.median(np.diff(recording.t)))
    t = np.arange(recording.t[0], recording.t[-1], 1.0 / rate)

    def uniform(name: str) -> Array:
        return np.column_stack([np.interp(t, recording.t, recording.columns[f"{name}_{j + 1}"]) for j in range(n)])

    q, tau = uniform("q"), uniform("tau")
    sos = signal.butter(4, min(BAND, rate / 3.0) * 2.0 / rate, output="sos")
    smooth = signal.sosfiltfilt(sos, q, axis=0)
    v = np.gradient(smooth, 1.0 / rate, axis=0)
    a = np.gradient(v, 1.0 / rate, axis=0)
    edge = int(0.5 * rate)
    rows = np.unique(np.linspace(edge, len(t) - edge - 1, _ROWS).astype(int))
    data = model.createData()
    body = np.array([pin.computeJointTorqueRegressor(model, data, smooth[k], v[k], a[k]) for k in rows])
    columns = []
    for j in range(n):
        dry = signal.sosfiltfilt(sos, np.tanh(v[:, j] / (0.005 * np.max(np.abs(v[:, j])) + 1e-9)))
        W = np.column_stack([body[:, j], a[rows, j], v[rows, j], dry[rows], np.ones(len(rows))])
        columns.append(W / (np.linalg.norm(W, axis=0) / np.sqrt(len(rows)) + 1e-9))
    twist = np.full((len(rows), n), np.nan)
    for j in range(n):
        if f"qa_{j + 1}" in recording.columns:
            bent = recording.columns[f"qa_{j + 1}"] - recording.columns[f"q_{j + 1}"]
            twist[:, j] = signal.sosfiltfilt(sos, np.interp(t, recording.t, bent))[rows]
    return Reading(signal.sosfiltfilt(sos, tau, axis=0)[rows], tuple(columns), twist)


def left(reading: Reading) -> Array:
    """Residual of the model class fitted to each joint by itself ``(M, n)`` [N m]."""
    return np.column_stack([y - W @ np.linalg.lstsq(W, y, rcond=1e-7)[0]
                            for y, W in zip(reading.tau.T, reading.columns, strict=True)])


def sizes(healthy: Reading, with_effect: Reading, absorbed: bool) -> Array:
    """Size of an effect in each joint's torque ``(n,)``, in multiples of what is visible.

    Args:
        healthy: of the twin.
        with_effect: of the recording.
        absorbed: whether the model class is fitted to the recording with the effect; else it is known before and
            the whole difference counts.
    """
    h, e = left(healthy), left(with_effect)
    level = np.sqrt(np.mean(h**2, axis=0))
    own = e - h if absorbed else with_effect.tau - healthy.tau
    return np.sqrt(np.mean(own**2, axis=0)) / (SHARE * level + 1e-12)


def twist_sizes(healthy: Reading, with_effect: Reading) -> Array:
    """The same for arm angles against motor angles ``(n,)``, 0 where they were not recorded.

    What bends on the healthy twin counts as what is left anyway, a constant aside.
    """
    result = np.zeros(healthy.twist.shape[1])
    for j in range(len(result)):
        h, e = healthy.twist[:, j], with_effect.twist[:, j]
        if np.isfinite(h).all() and np.isfinite(e).all():
            result[j] = float(np.std(e - h)) / (SHARE * float(np.std(h)) + 1e-9)
    return result
