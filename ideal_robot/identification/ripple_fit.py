"""Torque ripple of the motors, from the slow parts of a recording.

Cogging and gear meshing repeat a whole number of times per motor turn, so with known gear ratios only amplitude and
phase of a few orders are asked for, and those are linear:

    τ - τ_model = Σ_o a_o cos(o i q) + b_o sin(o i q) + what friction is wrong by ,   i gear ratio, o = 1, 2, …

Only slow motion counts: there the controller answers the ripple completely, and what the current shows is the ripple.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import butter, filtfilt

from ideal_robot.arrays import Array
from ideal_robot.effects import EffectParameter, FittedEffect
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

_ORDERS = tuple(range(1, 9))
_FREQUENCY = (0.3, 6.0)
"""Ripple frequencies that count [Hz]: slower is friction's, faster is not answered by the controller."""
_CUTOFF = 25.0
"""Low-pass of angles before they are differentiated [Hz]."""
_EDGE = 50
_SIGNIFICANT = 8.0
"""A ripple counts when it is this many standard deviations large."""


def fit_ripple(recordings: Sequence[Recording], model: Model, robot: Robot) -> tuple[FittedEffect, ...]:
    """Ripple of every joint that shows one, strongest order first, as effects ``torque_ripple`` of the model.

    Args:
        recordings: with ``q_i`` and ``tau_i`` every few milliseconds, slow motion in them.
        model: what the ripple is looked for behind.
        robot: gear ratios; joints with ratio 1 (unknown) are passed over.

    Raises:
        InputError: the model is of another arm.
    """
    model.require_arm(robot)
    parts = [_residual(recording, model) for recording in recordings]
    found: list[FittedEffect] = []
    for i in range(model.n):
        if robot.gear_ratio[i] <= 1.0:
            continue
        for order in _ORDERS:
            effect = _fitted(parts, i, order, float(robot.gear_ratio[i]))
            if effect is not None:
                found.append(effect)
    return tuple(found)


def _residual(recording: Recording, model: Model) -> tuple[Array, Array, Array]:
    """Angles, velocities and unexplained torques ``(N, n)``."""
    cycle = float(np.median(np.diff(recording.t)))
    low_pass = butter(4, min(0.9, 2 * _CUTOFF * cycle))
    q, tau = (np.asarray(filtfilt(*low_pass, recording.joints(name), axis=0)) for name in ("q", "tau"))
    qd = np.gradient(q, cycle, axis=0)
    left = tau - model.inverse_dynamics(q, qd, np.gradient(qd, cycle, axis=0), t=recording.t - recording.t[0])
    inner = slice(_EDGE, -_EDGE)
    return q[inner], qd[inner], left[inner]


def _fitted(parts: Sequence[tuple[Array, Array, Array]], i: int, order: int, ratio: float) -> FittedEffect | None:
    k = order * ratio
    rows, values = [], []
    for q, qd, left in parts:
        frequency = k * np.abs(qd[:, i]) / (2 * np.pi)
        slow = (frequency > _FREQUENCY[0]) & (frequency < _FREQUENCY[1])
        v = qd[slow, i]
        rows.append(np.column_stack([np.cos(k * q[slow, i]), np.sin(k * q[slow, i]), np.sign(v), v, np.ones(len(v))]))
        values.append(left[slow, i])
    H, y = np.concatenate(rows), np.concatenate(values)
    if len(y) < 500:
        return None
    x, _, rank, _ = np.linalg.lstsq(H, y, rcond=None)
    if rank < H.shape[1]:
        return None
    rest = y - H @ x
    # Filtered samples are not independent: as many as the band has room for count.
    independent = max(len(y) * 0.1, 10.0)
    std = np.sqrt(np.diag(np.linalg.inv(H.T @ H / len(y))) * float(rest @ rest) / len(y) / independent)
    size, sigma = float(np.hypot(x[0], x[1])), float(np.hypot(std[0], std[1]))
    if size < _SIGNIFICANT * sigma:
        return None
    return FittedEffect(
        "torque_ripple", i + 1, f"tau_{i + 1}", (float(x[0]), float(x[1])), (float(std[0]), float(std[1])), (k,),
        theta_std=(0.0,),
        parameters=(EffectParameter("amplitude", size, sigma, "N m"),
                    EffectParameter("order", float(order), 0.0, "1 / motor turn")),
        evidence={"standard_deviations": size / sigma, "how": "regression on slow motion"})
