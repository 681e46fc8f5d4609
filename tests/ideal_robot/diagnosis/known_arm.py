"""What tests of causes beside a known model draw alike: a motion of all joints, and a body of no extent."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array


def harmonics(rng: np.random.Generator, t: Array, middle: Array, size: float,
              frequencies: tuple[float, float], count: int) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations ``(N, n)`` of sines of random frequency and phase about ``middle``.

    Args:
        rng: draws them.
        t: times ``(N,)`` [s].
        middle: of the motion ``(n,)`` [rad].
        size: amplitude of each sine [rad].
        frequencies: least and largest [rad/s].
        count: of sines in each joint.
    """
    frequency, phase = rng.uniform(*frequencies, (count, len(middle))), rng.uniform(0.0, 6.0, (count, len(middle)))
    angle = t[:, None, None] * frequency + phase
    return (middle + size * np.sin(angle).sum(axis=1), size * (frequency * np.cos(angle)).sum(axis=1),
            -size * (frequency**2 * np.sin(angle)).sum(axis=1))


def point_mass(mass: float, at: Array) -> Array:
    """Mass, first moments and inertias ``(10,)`` of a mass [kg] at a place ``(3,)`` [m], in Pinocchio's order."""
    return np.asarray(pin.Inertia(mass, np.asarray(at, dtype=float), np.zeros((3, 3))).toDynamicParameters())
