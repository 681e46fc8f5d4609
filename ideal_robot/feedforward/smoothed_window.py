"""Motion and torque in the middle of a few cycles, smoothed by the same filter; behind gears the arm's motion.

Torque and acceleration must pass the same filter. A polynomial fitted to positions smooths its second derivative far
more than its value: at 4 Hz and 12 ms a tenth of the acceleration is missing that the torque still shows. Here every
signal is the same weighted mean of neighbours, the derivatives of central differences. What the second difference
averages over two cycles, the torque averages over with the weights 1, 10, 1 (exact for cubics).

The torque is the one that acts, less ripple, which acts as well and is read with the same gain g:

    τ_a = τ / g + τ_ext - τ_ripple(q)

The arm does not move as its motors do: behind a gear of compliance 1/k it lags by the gear's torque,

    q_a = q - (τ_a - J q̈ - F - τ_offset) / k

with the presliding state F (``ideal_robot.friction.presliding``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.friction.table import Friction, friction_step
from ideal_robot.jit import jit
from ideal_robot.loop.loop import Drives, ripple_torque

_MEAN = np.array([1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0]) / 64.0
"""Weights of the mean of neighbours."""
CYCLES = len(_MEAN) + 4
"""Cycles that are needed: one more on each side for the differences, and one for the motors' acceleration."""
# Interpolation of fourth order, first and second central difference, each of the mean of neighbours.
_VALUE = np.convolve(_MEAN, [1.0, 10.0, 1.0]) / 12.0
_SLOPE = np.convolve(_MEAN, [-1.0, 0.0, 1.0]) / 2.0
_BEND = np.convolve(_MEAN, [1.0, -2.0, 1.0])


class Window(NamedTuple):
    """The last measurements, the newest one last.

    Attributes:
        q, tau, force: motor angles [rad], torques that act [N m], presliding states [N m], ``(CYCLES, n)`` each.
        rows: number of rows that have been measured.
    """

    q: Array
    tau: Array
    force: Array
    rows: int

    @classmethod
    def empty(cls, n: int) -> Window:
        """Window of ``n`` joints without a measurement."""
        return cls(np.zeros((CYCLES, n)), np.zeros((CYCLES, n)), np.zeros((CYCLES, n)), 0)


class Smoothed(NamedTuple):
    """Smoothed signals in the middle of the window, ``(1, n)`` each.

    Attributes:
        q, v, a: of the arm [rad, rad/s, rad/s²].
        motor_v, motor_a: of the motors [rad/s, rad/s²].
        tau: torque that acts, less ripple [N m].
        force: presliding state [N m].
    """

    q: Array
    v: Array
    a: Array
    motor_v: Array
    motor_a: Array
    tau: Array
    force: Array


@jit()
def noted(window: Window, measured: Array, drives: Drives, friction: Friction, load: Array, spacing: float) -> Window:
    """The window with further measurements; a value that is not finite restarts it.

    Args:
        window: window before the measurement; it is not modified.
        measured: motor angles, motor torques that are read, joint torques of contact, oldest first ``(m, 3, n)``.
        drives, friction: of the identified loop.
        load: last known torque of the gears ``(n,)`` [N m].
        spacing: time between measurements [s].
    """
    angles, torques, forces, rows = window.q.copy(), window.tau.copy(), window.force.copy(), window.rows
    for q, tau, tau_ext in measured:
        if not (np.isfinite(q).all() and np.isfinite(tau).all()):
            rows = 0
            continue
        for i in range(len(q)):
            for k in range(CYCLES - 1):
                angles[k, i], torques[k, i], forces[k, i] = angles[k + 1, i], torques[k + 1, i], forces[k + 1, i]
            step = q[i] - angles[-1, i]
            angles[-1, i] = q[i]
            torques[-1, i] = tau[i] / drives.gain[i] + tau_ext[i] - ripple_torque(drives.ripple, i, q[i])
            forces[-1, i] = (friction_step(friction, i, step / spacing, load[i], forces[-1, i], step)[1]
                             if rows > 0 else 0.0)
        rows += 1
    return Window(angles, torques, forces, rows)


@jit()
def smoothed(window: Window, drives: Drives, spacing: float) -> Smoothed:
    """Motion and torque in the middle of a window.

    Args:
        window: full.
        drives: of the identified loop.
        spacing: time between measurements [s].
    """
    count, n = window.q.shape
    rows, T = np.zeros((7, 1, n)), spacing
    for i in range(n):
        for k in range(1, count - 1):
            q, tau, force = window.q[k, i], window.tau[k, i], window.force[k, i]
            a = (window.q[k + 1, i] - 2.0 * q + window.q[k - 1, i]) / (T * T)
            arm = q - (tau - drives.rotor_inertia[i] * a - force - drives.offset[i]) / drives.stiffness[i]
            value, slope, bend = _VALUE[k - 1], _SLOPE[k - 1] / T, _BEND[k - 1] / (T * T)
            rows[0, 0, i] += value * arm
            rows[1, 0, i] += slope * arm
            rows[2, 0, i] += bend * arm
            rows[3, 0, i] += slope * q
            rows[4, 0, i] += bend * q
            rows[5, 0, i] += value * tau
            rows[6, 0, i] += value * force
    return Smoothed(rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6])
