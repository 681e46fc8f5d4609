"""Packs a world's numbers for the compiled step of motors, gears and controller."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from sim.arm import kernel
from sim.arm.world import STEP, World

# The industrial controller of the simulated arm: the KRC1 of [G] Fig. 15.
#
# command every t_ipo → linear interpolation → low-pass → position loop (P, velocity feedforward) every t_position
# → velocity loop (PI, velocity from a low-pass differentiator of the encoder) every t_velocity → current

_PER_JOINT = {
    kernel.C_KV: "position_gain", kernel.C_KFF: "velocity_feedforward", kernel.C_KP: "velocity_gain",
    kernel.P_V_STRIBECK: "stribeck_velocity", kernel.P_ASYMMETRY: "friction_asymmetry",
    kernel.P_V_DEGRESSIVE: "degressive_velocity", kernel.P_LUBRICATION: "lubrication",
    kernel.P_UNEVEN: "transmission_error", kernel.P_UNEVEN_ORDER: "transmission_order",
}
"""Rows of the parameter block that a key of the world fills as it is."""


def motor_torque_limit(robot: Robot) -> Array:
    """Joint-side torque limit of the motors ``(n,)``; a very large number where the data sheet is silent."""
    return np.where(np.isfinite(robot.tau_max), robot.tau_max, 1.0e12)


def drive_parameters(world: World, robot: Robot, rotor_inertia: Array, drive_gain: Array,
                     phase: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Packs a world for ``drive_step``: parameters ``(PARAMETERS, n)``, shared numbers ``(11,)``, step counts ``(4,)``.

    Args:
        world: the true world.
        robot: data sheet of the arm.
        rotor_inertia: true rotor inertias on the joint side ``(n,)`` [kg m²].
        drive_gain: true torque per ampere relative to the data sheet's ``(n,)``.
        phase: of torque ripple and transmission error ``(n,)`` [rad].
    """
    n = robot.n
    limit = motor_torque_limit(robot)
    p = np.zeros((kernel.PARAMETERS, n))
    for row, name in _PER_JOINT.items():
        p[row] = world.per_joint(name, n)
    p[kernel.C_KI] = p[kernel.C_KP] * world.t_velocity / world.per_joint("integral_time", n)
    p[kernel.C_LIMIT] = limit if world.torque_limits else np.inf
    if world.quantisation:
        p[kernel.C_INCREMENT] = 2.0 * math.pi / (world.per_joint("encoder_increments", n) * robot.gear_ratio)
    p[kernel.P_ROTOR] = rotor_inertia
    stiffness = world.per_joint("stiffness", n)
    elastic = np.isfinite(stiffness) if world.elasticity else np.zeros(n, dtype=bool)
    p[kernel.P_ELASTIC] = elastic
    p[kernel.P_STIFFNESS] = np.where(elastic, stiffness, 0.0)
    p[kernel.P_DAMPING] = np.where(elastic, world.per_joint("damping", n), 0.0)
    p[kernel.P_BACKLASH] = np.where(elastic, world.per_joint("backlash", n), 0.0)
    _pack_friction(p, world, rotor_inertia, limit)
    p[kernel.P_GAIN] = drive_gain
    p[kernel.P_RIPPLE] = world.per_joint("torque_ripple", n) * np.where(np.isfinite(robot.tau_max), limit, 0.0)
    p[kernel.P_RIPPLE_ORDER] = world.per_joint("ripple_order", n) * robot.gear_ratio
    p[kernel.P_PHASE] = phase
    p[kernel.P_NOISE] = world.per_joint("current_noise", n) * np.where(np.isfinite(robot.tau_max), limit, 0.0)
    shared = np.zeros(kernel.S_LUBRICANT_RATE + 1)
    for row, value in {
        kernel.S_DT: STEP, kernel.S_LOW_PASS: _share(world.t_position, world.low_pass),
        kernel.S_VELOCITY_PASS: _share(world.t_velocity, world.velocity_filter),
        kernel.S_CURRENT_PASS: _share(STEP, world.current_lag), kernel.S_T_POSITION: world.t_position,
        kernel.S_T_VELOCITY: world.t_velocity, kernel.S_DRY_TEMPERATURE: world.dry_temperature,
        kernel.S_VISCOSITY_TEMPERATURE: world.viscosity_temperature, kernel.S_REFERENCE: world.reference_temperature,
        kernel.S_AMBIENT: world.ambient_temperature,
        kernel.S_LUBRICANT_RATE: world.time_compression / world.lubrication_time,
    }.items():
        shared[row] = value
    counts = np.array([round(cycle / STEP) for cycle in
                       (world.t_ipo, world.t_position, world.t_velocity, min(world.log_cycle, 0.002))], dtype=np.int64)
    return p, shared, counts


def _pack_friction(p: Array, world: World, rotor_inertia: Array, limit: Array) -> None:
    """Friction of all joints and what warms it, into the parameter block."""
    n = p.shape[1]
    scale = world.per_joint("friction_scale", n) * (1.0 if world.friction else 0.0)
    p[kernel.P_FRICTION] = scale > 0.0
    p[kernel.P_COULOMB] = scale * world.per_joint("coulomb", n)
    p[kernel.P_SURPLUS] = scale * world.per_joint("stribeck", n)
    p[kernel.P_SIGMA0] = p[kernel.P_COULOMB] / world.per_joint("presliding", n)
    # Bristles damped to a fifth of critical on the rotor: they neither ring nor dominate the torque.
    p[kernel.P_SIGMA1] = 0.4 * np.sqrt(p[kernel.P_SIGMA0] * np.maximum(rotor_inertia, 1.0e-6))
    p[kernel.P_VISCOUS] = scale * world.per_joint("viscous", n)
    p[kernel.P_DEGRESSIVE] = scale * world.per_joint("degressive", n)
    p[kernel.P_LOAD] = world.per_joint("load_friction", n) / limit
    if world.thermal:
        p[kernel.P_THERMAL_RESISTANCE] = world.per_joint("thermal_resistance", n)
        p[kernel.P_THERMAL_RATE] = world.time_compression / world.per_joint("thermal_time_constant", n)


def _share(cycle: float, time_constant: float) -> float:
    """By how much of the difference a first-order low-pass moves in one cycle."""
    return 1.0 - math.exp(-cycle / time_constant) if time_constant > 0.0 else 1.0


def drive_start(p: Array, q0: Array, holding_torque: Array, temperature: Array) -> Array:
    """State block ``(STATES, n)`` of drives that hold ``holding_torque (n,)`` at rest with motors at ``q0``.

    Args:
        p: parameter block ``(PARAMETERS, n)``.
        q0: motor angles ``(n,)`` [rad].
        holding_torque: that holds the arm at rest ``(n,)`` [N m].
        temperature: of the gears ``(n,)`` [°C].
    """
    x = np.zeros((kernel.STATES, p.shape[1]))
    x[[kernel.X_START, kernel.X_END, kernel.X_LOW1, kernel.X_LOW2, kernel.X_COMMAND, kernel.X_ENCODER,
       kernel.X_MOTOR]] = q0
    x[[kernel.X_INTEGRAL, kernel.X_TORQUE, kernel.X_CURRENT]] = holding_torque / p[kernel.P_GAIN]
    x[kernel.X_GEAR] = holding_torque
    x[kernel.X_TEMPERATURE] = temperature
    x[kernel.X_LUBRICANT] = 1.0
    return x


# Friction of a gear as it truly is in the simulated world: a dynamic law none of the fitted models can copy.
#
# Bristles (LuGre, Canudas de Wit et al. 1995) carry the dry part, an Eyring fluid the hydrodynamic one:
#
#     z'    = v - σ0 |v| / g(v) z                       presliding: bristles bend elastically by z
#     g(v)  = (F_c + F_s exp(-(v / v_s)²)) · load · dry temperature       Coulomb and Stribeck
#     τ_f   = σ0 z + σ1 z' + viscosity(T) · (f_v v + F_e asinh(v / v_e))   asinh: degressive (Eyring)

def steady_friction(world: World, n: int, velocity: Array, temperature: Array | float | None = None) -> Array:
    """Friction torque ``(N, n)`` [N m] after sliding long enough at ``velocity (N, n)``, without load.

    For tests and documents about the world; no model may use it.

    Args:
        world: the true world.
        n: number of joints.
        velocity: on the joint side ``(N, n)`` [rad/s].
        temperature: of all gears, or of each ``(n,)`` [°C]; the world's reference temperature if None.
    """
    velocity = np.asarray(velocity, dtype=float)
    p = {name: world.per_joint(name, n) for name in
         ("coulomb", "stribeck", "stribeck_velocity", "friction_asymmetry", "viscous", "degressive",
          "degressive_velocity", "friction_scale")}
    above = (world.reference_temperature if temperature is None else temperature) - world.reference_temperature
    side = 1.0 + np.sign(velocity) * p["friction_asymmetry"]
    dry = side * (p["coulomb"] + p["stribeck"] * np.exp(-((velocity / p["stribeck_velocity"]) ** 2)))
    fluid = p["viscous"] * velocity + p["degressive"] * np.arcsinh(velocity / p["degressive_velocity"])
    return p["friction_scale"] * (np.sign(velocity) * dry * np.exp(-world.dry_temperature * above)
                                  + fluid * np.exp(-world.viscosity_temperature * above))
