"""Motion and torque in the middle of a few cycles, all smoothed alike, the arm's motion behind elastic gears.

A torque belongs to the acceleration that comes out of the same filter. A polynomial fitted to positions smooths its
second derivative far more than its value: at 4 Hz and 12 ms a tenth of the acceleration is missing that the torque
still shows. Here every signal is the same weighted mean of neighbours, the derivatives of central differences. What the
second difference averages over two cycles, the torque averages over with the weights 1, 10, 1 (exact for cubics).

The arm does not move as its motors do: behind a gear of compliance 1/k it lags by the gear's torque,

    q_a = q - (τ - J q̈ - z F(0) - τ_offset) / k

with dry friction F(0), which z has turned to the direction of motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.loop.loop_model import LoopModel

_MEAN = np.array([1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0]) / 64.0
"""Weights of the mean of neighbours."""
CYCLES = len(_MEAN) + 4
"""Cycles that are needed: one more on each side for the differences, and one for the motors' acceleration."""


@dataclass(frozen=True)
class Smoothed:
    """In the middle of the window, each ``(n,)``.

    Attributes:
        q, v, a: of the arm [rad, rad/s, rad/s²].
        motor_v, motor_a: of the motors [rad/s, rad/s²].
        tau: motor torque less ripple [N m].
        z: how far friction has turned since the last reversal, -1 to 1.
    """

    q: Array
    v: Array
    a: Array
    motor_v: Array
    motor_a: Array
    tau: Array
    z: Array


class SmoothedWindow:
    """Smooths the last ``CYCLES`` measurements.

    Args:
        loop: the identified loop.
    """

    def __init__(self, loop: LoopModel) -> None:
        self._loop = loop
        self._dry = loop.friction_torque[:, 0].mean(axis=0)
        T = loop.t_ipo
        self._value = np.convolve(_MEAN, [1.0, 10.0, 1.0]) / 12.0
        self._slope = np.convolve(_MEAN, [-1.0, 0.0, 1.0]) / (2.0 * T)
        self._bend = np.convolve(_MEAN, [1.0, -2.0, 1.0]) / T**2

    def turned(self, z: Array, step: Array) -> Array:
        """How far friction has turned ``(n,)``, -1 to 1, a step of the motors ``(n,)`` [rad] after it was at ``z``."""
        bend = self._loop.friction_bend
        left = np.where(bend > 0.0, np.exp(-np.abs(step) / np.where(bend > 0.0, bend, 1.0)), step == 0.0)
        return np.asarray(np.sign(step) + (z - np.sign(step)) * left)

    def of(self, q: Array, tau: Array, z: Array) -> Smoothed:
        """Motion and torque in the middle.

        Args:
            q: motor angles ``(CYCLES, n)`` [rad].
            tau: motor torques ``(CYCLES, n)`` [N m].
            z: how far friction had turned ``(CYCLES, n)``, -1 to 1.
        """
        loop = self._loop
        tau = tau - self._ripple(q)
        a = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / loop.t_ipo**2
        q, tau, z = q[1:-1], tau[1:-1], z[1:-1]
        arm = q - loop.compliance * (tau / loop.gain - loop.rotor_inertia * a - z * self._dry - loop.offset)
        return Smoothed(self._value @ arm, self._slope @ arm, self._bend @ arm, self._slope @ q, self._bend @ q,
                        self._value @ tau, self._value @ z)

    def _ripple(self, q: Array) -> Array:
        """Known torque ripple at positions ``(m, n)`` [N m]."""
        k, a, b = (self._loop.ripple[:, row, None] for row in range(3))
        return np.asarray(np.sum(a * np.cos(k * q) + b * np.sin(k * q), axis=0) if len(k) else np.zeros_like(q))
