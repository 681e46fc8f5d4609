"""The industrial controller of the simulated arm: the KRC1 of [G] Fig. 15.

command every t_ipo → linear interpolation → low-pass → position loop (P, velocity feedforward) every t_position
→ velocity loop (PI, velocity from a low-pass differentiator of the encoder) every t_velocity → current
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from sim.arm.kernel import C_INCREMENT, C_KFF, C_KI, C_KP, C_KV, C_LIMIT, CONTROLLER_PARAMETERS
from sim.arm.world import World


def controller_parameters(world: World, n: int, torque_limit: Array, gear_ratio: Array) -> Array:
    """Packs the controller's numbers for the compiled step, shape ``(CONTROLLER_PARAMETERS, n)``.

    Args:
        world: the true world.
        n: number of joints.
        torque_limit: on the joint side ``(n,)`` [N m].
        gear_ratio: motor turns per joint turn ``(n,)``.
    """
    p = np.zeros((CONTROLLER_PARAMETERS, n))
    p[C_KV] = world.per_joint("position_gain", n)
    p[C_KFF] = world.per_joint("velocity_feedforward", n)
    p[C_KP] = world.per_joint("velocity_gain", n)
    p[C_KI] = p[C_KP] * world.t_velocity / world.per_joint("integral_time", n)
    p[C_LIMIT] = torque_limit if world.torque_limits else np.inf
    if world.quantisation:
        p[C_INCREMENT] = 2.0 * math.pi / (world.per_joint("encoder_increments", n) * gear_ratio)
    return p


@dataclass(frozen=True)
class EquivalentController:
    """The truth that an identification of [G] (15)–(17) at the interpolation cycle should find, each ``(n,)``.

    Attributes:
        k_p: [N m/rad], k_d: [N m s/rad] on the control error and its derivative.
        k_1: [N m s/rad], k_2: [N m s²/rad] on velocity and acceleration.
        k_i: share of the integrated output per interpolation cycle.
    """

    k_p: Array
    k_d: Array
    k_1: Array
    k_2: Array
    k_i: Array


def equivalent_controller(world: World, n: int) -> EquivalentController:
    """The cascade of this world written as [G] (16), (17).

    With v_des = K_v e + f q̇_d, the P part K_p (v_des - q̇) is K_p K_v e + K_p f ė - K_p (1 - f) q̇; the velocity
    filter adds its time constant times K_p on the acceleration. For scripts that compare an identified controller with
    the true one; no scene uses it, for the model side must not see the truth.
    """
    k_v, f, k_p = (world.per_joint(name, n) for name in ("position_gain", "velocity_feedforward", "velocity_gain"))
    return EquivalentController(k_p=k_p * k_v, k_d=k_p * f, k_1=-k_p * (1.0 - f), k_2=k_p * world.velocity_filter,
                                k_i=world.t_ipo / world.per_joint("integral_time", n))
