"""A pendulum behind a gear whose motor follows a path: the torque through the gear, and what a diagnosis knows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import Signals

INERTIA, WEIGHT, CUTOFF = 0.12, 3.0, 20.0


def through_gear(q: Array, dt: float, gear: Callable[[float, float], float], constant: float = 0.0) -> Array:
    """Torque through the gear ``(N,)`` [N m] along motor angles ``(N,)`` [rad].

    Args:
        q: of the motor.
        dt: between them [s].
        gear: torque of a twist [rad] and its rate [rad/s].
        constant: torque on the arm besides its weight [N m].
    """
    qd = np.gradient(q, dt)
    at, speed, torque = q[0], qd[0], np.empty(len(q))
    for i in range(len(q)):
        torque[i] = gear(q[i] - at, qd[i] - speed)
        speed += dt * (torque[i] - WEIGHT * np.sin(at) - constant) / INERTIA
        at += dt * speed
    return torque


def signals_of(t: Array, q: Array, constant: float = 0.0) -> Signals:
    """What a diagnosis knows of motor angles ``(N, 1)``: the arm with a rigid gear, the constant as the motor's."""
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)

    def rigid(a: Array, b: Array, c: Array) -> Array:
        return INERTIA * c + WEIGHT * np.sin(a)

    load, still = rigid(q, qd, qdd), np.zeros_like(q)
    return Signals(t, q, qd, qdd, load, load + constant, still, rigid=rigid, cutoff=CUTOFF)
