"""Packs the settings of a world for the compiled step of motors, gears and controller."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from sim.arm import kernel
from sim.arm.specimen import Specimen
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
    kernel.P_ONCE: "transmission_once", kernel.P_TWICE: "transmission_twice",
    kernel.P_HOSE: "hose", kernel.P_HOSE_FRICTION: "hose_friction",
}
"""Rows of the parameter block that a key of the world fills as it is."""


def motor_torque_limit(robot: Robot) -> Array:
    """Joint-side torque limit of the motors ``(n,)`` [N m]; a very large number where the data sheet has none."""
    return np.where(np.isfinite(robot.tau_max), robot.tau_max, 1.0e12)


def drive_parameters(world: World, robot: Robot, specimen: Specimen) -> tuple[Array, Array, NDArray[np.int64]]:
    """Packs a world for ``drive_step``: parameters ``(PARAMETERS, n)``, shared numbers ``(11,)``, step counts ``(4,)``.

    Args:
        world: the true world.
        robot: data sheet of the arm.
        specimen: number of the individual arm of the type.

    Raises:
        InputError: a balancer at an arm without a second joint that turns.
    """
    n, rotor_inertia = robot.n, specimen.rotor_inertia
    limit = motor_torque_limit(robot)
    p = np.zeros((kernel.PARAMETERS, n))
    for row, name in _PER_JOINT.items():
        p[row] = world.per_joint(name, n)
    p[kernel.C_KI] = p[kernel.C_KP] * world.t_velocity / world.per_joint("integral_time", n)
    p[kernel.C_LIMIT] = limit if world.torque_limits else np.inf
    if world.quantisation:
        p[kernel.C_INCREMENT] = 2.0 * math.pi / (world.per_joint("encoder_increments", n) * robot.gear_ratio)
    p[kernel.P_ROTOR] = rotor_inertia
    stiffness = world.per_joint("stiffness", n) * world.per_joint("stiffness_scale", n)
    elastic = np.isfinite(stiffness) if world.elasticity else np.zeros(n, dtype=bool)
    p[kernel.P_ELASTIC] = elastic
    p[kernel.P_STIFFNESS] = np.where(elastic, stiffness, 0.0)
    p[kernel.P_HYSTERESIS] = 0.5 * p[kernel.P_STIFFNESS] * world.per_joint("hysteresis", n)
    p[kernel.P_HYSTERESIS_WAY] = HYSTERESIS_WAY * world.per_joint("hysteresis", n)
    p[kernel.P_DAMPING] = np.where(elastic, world.per_joint("damping", n), 0.0)
    p[kernel.P_BACKLASH] = np.where(elastic, world.per_joint("backlash", n), 0.0)
    _pack_friction(p, world, rotor_inertia, limit)
    p[kernel.P_GAIN] = specimen.drive_gain
    p[kernel.P_RIPPLE] = world.per_joint("torque_ripple", n) * np.where(np.isfinite(robot.tau_max), limit, 0.0)
    p[kernel.P_RIPPLE_ORDER] = world.per_joint("ripple_order", n) * robot.gear_ratio
    p[kernel.P_PHASE] = specimen.phase
    p[kernel.P_TURNS] = (p[kernel.P_ONCE] > 0.0) | (p[kernel.P_TWICE] > 0.0)
    p[kernel.P_ONCE_PHASE], p[kernel.P_TWICE_PHASE] = specimen.turn_phase
    p[kernel.P_HOSE_REST] = robot.home
    if world.balancer > 0.0:
        p[kernel.P_BALANCER, 1], p[kernel.P_BALANCER_TOP, 1] = world.balancer, top_of(robot)
    p[kernel.P_NOISE] = world.per_joint("current_noise", n) * np.where(np.isfinite(robot.tau_max), limit, 0.0)
    frequency = world.per_joint("notch_frequency", n)
    p[kernel.C_NOTCH] = frequency > 0.0
    p[kernel.C_NOTCH_B0 : kernel.C_NOTCH_A2 + 1] = notch(frequency, world.t_velocity)
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
    # Bristles are damped to a fifth of critical on the rotor: they neither oscillate nor dominate the torque.
    p[kernel.P_SIGMA1] = 0.4 * np.sqrt(p[kernel.P_SIGMA0] * np.maximum(rotor_inertia, 1.0e-6))
    # The drive compensates what its maker knew: dry friction of the type at the reference temperature.
    p[kernel.C_COMPENSATION] = world.per_joint("friction_compensation", n) * world.per_joint("coulomb", n)
    p[kernel.P_VISCOUS] = scale * world.per_joint("viscous", n)
    p[kernel.P_DEGRESSIVE] = scale * world.per_joint("degressive", n)
    p[kernel.P_LOAD] = world.per_joint("load_friction", n) / limit
    if world.thermal:
        p[kernel.P_THERMAL_RESISTANCE] = world.per_joint("thermal_resistance", n)
        p[kernel.P_THERMAL_RATE] = world.time_compression / world.per_joint("thermal_time_constant", n)


HYSTERESIS_WAY = 2.0
"""Twist over which a gear's hysteresis turns round, in widths of its loop: its largest stiffness beside the gear's own
is then a quarter of that, which the 0.5 ms step still follows."""


def hysteresis_stiffness(p: Array) -> Array:
    """Stiffness ``(n,)`` [N m/rad] that hysteresis adds to the gears just after a reversal; ``p``: parameter block."""
    way = p[kernel.P_HYSTERESIS_WAY]
    return np.asarray(np.divide(p[kernel.P_HYSTERESIS], way, out=np.zeros_like(way), where=way > 0.0))


def top_of(robot: Robot) -> float:
    """Angle of joint 2 [rad] at which its gravity torque vanishes and the arm stands upright, the others at home.

    Raises ``InputError`` for an arm whose second joint does not turn, or turns about the vertical.
    """
    if robot.n < 2 or robot.prismatic[1]:
        raise InputError("only an arm whose second joint turns can have a balancer", field="world.balancer")
    model, data, q = robot.pinocchio, robot.pinocchio.createData(), np.array(robot.home, dtype=float)
    weight = np.empty(2)
    for i in range(2):
        q[1] = 0.5 * math.pi * i
        weight[i] = pin.computeGeneralizedGravity(model, data, q)[1]
    # g(q) = g(0) cos q + g(90°) sin q; upright it is zero and falls.
    if np.hypot(*weight) < 1e-6:
        raise InputError("gravity has no torque in joint 2, so a balancer has no function", field="world.balancer")
    return math.atan2(weight[0], -weight[1])


def notch(frequency: Array, cycle: float) -> Array:
    """Coefficients b0, b1, b2, a1, a2 ``(5, n)`` of notches in the velocity loop's torque; ``frequency (n,)`` [Hz].

    The bilinear transform, warped to the frequency, of (s² + 2 d_z ω s + ω²) / (s² + 2 d_n ω s + ω²) with
    ``NOTCH`` = d_z, d_n: common drives let width and depth be set; these take away 80 % over half an octave.
    """
    k = np.tan(math.pi * np.minimum(frequency * cycle, 0.45))
    zeros, poles = (2.0 * d * k for d in NOTCH)
    scale = 1.0 / (1.0 + poles + k * k)
    middle = 2.0 * (k * k - 1.0) * scale
    return np.array([(1.0 + zeros + k * k) * scale, middle, (1.0 - zeros + k * k) * scale, middle,
                     (1.0 - poles + k * k) * scale])


NOTCH = (0.1, 0.5)
"""Damping of a notch's zeros and poles."""


def _share(cycle: float, time_constant: float) -> float:
    """Share of the difference by which a first-order low-pass moves in one cycle."""
    return 1.0 - math.exp(-cycle / time_constant) if time_constant > 0.0 else 1.0


def output_of(p: Array, q: Array) -> Array:
    """Angles of the gears' outputs ``(n,)`` [rad] with motors at ``q (n,)``: uneven transmission, no twist."""
    output = q + p[kernel.P_UNEVEN] * np.sin(p[kernel.P_UNEVEN_ORDER] * q + p[kernel.P_PHASE])
    if p[kernel.P_TURNS].any():
        output = output + p[kernel.P_ONCE] * np.sin(q + p[kernel.P_ONCE_PHASE])
        output = output + p[kernel.P_TWICE] * np.sin(2.0 * q + p[kernel.P_TWICE_PHASE])
    return np.asarray(output)


def beside_gears(p: Array, q: Array) -> Array:
    """Torques ``(n,)`` [N m] of balancer and hose on the links at rest at arm angles ``q (n,)`` [rad]."""
    shapes = [kernel.balancer_shape(angle) for angle in q - p[kernel.P_BALANCER_TOP]]
    return np.asarray(-p[kernel.P_BALANCER] * shapes - p[kernel.P_HOSE] * (q - p[kernel.P_HOSE_REST]))


def drive_start(p: Array, q0: Array, q_a: Array, holding_torque: Array, temperature: Array) -> Array:
    """State block ``(STATES, n)`` of drives that hold ``holding_torque (n,)`` at rest with motors at ``q0``.

    Args:
        p: parameter block ``(PARAMETERS, n)``.
        q0: motor angles ``(n,)`` [rad].
        q_a: arm angles ``(n,)`` [rad].
        holding_torque: the torque that holds the arm at rest ``(n,)`` [N m].
        temperature: of the gears ``(n,)`` [°C].
    """
    x = np.zeros((kernel.STATES, p.shape[1]))
    x[[kernel.X_START, kernel.X_END, kernel.X_LOW1, kernel.X_LOW2, kernel.X_COMMAND, kernel.X_ENCODER,
       kernel.X_MOTOR, kernel.X_TOLD_START, kernel.X_TOLD_END]] = q0
    x[[kernel.X_INTEGRAL, kernel.X_TORQUE, kernel.X_CURRENT]] = holding_torque / p[kernel.P_GAIN]
    x[kernel.X_GEAR] = holding_torque
    still = x[kernel.X_TORQUE]
    x[kernel.X_NOTCH2] = (p[kernel.C_NOTCH_B2] - p[kernel.C_NOTCH_A2]) * still
    x[kernel.X_NOTCH1] = x[kernel.X_NOTCH2] + (p[kernel.C_NOTCH_B1] - p[kernel.C_NOTCH_A1]) * still
    x[kernel.X_TEMPERATURE] = temperature
    x[kernel.X_LUBRICANT] = 1.0
    x[kernel.X_HOSE_ANGLE] = q_a
    x[kernel.X_TWIST] = output_of(p, q0) - q_a
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
