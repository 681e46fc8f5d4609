"""Rotor inertias that the closed loop can be computed with.

Of a base joint, motion tells the sum of the rotor's inertia and that of the links it moves, nothing more. Where the
robot data have no rotor inertia either, all of the sum may have gone to the links: a motor without inertia behind its
gear, which no drive is and no simulation can follow. A share of the links' inertia then counts to the rotor; the sum,
and with it the motor torque of a motion behind rigid gears, stays what was identified.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, inverse_dynamics, joint_frames, mass_matrix
from ideal_robot.effects import Signals
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.robots.robot import spread_postures

_SHARE = 0.5
"""Rotor inertia over the least inertia that the links hold against the joint, where the rotor is not known."""


def with_rotors(chain: Chain, rotor_inertia: Array, q_min: Array, q_max: Array) -> tuple[Chain, Array]:
    """The chain and the rotor inertias ``(n,)``, none of them less than a share of what its joint moves.

    Args:
        chain: rigid bodies of the arm.
        rotor_inertia: as identified, reflected to the joint side ``(n,)`` [kg m², kg where a joint slides].
        q_min: lower position limits ``(n,)`` [rad or m].
        q_max: upper position limits ``(n,)`` [rad or m].
    """
    least = _least_inertia(chain, q_min, q_max)
    short = rotor_inertia < 0.2 * _SHARE * least
    # The mass matrix stays positive definite as long as the shares add up to less than one.
    share = min(_SHARE, 0.8 / max(int(short.sum()), 1))
    moved = np.where(short, share * least - rotor_inertia, 0.0)
    return chain._replace(armature=chain.armature - moved), rotor_inertia + moved


def _least_inertia(chain: Chain, q_min: Array, q_max: Array) -> Array:
    """Least inertia ``(n,)`` that each joint feels of the links while the others are free, over postures."""
    n = len(chain.mass)
    R, p, M = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, n))
    least = np.full(n, np.inf)
    for q in spread_postures(q_min, q_max):
        joint_frames(chain, q, R, p)
        mass_matrix(chain, R, p, M)
        least = np.minimum(least, 1.0 / np.diag(np.linalg.inv(M)))
    return np.asarray(least)


# Torques that effects ask of the motors beside rigid body, friction and what else the loop has a place for.

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
