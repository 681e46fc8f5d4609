"""Motors and gears of the simulated arm, and the one compiled step that runs them with the controller.

    J q̈_m = τ_m + τ_ripple + τ_extra - τ_f(q̇_m, z, T, load) - τ_g
    τ_g = K gap(q_m + uneven(q_m) - q_a) + D (q̇_m - q̇_a)         on the link: τ_g

Both sides are integrated semi-implicitly with the step of PyBullet and exchange the same gear torque, so no energy
comes from the splitting. Where a gear is rigid, q_m = q_a and the rotor inertia is carried by ``SimulatedArm``.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ideal_robot.interface import Array
from ideal_robot.robot import Robot
from sim.controller import (
    CONTROLLER_PARAMETERS,
    CONTROLLER_STATES,
    X_COMMAND,
    X_ENCODER,
    X_END,
    X_INTEGRAL,
    X_LOW1,
    X_LOW2,
    X_START,
    X_TORQUE,
    control_step,
    controller_parameters,
)
from sim.friction import bristle_step, dry_level, hydrodynamic
from sim.world import STEP, World

# Rows of the parameter block after the controller's.
(P_ROTOR, P_STIFFNESS, P_DAMPING, P_BACKLASH, P_ELASTIC, P_COULOMB, P_SURPLUS, P_V_STRIBECK, P_SIGMA0, P_SIGMA1,
 P_ASYMMETRY, P_VISCOUS, P_DEGRESSIVE, P_V_DEGRESSIVE, P_LOAD, P_FRICTION, P_THERMAL_RESISTANCE, P_THERMAL_RATE,
 P_LUBRICATION, P_GAIN, P_RIPPLE, P_RIPPLE_ORDER, P_PHASE, P_NOISE, P_UNEVEN, P_UNEVEN_ORDER) = range(
    CONTROLLER_PARAMETERS, CONTROLLER_PARAMETERS + 26)
PARAMETERS = CONTROLLER_PARAMETERS + 26
# Rows of the state block after the controller's.
(X_MOTOR, X_MOTOR_VELOCITY, X_BRISTLE, X_TEMPERATURE, X_LUBRICANT, X_GEAR, X_CURRENT) = range(
    CONTROLLER_STATES, CONTROLLER_STATES + 7)
STATES = CONTROLLER_STATES + 7
# Numbers that all joints share.
(S_DT, S_LOW_PASS, S_VELOCITY_PASS, S_CURRENT_PASS, S_T_POSITION, S_T_VELOCITY, S_DRY_TEMPERATURE,
 S_VISCOSITY_TEMPERATURE, S_REFERENCE, S_AMBIENT, S_LUBRICANT_RATE) = range(11)
SHARED = 11
# Step counts of the cycles.
(N_IPO, N_POSITION, N_VELOCITY, N_LOG) = range(4)
# Rows of what is exchanged with the links.
(L_ANGLE, L_VELOCITY, L_EXTRA, L_TORQUE) = range(4)
# Columns of a row of the log, each n wide, after the time.
LOGGED = ("q_c", "q", "tau", "q_m", "q_a", "qd_a", "qd_m", "tau_motor", "tau_gear", "temperature")


def motor_torque_limit(robot: Robot) -> Array:
    """Joint-side torque limit of the motors ``(n,)``; a very large number where the data sheet is silent."""
    return np.where(np.isfinite(robot.tau_max), robot.tau_max, 1.0e12)


def drive_parameters(world: World, robot: Robot, rotor_inertia: Array, drive_gain: Array,
                     phase: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Packs a world's numbers for ``drive_step``.

    Args:
        rotor_inertia: true rotor inertias on the joint side ``(n,)`` [kg m²].
        drive_gain: true torque per ampere relative to the data sheet's ``(n,)``.
        phase: of torque ripple and transmission error ``(n,)`` [rad].

    Returns:
        Parameter block ``(PARAMETERS, n)``, shared numbers ``(SHARED,)``, step counts ``(4,)``.
    """
    n = robot.n
    limit = motor_torque_limit(robot)
    p = np.zeros((PARAMETERS, n))
    p[:CONTROLLER_PARAMETERS] = controller_parameters(world, n, limit, robot.gear_ratio)
    p[P_ROTOR] = rotor_inertia
    stiffness = world.per_joint("stiffness", n)
    elastic = np.isfinite(stiffness) if world.elasticity else np.zeros(n, dtype=bool)
    p[P_ELASTIC] = elastic
    p[P_STIFFNESS] = np.where(elastic, stiffness, 0.0)
    p[P_DAMPING] = np.where(elastic, world.per_joint("damping", n), 0.0)
    p[P_BACKLASH] = np.where(elastic, world.per_joint("backlash", n), 0.0)
    scale = world.per_joint("friction_scale", n) * (1.0 if world.friction else 0.0)
    p[P_FRICTION] = scale > 0.0
    p[P_COULOMB] = scale * world.per_joint("coulomb", n)
    p[P_SURPLUS] = scale * world.per_joint("stribeck", n)
    p[P_V_STRIBECK] = world.per_joint("stribeck_velocity", n)
    p[P_SIGMA0] = p[P_COULOMB] / world.per_joint("presliding", n)
    # Bristles damped to a fifth of critical on the rotor: they neither ring nor dominate the torque.
    p[P_SIGMA1] = 0.4 * np.sqrt(p[P_SIGMA0] * np.maximum(rotor_inertia, 1.0e-6))
    p[P_ASYMMETRY] = world.per_joint("friction_asymmetry", n)
    p[P_VISCOUS] = scale * world.per_joint("viscous", n)
    p[P_DEGRESSIVE] = scale * world.per_joint("degressive", n)
    p[P_V_DEGRESSIVE] = world.per_joint("degressive_velocity", n)
    p[P_LOAD] = world.per_joint("load_friction", n) / limit
    if world.thermal:
        p[P_THERMAL_RESISTANCE] = world.per_joint("thermal_resistance", n)
        p[P_THERMAL_RATE] = world.time_compression / world.per_joint("thermal_time_constant", n)
    p[P_LUBRICATION] = world.per_joint("lubrication", n)
    p[P_GAIN] = drive_gain
    p[P_RIPPLE] = world.per_joint("torque_ripple", n) * np.where(np.isfinite(robot.tau_max), limit, 0.0)
    p[P_RIPPLE_ORDER] = world.per_joint("ripple_order", n) * robot.gear_ratio
    p[P_PHASE] = phase
    p[P_UNEVEN] = world.per_joint("transmission_error", n)
    p[P_UNEVEN_ORDER] = world.per_joint("transmission_order", n)
    p[P_NOISE] = world.per_joint("current_noise", n) * np.where(np.isfinite(robot.tau_max), limit, 0.0)
    shared = np.zeros(SHARED)
    shared[S_DT] = STEP
    shared[S_LOW_PASS] = _share(world.t_position, world.low_pass)
    shared[S_VELOCITY_PASS] = _share(world.t_velocity, world.velocity_filter)
    shared[S_CURRENT_PASS] = _share(STEP, world.current_lag)
    shared[S_T_POSITION] = world.t_position
    shared[S_T_VELOCITY] = world.t_velocity
    shared[S_DRY_TEMPERATURE] = world.dry_temperature
    shared[S_VISCOSITY_TEMPERATURE] = world.viscosity_temperature
    shared[S_REFERENCE] = world.reference_temperature
    shared[S_AMBIENT] = world.ambient_temperature
    shared[S_LUBRICANT_RATE] = world.time_compression / world.lubrication_time
    counts = np.array([round(cycle / STEP) for cycle in
                       (world.t_ipo, world.t_position, world.t_velocity, min(world.log_cycle, 0.002))], dtype=np.int64)
    return p, shared, counts


def _share(cycle: float, time_constant: float) -> float:
    """By how much of the difference a first-order low-pass moves in one cycle."""
    return 1.0 - math.exp(-cycle / time_constant) if time_constant > 0.0 else 1.0


def drive_start(p: Array, q0: Array, holding_torque: Array, temperature: Array) -> Array:
    """State block ``(STATES, n)`` of drives that hold ``holding_torque (n,)`` at rest with motors at ``q0``."""
    x = np.zeros((STATES, p.shape[1]))
    for row in (X_START, X_END, X_LOW1, X_LOW2, X_COMMAND, X_ENCODER, X_MOTOR):
        x[row] = q0
    for row in (X_INTEGRAL, X_TORQUE):
        x[row] = holding_torque / p[P_GAIN]
    x[X_CURRENT] = holding_torque / p[P_GAIN]
    x[X_GEAR] = holding_torque
    x[X_TEMPERATURE] = temperature
    x[X_LUBRICANT] = 1.0
    return x


@njit(cache=True)
def drive_step(tick: int, p: Array, s: Array, counts: NDArray[np.int64], x: Array, links: Array, noise: Array,
               row: Array) -> None:
    """One step of controller, motors and gears; the torque for the links is left in ``links[L_TORQUE]``.

    Args:
        tick: number of the step since the start.
        p, s, counts: see ``drive_parameters``.
        x: state block, changed in place.
        links: ``(4, n)``: arm angles [rad], arm velocities [rad/s], additional torque on the motor side [N m], and, as
            the result, for elastic gears the gear torque [N m]; for rigid ones motor torque less friction, to be
            applied to link *and* rotor.
        noise: standard normal numbers for the measured current, one per joint.
        row: row of the log to be filled if the step is due for logging.
    """
    dt = s[S_DT]
    q_a, qd_a, extra, torque = links[L_ANGLE], links[L_VELOCITY], links[L_EXTRA], links[L_TORQUE]
    n = q_a.shape[0]
    fraction = (tick % counts[N_IPO]) / counts[N_IPO]
    position_due = tick % counts[N_POSITION] == 0
    velocity_due = tick % counts[N_VELOCITY] == 0
    log_due = tick % counts[N_LOG] == 0
    if log_due:
        row[0] = tick * dt
    for j in range(n):
        elastic = p[P_ELASTIC, j] > 0.0
        uneven = 0.0  # transmission error: the gear's output is q_m + A sin(order · q + phase)
        slope = 1.0
        if p[P_UNEVEN, j] > 0.0:
            angle = p[P_UNEVEN_ORDER, j] * (x[X_MOTOR, j] if elastic else q_a[j]) + p[P_PHASE, j]
            uneven = p[P_UNEVEN, j] * math.sin(angle)
            slope = 1.0 + p[P_UNEVEN, j] * p[P_UNEVEN_ORDER, j] * math.cos(angle)
        if not elastic:
            x[X_MOTOR, j] = q_a[j] - uneven
            x[X_MOTOR_VELOCITY, j] = qd_a[j] / slope
        q_m = x[X_MOTOR, j]
        v_m = x[X_MOTOR_VELOCITY, j]
        control_step(p, x, j, q_m, fraction, position_due, velocity_due, s[S_LOW_PASS], s[S_VELOCITY_PASS],
                     s[S_T_POSITION], s[S_T_VELOCITY])
        x[X_CURRENT, j] += s[S_CURRENT_PASS] * (x[X_TORQUE, j] - x[X_CURRENT, j])
        motor = x[X_CURRENT, j] * p[P_GAIN, j]
        if log_due:
            row[1 + j] = x[X_COMMAND, j]
            row[1 + n + j] = x[X_ENCODER, j]
            row[1 + 2 * n + j] = x[X_CURRENT, j] + p[P_NOISE, j] * noise[j]
            row[1 + 3 * n + j] = q_m
            row[1 + 4 * n + j] = q_a[j]
            row[1 + 5 * n + j] = qd_a[j]
            row[1 + 6 * n + j] = v_m
            row[1 + 7 * n + j] = motor
            row[1 + 9 * n + j] = x[X_TEMPERATURE, j]
        if p[P_RIPPLE, j] > 0.0:
            motor += p[P_RIPPLE, j] * math.sin(p[P_RIPPLE_ORDER, j] * q_m + p[P_PHASE, j])
        motor += extra[j]

        gear = motor
        if elastic:
            twist = q_m + uneven - q_a[j]
            half = 0.5 * p[P_BACKLASH, j]
            damping = p[P_DAMPING, j]
            if half > 0.0:
                if abs(twist) <= half:
                    twist = 0.0
                    damping = 0.0
                else:
                    twist -= half if twist > 0.0 else -half
            gear = p[P_STIFFNESS, j] * twist + damping * (slope * v_m - qd_a[j])

        friction = 0.0
        if p[P_FRICTION, j] > 0.0:
            above = x[X_TEMPERATURE, j] - s[S_REFERENCE]
            settled = 1.0 + p[P_LUBRICATION, j] * (1.0 - x[X_LUBRICANT, j])
            dry = math.exp(-s[S_DRY_TEMPERATURE] * above) * settled * (1.0 + p[P_LOAD, j] * abs(x[X_GEAR, j]))
            level = dry * dry_level(v_m, p[P_COULOMB, j], p[P_SURPLUS, j], p[P_V_STRIBECK, j], p[P_ASYMMETRY, j])
            z = x[X_BRISTLE, j]
            z_next = bristle_step(z, v_m, level, p[P_SIGMA0, j], dt)
            fluid = math.exp(-s[S_VISCOSITY_TEMPERATURE] * above) * settled
            friction = (p[P_SIGMA0, j] * z_next + p[P_SIGMA1, j] * (z_next - z) / dt
                        + fluid * hydrodynamic(v_m, p[P_VISCOUS, j], p[P_DEGRESSIVE, j], p[P_V_DEGRESSIVE, j]))
            x[X_BRISTLE, j] = z_next
            spread = min(1.0, abs(v_m) / (10.0 * p[P_V_STRIBECK, j]))
            x[X_LUBRICANT, j] += dt * s[S_LUBRICANT_RATE] * (spread - x[X_LUBRICANT, j])
        if p[P_THERMAL_RATE, j] > 0.0:
            rise = abs(friction * v_m) * p[P_THERMAL_RESISTANCE, j]
            x[X_TEMPERATURE, j] += dt * p[P_THERMAL_RATE, j] * (rise - (x[X_TEMPERATURE, j] - s[S_AMBIENT]))

        if elastic:
            x[X_MOTOR_VELOCITY, j] = v_m + dt * (motor - friction - slope * gear) / p[P_ROTOR, j]
            x[X_MOTOR, j] = q_m + dt * x[X_MOTOR_VELOCITY, j]
            x[X_GEAR, j] = gear
            torque[j] = gear
        else:
            torque[j] = motor - friction
            x[X_GEAR, j] = torque[j]
        if log_due:
            row[1 + 8 * n + j] = x[X_GEAR, j]
