"""The industrial controller of the simulated arm: the KRC1 of [G] Fig. 15.

    command every t_ipo → linear interpolation → low-pass → position loop (P, velocity feedforward) every t_position
    → velocity loop (PI, velocity from a low-pass differentiator of the encoder) every t_velocity → current
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from ideal_robot.interface import Array
from sim.world import World

# Rows of the parameter block of one arm, columns are joints.
(C_KV, C_KFF, C_KP, C_KI, C_LIMIT, C_INCREMENT) = range(6)
CONTROLLER_PARAMETERS = 6
# Rows of the state block.
(X_START, X_END, X_LOW1, X_LOW2, X_VELOCITY_DESIRED, X_ENCODER, X_VELOCITY, X_INTEGRAL, X_TORQUE,
 X_COMMAND) = range(10)
CONTROLLER_STATES = 10


def controller_parameters(world: World, n: int, torque_limit: Array, gear_ratio: Array) -> Array:
    """Packs the controller's numbers for ``control_step``, shape ``(CONTROLLER_PARAMETERS, n)``."""
    p = np.zeros((CONTROLLER_PARAMETERS, n))
    p[C_KV] = world.per_joint("position_gain", n)
    p[C_KFF] = world.per_joint("velocity_feedforward", n)
    p[C_KP] = world.per_joint("velocity_gain", n)
    p[C_KI] = p[C_KP] * world.t_velocity / world.per_joint("integral_time", n)
    p[C_LIMIT] = torque_limit if world.torque_limits else np.inf
    if world.quantisation:
        p[C_INCREMENT] = 2.0 * math.pi / (world.per_joint("encoder_increments", n) * gear_ratio)
    return p


@njit(cache=True)
def control_step(p: Array, x: Array, j: int, q_m: float, fraction: float, position_due: bool, velocity_due: bool,
                 low_pass: float, velocity_pass: float, t_position: float, t_velocity: float) -> None:
    """Runs the loops of joint ``j`` that are due; the torque command is left in ``x[X_TORQUE, j]``.

    Args:
        p, x: parameter and state block.
        q_m: true motor angle [rad].
        fraction: how much of the interpolation cycle has gone by, 0 … 1.
        position_due, velocity_due: which loops run at this step.
        low_pass, velocity_pass: shares by which the command and the velocity filter move per their cycle.
        t_position, t_velocity: cycle times [s].
    """
    if velocity_due:
        increment = p[C_INCREMENT, j]
        encoder = math.floor(q_m / increment + 0.5) * increment if increment > 0.0 else q_m
        raw = (encoder - x[X_ENCODER, j]) / t_velocity
        x[X_ENCODER, j] = encoder
        x[X_VELOCITY, j] += velocity_pass * (raw - x[X_VELOCITY, j])
    if position_due:
        command = x[X_START, j] + fraction * (x[X_END, j] - x[X_START, j])
        x[X_COMMAND, j] = command
        before = x[X_LOW2, j]
        x[X_LOW1, j] += low_pass * (command - x[X_LOW1, j])
        x[X_LOW2, j] += low_pass * (x[X_LOW1, j] - x[X_LOW2, j])
        feedforward = p[C_KFF, j] * (x[X_LOW2, j] - before) / t_position
        x[X_VELOCITY_DESIRED, j] = p[C_KV, j] * (x[X_LOW2, j] - x[X_ENCODER, j]) + feedforward
    if velocity_due:
        error = x[X_VELOCITY_DESIRED, j] - x[X_VELOCITY, j]
        torque = p[C_KP, j] * error + x[X_INTEGRAL, j] + p[C_KI, j] * error
        limit = p[C_LIMIT, j]
        if abs(torque) <= limit:
            x[X_INTEGRAL, j] += p[C_KI, j] * error
        else:
            # Anti-windup: the integral stays where it is while the current is at its limit.
            torque = limit if torque > 0.0 else -limit
        x[X_TORQUE, j] = torque


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
    filter adds its time constant times K_p on the acceleration.
    """
    k_v, f, k_p = (world.per_joint(name, n) for name in ("position_gain", "velocity_feedforward", "velocity_gain"))
    return EquivalentController(k_p=k_p * k_v, k_d=k_p * f, k_1=-k_p * (1.0 - f), k_2=k_p * world.velocity_filter,
                                k_i=world.t_ipo / world.per_joint("integral_time", n))
