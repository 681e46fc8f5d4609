"""The compiled step of the simulated arm: controller, motors, gears and friction of all joints in one call.

    J q̈_m = τ_m + τ_ripple + τ_extra - τ_f(q̇_m, z, T, load) - τ_g
    τ_g = K gap(q_m + uneven(q_m) - q_a) + D (q̇_m - q̇_a) + H h     on the link: τ_g + τ_balancer + τ_hose

Motors and links are integrated semi-implicitly with the step of PyBullet and exchange the same gear torque, so no
energy comes from the splitting. Where a gear is rigid, q_m = q_a and the rotor is carried by ``SimulatedArm``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit

# Rows of the parameter block, columns are joints: the controller's first.
(C_KV, C_KFF, C_KP, C_KI, C_LIMIT, C_INCREMENT,
 P_ROTOR, P_STIFFNESS, P_DAMPING, P_BACKLASH, P_ELASTIC, P_COULOMB, P_SURPLUS, P_V_STRIBECK, P_SIGMA0, P_SIGMA1,
 P_ASYMMETRY, P_VISCOUS, P_DEGRESSIVE, P_V_DEGRESSIVE, P_LOAD, P_FRICTION, P_THERMAL_RESISTANCE, P_THERMAL_RATE,
 P_LUBRICATION, P_GAIN, P_RIPPLE, P_RIPPLE_ORDER, P_PHASE, P_NOISE, P_UNEVEN, P_UNEVEN_ORDER,
 P_TURNS, P_ONCE, P_ONCE_PHASE, P_TWICE, P_TWICE_PHASE, P_HYSTERESIS, P_HYSTERESIS_WAY, P_HOSE, P_HOSE_REST,
 P_HOSE_FRICTION, P_BALANCER, P_BALANCER_TOP, C_COMPENSATION, C_NOTCH, C_NOTCH_B0, C_NOTCH_B1, C_NOTCH_B2, C_NOTCH_A1,
 C_NOTCH_A2, C_TORQUE) = range(52)
PARAMETERS = C_TORQUE + 1
# Rows of the state block: the controller's first.
(X_START, X_END, X_LOW1, X_LOW2, X_VELOCITY_DESIRED, X_ENCODER, X_VELOCITY, X_INTEGRAL, X_TORQUE, X_COMMAND,
 X_MOTOR, X_MOTOR_VELOCITY, X_BRISTLE, X_TEMPERATURE, X_LUBRICANT, X_GEAR, X_CURRENT,
 X_HYSTERESIS, X_TWIST, X_HOSE, X_HOSE_ANGLE, X_COMPENSATION, X_NOTCH1, X_NOTCH2, X_ASKED, X_TOLD_START,
 X_TOLD_END) = range(27)
STATES = X_TOLD_END + 1
# Numbers that all joints share.
(S_DT, S_LOW_PASS, S_VELOCITY_PASS, S_CURRENT_PASS, S_T_POSITION, S_T_VELOCITY, S_DRY_TEMPERATURE,
 S_VISCOSITY_TEMPERATURE, S_REFERENCE, S_AMBIENT, S_LUBRICANT_RATE) = range(11)
# Step counts of the cycles.
(N_IPO, N_POSITION, N_VELOCITY, N_LOG) = range(4)
# Rows of the block that is exchanged with the links.
(L_ANGLE, L_VELOCITY, L_EXTRA, L_TORQUE) = range(4)
# Columns of a row of the log, each n wide, after the time.
LOGGED = ("q_c", "q", "tau", "q_m", "q_a", "qd_a", "qd_m", "tau_motor", "tau_gear", "temperature")


@jit(inline="always")
def _bristle_step(z: float, v: float, g: float, sigma0: float, dt: float) -> float:
    """Bristle deflection [rad] after ``dt`` [s] at constant velocity: the exact solution, so stable at any step."""
    if v == 0.0:
        return z
    if g <= 0.0:
        return 0.0  # without dry friction there are no bristles
    settled = g / sigma0 if v > 0.0 else -g / sigma0
    return settled + (z - settled) * math.exp(-abs(v) * sigma0 * dt / g)


@jit(inline="always")
def _dry_level(v: float, coulomb: float, surplus: float, v_stribeck: float, asymmetry: float) -> float:
    """Level g(v) of dry friction [N m] at the reference temperature and without load."""
    side = 1.0 + asymmetry if v > 0.0 else 1.0 - asymmetry
    ratio = v / v_stribeck
    return side * (coulomb + surplus * math.exp(-ratio * ratio))


@jit(inline="always")
def _hydrodynamic(v: float, viscous: float, degressive: float, v_degressive: float) -> float:
    """Fluid friction at the reference temperature [N m]."""
    return viscous * v + degressive * math.asinh(v / v_degressive)


LEVER, STROKE, POLYTROPIC = 0.35, 0.35, 1.2
"""Of a balancer: lever of its piston over that of its cylinder, share of the gas that the whole stroke displaces, and
the exponent with which that raises the pressure."""


@jit(inline="always")
def balancer_shape(angle: float) -> float:
    """Torque of a gas-spring balancer towards the top over its torque at a quarter turn, ``angle`` [rad] from the top.

    The piston turns with the link at ``LEVER`` of the cylinder's distance, so that they are L apart; the gas is
    compressed by the stroke behind the top, L - (1 - LEVER), and its pressure rises as (1 - e)^-n.
    """
    length = math.sqrt(1.0 + LEVER * LEVER - 2.0 * LEVER * math.cos(angle))
    quarter = math.sqrt(1.0 + LEVER * LEVER)
    used, used_there = (length - 1.0 + LEVER) / (2.0 * LEVER), (quarter - 1.0 + LEVER) / (2.0 * LEVER)
    pressure = ((1.0 - STROKE * used) / (1.0 - STROKE * used_there)) ** -POLYTROPIC
    return math.sin(angle) / length * quarter * pressure


SLIPS = 0.06
"""Angle over which a hose's friction turns round after a reversal [rad]: it slips in its clamps one after another."""


@jit(inline="always")
def _turned_round(z: float, way: float, length: float) -> float:
    """Where a hysteretic part -1…1 is after a ``way`` in either direction: it forgets over ``length`` (Dahl's law)."""
    if way == 0.0:
        return z
    end = 1.0 if way > 0.0 else -1.0
    return end + (z - end) * math.exp(-abs(way) / length)


@jit()
def _control_step(p: Array, s: Array, x: Array, j: int, q_m: float, fraction: float, due: tuple[bool, bool]) -> None:
    """Runs the loops of joint ``j`` that are due; the torque command is left in ``x[X_TORQUE, j]``.

    ``fraction`` of the interpolation cycle has gone by; ``due``: whether position loop and velocity loop run.
    """
    position_due, velocity_due = due
    if velocity_due:
        increment = p[C_INCREMENT, j]
        encoder = math.floor(q_m / increment + 0.5) * increment if increment > 0.0 else q_m
        raw = (encoder - x[X_ENCODER, j]) / s[S_T_VELOCITY]
        x[X_ENCODER, j] = encoder
        x[X_VELOCITY, j] += s[S_VELOCITY_PASS] * (raw - x[X_VELOCITY, j])
    if position_due:
        command = x[X_START, j] + fraction * (x[X_END, j] - x[X_START, j])
        x[X_COMMAND, j] = x[X_TOLD_START, j] + fraction * (x[X_TOLD_END, j] - x[X_TOLD_START, j])
        before = x[X_LOW2, j]
        x[X_LOW1, j] += s[S_LOW_PASS] * (command - x[X_LOW1, j])
        x[X_LOW2, j] += s[S_LOW_PASS] * (x[X_LOW1, j] - x[X_LOW2, j])
        feedforward = p[C_KFF, j] * (x[X_LOW2, j] - before) / s[S_T_POSITION]
        x[X_VELOCITY_DESIRED, j] = p[C_KV, j] * (x[X_LOW2, j] - x[X_ENCODER, j]) + feedforward
        if p[C_COMPENSATION, j] > 0.0:  # the drive's own friction compensation knows the command, not the motion
            commanded = (x[X_LOW2, j] - before) / s[S_T_POSITION]
            x[X_COMPENSATION, j] = p[C_COMPENSATION, j] * math.tanh(commanded / p[P_V_STRIBECK, j])
    if velocity_due and p[C_TORQUE, j] > 0.0:  # another controller commands the torques
        x[X_TORQUE, j] = min(max(x[X_ASKED, j], -p[C_LIMIT, j]), p[C_LIMIT, j])
    elif velocity_due:
        error = x[X_VELOCITY_DESIRED, j] - x[X_VELOCITY, j]
        torque = p[C_KP, j] * error + x[X_INTEGRAL, j] + p[C_KI, j] * error
        if p[C_COMPENSATION, j] > 0.0:
            torque += x[X_COMPENSATION, j]
        if p[C_NOTCH, j] > 0.0:
            unfiltered = torque
            torque = p[C_NOTCH_B0, j] * unfiltered + x[X_NOTCH1, j]
            x[X_NOTCH1, j] = p[C_NOTCH_B1, j] * unfiltered - p[C_NOTCH_A1, j] * torque + x[X_NOTCH2, j]
            x[X_NOTCH2, j] = p[C_NOTCH_B2, j] * unfiltered - p[C_NOTCH_A2, j] * torque
        limit = p[C_LIMIT, j]
        if abs(torque) <= limit:
            x[X_INTEGRAL, j] += p[C_KI, j] * error
        else:
            # Anti-windup: the integral stays where it is while the current is at its limit.
            torque = limit if torque > 0.0 else -limit
        x[X_TORQUE, j] = torque


@jit()
def _gear_torque(p: Array, j: int, twist: float, twisting: float) -> float:
    """Torque of an elastic gear with backlash [N m], its output ``twist`` [rad] beyond the link."""
    half, damping = 0.5 * p[P_BACKLASH, j], p[P_DAMPING, j]
    if half > 0.0:
        if abs(twist) <= half:
            twist = 0.0
            damping = 0.0
        else:
            twist -= half if twist > 0.0 else -half
    return p[P_STIFFNESS, j] * twist + damping * twisting


@jit()
def _friction_step(p: Array, s: Array, x: Array, j: int, v_m: float) -> float:
    """Friction torque [N m] at a motor velocity [rad/s]; bristles, lubricant and temperature go on by one step."""
    dt, friction = s[S_DT], 0.0
    if p[P_FRICTION, j] > 0.0:
        above = x[X_TEMPERATURE, j] - s[S_REFERENCE]
        settled = 1.0 + p[P_LUBRICATION, j] * (1.0 - x[X_LUBRICANT, j])
        dry = math.exp(-s[S_DRY_TEMPERATURE] * above) * settled * (1.0 + p[P_LOAD, j] * abs(x[X_GEAR, j]))
        level = dry * _dry_level(v_m, p[P_COULOMB, j], p[P_SURPLUS, j], p[P_V_STRIBECK, j], p[P_ASYMMETRY, j])
        z = x[X_BRISTLE, j]
        z_next = _bristle_step(z, v_m, level, p[P_SIGMA0, j], dt)
        fluid = math.exp(-s[S_VISCOSITY_TEMPERATURE] * above) * settled
        friction = (p[P_SIGMA0, j] * z_next + p[P_SIGMA1, j] * (z_next - z) / dt
                    + fluid * _hydrodynamic(v_m, p[P_VISCOUS, j], p[P_DEGRESSIVE, j], p[P_V_DEGRESSIVE, j]))
        x[X_BRISTLE, j] = z_next
        spread = min(1.0, abs(v_m) / (10.0 * p[P_V_STRIBECK, j]))
        x[X_LUBRICANT, j] += dt * s[S_LUBRICANT_RATE] * (spread - x[X_LUBRICANT, j])
    if p[P_THERMAL_RATE, j] > 0.0:
        rise = abs(friction * v_m) * p[P_THERMAL_RESISTANCE, j]
        x[X_TEMPERATURE, j] += dt * p[P_THERMAL_RATE, j] * (rise - (x[X_TEMPERATURE, j] - s[S_AMBIENT]))
    return friction


@jit()
def _log_joint(p: Array, x: Array, links: Array, j: int, steps: int, noise: float, row: Array) -> None:
    """Writes what is known of joint ``j`` before its motor moves on into a row of the log, see ``LOGGED``.

    The row has summed the current over ``steps``; ``noise`` is a standard normal number for the measured one.
    """
    n = links.shape[1]
    row[1 + j] = x[X_COMMAND, j]
    row[1 + n + j] = x[X_ENCODER, j]
    row[1 + 2 * n + j] = row[1 + 2 * n + j] / steps + p[P_NOISE, j] * noise
    row[1 + 3 * n + j] = x[X_MOTOR, j]
    row[1 + 4 * n + j] = links[L_ANGLE, j]
    row[1 + 5 * n + j] = links[L_VELOCITY, j]
    row[1 + 6 * n + j] = x[X_MOTOR_VELOCITY, j]
    row[1 + 7 * n + j] = x[X_CURRENT, j] * p[P_GAIN, j]
    row[1 + 9 * n + j] = x[X_TEMPERATURE, j]


@jit()
def drive_step(tick: int, p: Array, s: Array, counts: NDArray[np.int64], x: Array, links: Array, noise: Array,
               row: Array) -> None:
    """One step of controller, motors and gears; the torque for the links is left in ``links[L_TORQUE]``.

    Args:
        tick: number of the step since the start.
        p: parameter block ``(PARAMETERS, n)``, see ``drive_parameters``, with the next two.
        s: numbers that all joints share, ``S_…``.
        counts: steps of the cycles ``(4,)``.
        x: state block, changed in place.
        links: ``(4, n)``: arm angles [rad], arm velocities [rad/s], additional torque on the motor side [N m], and, as
            the result, what drives the links [N m]: gear torque (of rigid gears motor torque less friction, for link
            *and* rotor) with balancer and hose.
        noise: standard normal numbers for the measured current, one per joint.
        row: row of the log to be filled if the step is due for logging.
    """
    dt, n = s[S_DT], links.shape[1]
    fraction = (tick % counts[N_IPO]) / counts[N_IPO]
    due = tick % counts[N_POSITION] == 0, tick % counts[N_VELOCITY] == 0
    log_due = tick % counts[N_LOG] == 0
    if log_due:
        row[0] = tick * dt
    for j in range(n):
        q_a, qd_a, elastic = links[L_ANGLE, j], links[L_VELOCITY, j], p[P_ELASTIC, j] > 0.0
        uneven, slope = 0.0, 1.0  # transmission error: the gear's output is q_m + A sin(order · q + phase)
        if p[P_UNEVEN, j] > 0.0:
            angle = p[P_UNEVEN_ORDER, j] * (x[X_MOTOR, j] if elastic else q_a) + p[P_PHASE, j]
            uneven = p[P_UNEVEN, j] * math.sin(angle)
            slope = 1.0 + p[P_UNEVEN, j] * p[P_UNEVEN_ORDER, j] * math.cos(angle)
        if p[P_TURNS, j] > 0.0:  # and its parts of one and two periods per turn of the joint
            angle = x[X_MOTOR, j] if elastic else q_a
            once, twice = angle + p[P_ONCE_PHASE, j], 2.0 * angle + p[P_TWICE_PHASE, j]
            uneven += p[P_ONCE, j] * math.sin(once) + p[P_TWICE, j] * math.sin(twice)
            slope += p[P_ONCE, j] * math.cos(once) + 2.0 * p[P_TWICE, j] * math.cos(twice)
        if not elastic:
            x[X_MOTOR, j], x[X_MOTOR_VELOCITY, j] = q_a - uneven, qd_a / slope
        q_m, v_m = x[X_MOTOR, j], x[X_MOTOR_VELOCITY, j]
        _control_step(p, s, x, j, q_m, fraction, due)
        x[X_CURRENT, j] += s[S_CURRENT_PASS] * (x[X_TORQUE, j] - x[X_CURRENT, j])
        motor = x[X_CURRENT, j] * p[P_GAIN, j]
        # Drives measure the mean current since the last sample: the torque falls and jumps within each position cycle,
        # and samples at its jumps would suggest a wrong inertia.
        row[1 + 2 * n + j] += x[X_CURRENT, j]
        if log_due:
            _log_joint(p, x, links, j, counts[N_LOG] if tick > 0 else 1, noise[j], row)
        if p[P_RIPPLE, j] > 0.0:
            motor += p[P_RIPPLE, j] * math.sin(p[P_RIPPLE_ORDER, j] * q_m + p[P_PHASE, j])
        motor += links[L_EXTRA, j]
        gear = _gear_torque(p, j, q_m + uneven - q_a, slope * v_m - qd_a) if elastic else motor
        if elastic and p[P_HYSTERESIS, j] > 0.0:
            twist = q_m + uneven - q_a
            x[X_HYSTERESIS, j] = _turned_round(x[X_HYSTERESIS, j], twist - x[X_TWIST, j], p[P_HYSTERESIS_WAY, j])
            x[X_TWIST, j] = twist
            gear += p[P_HYSTERESIS, j] * x[X_HYSTERESIS, j]
        friction = _friction_step(p, s, x, j, v_m)
        if elastic:
            x[X_MOTOR_VELOCITY, j] = v_m + dt * (motor - friction - slope * gear) / p[P_ROTOR, j]
            x[X_MOTOR, j] = q_m + dt * x[X_MOTOR_VELOCITY, j]
        x[X_GEAR, j] = links[L_TORQUE, j] = gear if elastic else motor - friction
        if p[P_BALANCER, j] > 0.0:
            links[L_TORQUE, j] -= p[P_BALANCER, j] * balancer_shape(q_a - p[P_BALANCER_TOP, j])
        if p[P_HOSE, j] > 0.0 or p[P_HOSE_FRICTION, j] > 0.0:
            x[X_HOSE, j] = _turned_round(x[X_HOSE, j], q_a - x[X_HOSE_ANGLE, j], SLIPS)
            x[X_HOSE_ANGLE, j] = q_a
            links[L_TORQUE, j] -= p[P_HOSE, j] * (q_a - p[P_HOSE_REST, j]) + p[P_HOSE_FRICTION, j] * x[X_HOSE, j]
        if log_due:
            row[1 + 8 * n + j] = x[X_GEAR, j]
