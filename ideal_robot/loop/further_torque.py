"""Torques that effects ask of the motors beside rigid body, friction and what else the loop has a place for."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics
from ideal_robot.effects import Signals
from ideal_robot.loop.loop_model import LoopModel


def further_torque(loop: LoopModel, t: Array, q: Array, qd: Array, qdd: Array, load: Array,
                   sliding: Array) -> Array:
    """Sum of the torques of ``loop.terms`` along a motion of the motors ``(N, n)`` [N m].

    Args:
        loop: the identified loop.
        t: instants ``(N,)`` [s].
        q: motor angles ``(N, n)`` [rad].
        qd: their velocities [rad/s].
        qdd: their accelerations [rad/s²].
        load: torque at the gear outputs [N m].
        sliding: how far dry friction has turned since the last reversal, -1 to 1.
    """
    if not loop.terms:
        return np.zeros_like(q)
    signals = Signals(t, q, qd, qdd, load, load, np.zeros_like(load), sliding=sliding,
                      rigid=lambda q, qd, qdd: inverse_dynamics(loop.chain, q, qd, qdd))
    return np.asarray(np.sum([effect.contribution(signals) for effect in loop.terms], axis=0))
