"""Stiffness and damping of the gears from a motion that an external device watched ([L] 3.3, first case).

The controller knows the motor angles q, the device gives the arm angles q_a, the model the torque the gears carry:

    q - q_a + (d/k) (q̇ - q̇_a) = τ_g / k + c

The constant c takes up how the two were zeroed. The device is needed for this once, never while the arm works.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, filtfilt

from ideal_robot.errors import InputError
from ideal_robot.interface import Array
from ideal_robot.model import Model
from ideal_robot.recording import Recording

_CUTOFF = 8.0
"""Deflections are compared below this frequency [Hz]; the gears' own oscillations are above."""
_EDGE = 50
"""Samples at either end that the filters spoil."""


@dataclass(frozen=True)
class GearFit:
    """Gears of ``n`` joints.

    Attributes:
        stiffness: ``(n,)`` [N m/rad]; ``inf`` where the deflection is not told apart from the device's noise.
        damping: ``(n,)`` [N m s/rad], not below 0.
        stiffness_std: ``(n,)`` [N m/rad].
    """

    stiffness: Array
    damping: Array
    stiffness_std: Array


def fit_gears(model: Model, recording: Recording) -> GearFit:
    """Fits the gears of every joint.

    Args:
        model: its rigid body gives the torque the gears carry.
        recording: with ``q_i`` and ``qa_i``, all joints moving.

    Raises:
        InputError: a column is missing or the recording is too short.
    """
    q, q_a, t = recording.joints("q"), recording.joints("qa"), recording.t
    if len(t) < 10 * _EDGE:
        raise InputError(f"needs at least {10 * _EDGE} samples", file=recording.source, field="t", value=len(t))
    cycle = float(np.median(np.diff(t)))
    low_pass = butter(4, min(0.9, 2 * _CUTOFF * cycle))

    def smoothed(x: Array) -> Array:
        return np.asarray(filtfilt(*low_pass, x, axis=0))

    arm = smoothed(q_a)
    speed = np.gradient(arm, cycle, axis=0)
    load = smoothed(model.rigid_body(arm, speed, np.gradient(speed, cycle, axis=0)))
    rate = np.gradient(load, cycle, axis=0)
    deflection = smoothed(q - q_a)
    n = recording.n
    stiffness, damping, std = np.full(n, np.inf), np.zeros(n), np.full(n, np.inf)
    inner = slice(_EDGE, -_EDGE)
    for i in range(n):
        # δ + (d/k) δ̇ = τ/k  ≈  δ = τ/k - (d/k) τ̇/k : the gear's own dynamics is far above the cut-off.
        H = np.column_stack([load[inner, i], -rate[inner, i], np.ones(len(load) - 2 * _EDGE)])
        scale = np.linalg.norm(H, axis=0)
        x, _, _, _ = np.linalg.lstsq(H / scale, deflection[inner, i], rcond=None)
        left = deflection[inner, i] - (H / scale) @ x
        # The filter leaves 2·cutoff·cycle of the samples independent.
        dof = max(len(H) * 2 * _CUTOFF * cycle - 3, 1.0)
        covariance = np.linalg.inv((H / scale).T @ (H / scale)) * (left @ left) / dof
        compliance, spread = x[0] / scale[0], np.sqrt(covariance[0, 0]) / scale[0]
        if compliance > 3 * spread:
            stiffness[i], std[i] = 1.0 / compliance, spread / compliance**2
            damping[i] = max(0.0, x[1] / scale[1] / compliance**2)
    return GearFit(stiffness, damping, std)
