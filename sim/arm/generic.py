"""The default world of an arm without a world file, with sizes in proportion to its inertias and torque limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.robots.joints import mass_matrix
from ideal_robot.robots.robot import Robot, spread_postures
from ideal_robot.robots.size import WEAKEST

STEP = 0.0005
"""Time step of the simulated arm [s]; every cycle time is a multiple of it."""
RESONANCE = 15.0
"""[Hz] of a link on its gear with the motor held; 10 to 20 Hz is common for base axes."""
DAMPING = 0.07
"""Of that resonance, relative to critical."""
SAG = 1.0e-3
"""[rad] that gravity may twist a gear."""
BANDWIDTH = 60.0
"""[rad/s] of the velocity loop."""
GEAR = 100.0
"""Motor turns per joint turn of a drive whose ratio nobody tells: harmonic drives of arms have 50 to 160."""
LAG = 0.002
"""Time from an encoder reading to the torque that answers it [s]: velocity cycle, its filter, the current loop."""
MARGIN = 2.0
"""Factor by which the gain of a cascade could be raised before it is unstable, 6 dB."""

FOLLOWED = 1.0
"""Oscillation that the simulation's step is to follow, and rate at which a gear's damping acts, times the step;
``SimulatedArm`` refuses oscillations of 1.2, and with (ω h)² / 2 + 2 ζ ω h of 2 the step is unstable."""
SWEPT = 25
"""Angles of each joint at which it is looked at."""


def generic_world(robot: Robot) -> dict[str, Any]:
    """The settings that ``World(robot=…, **settings)`` needs per joint, for any robot that Pinocchio can load.

    Friction takes about a tenth of the torque limit (of the gravity and inertia torque of a moderate motion where no
    limit is given). Rotors of unknown inertia get the one that the torque limit turns with 300 rad/s² (a third of the
    link's where no limit is given): as every geared drive has a rotor. Inertias and gravity are those of the home
    posture, of an arm whose data name none the mean and the largest over its range.
    """
    mass, gravity, lightest = _loads(robot)
    guess = np.where(np.isfinite(robot.tau_max), _strength(robot, gravity, mass) / 300.0, mass / 3.0)
    extra = np.where(robot.rotor_inertia > 0.0, 0.0, guess)
    rotor = robot.rotor_inertia + extra
    strength = _strength(robot, gravity, mass + rotor)
    fast = np.where(np.isfinite(robot.v_max), robot.v_max, 2.0)
    # A light last link must not cause oscillations that a 0.5 ms step cannot follow.
    link = np.maximum(mass, 0.2 * rotor)
    stiffness = np.maximum((2 * np.pi * RESONANCE) ** 2 * link, gravity / SAG)
    damping = 2 * DAMPING * np.sqrt(stiffness * link)
    rigid = too_fast(robot, stiffness, damping, rotor)
    gain = np.array([_stable(BANDWIDTH * (m + j), j, (light, m), k, d)
                     for m, j, light, k, d in zip(mass, rotor, lightest, stiffness, damping, strict=True)])
    turns = np.where(robot.gear_ratio > 1.0, 1.0, GEAR)
    settings: dict[str, Array] = {
        "extra_rotor_inertia": extra,
        "stiffness": np.where(rigid, np.inf, stiffness),
        "damping": damping,
        "coulomb": 0.045 * strength,
        "stribeck": 0.012 * strength,
        "stribeck_velocity": 0.015 * fast,
        "presliding": np.full(robot.n, 3.0e-4),
        "viscous": 0.02 * strength / fast,
        "degressive": 0.010 * strength,
        "degressive_velocity": 0.05 * fast,
        "load_friction": np.full(robot.n, 0.25),
        "thermal_resistance": 25.0 / (0.1 * strength * 0.4 * fast),
        "velocity_gain": gain,
        "encoder_increments": 16384.0 * turns,
        "ripple_order": 2.0 * turns,
        # Ripple and noise are relative to the torque limit, which may be far above what the joint needs.
        "torque_ripple": 0.004 * strength / np.where(np.isfinite(robot.tau_max), robot.tau_max, strength),
        "current_noise": 0.005 * strength / np.where(np.isfinite(robot.tau_max), robot.tau_max, strength),
    }
    return {name: tuple(float(v) for v in values) for name, values in settings.items()}


def _loads(robot: Robot) -> tuple[Array, Array, Array]:
    """Usual moment of inertia [kg m²], gravity torque [N m], least moment of inertia of each joint, ``(n,)`` each."""
    model, data = robot.pinocchio, robot.pinocchio.createData()
    postures = [robot.home] if "home" in robot.data.get("joints", {}) else spread_postures(robot.q_min, robot.q_max)
    inertia = np.array([mass_matrix(model, data, q).diagonal() for q in postures])
    gravity = np.array([np.abs(pin.computeGeneralizedGravity(model, data, q)) for q in postures])
    return inertia.mean(axis=0), gravity.max(axis=0), inertia.min(axis=0)


def _strength(robot: Robot, gravity: Array, inertia: Array) -> Array:
    """What friction is measured by ``(n,)`` [N m]: the torque limit, or gravity and 5 rad/s² where none is given.

    A limit far above what gravity and 60 rad/s² ask for does not count: such a drive would stick, which no real
    one does. A wrist's drive is not weaker than ``WEAKEST`` of the strongest, however little it carries.
    """
    needed = 1.5 * gravity + 60.0 * inertia
    weakest = WEAKEST * np.where(robot.prismatic, 0.0, needed).max()
    needed = np.where(robot.prismatic, needed, np.maximum(needed, weakest))
    return np.where(np.isfinite(robot.tau_max), np.minimum(robot.tau_max, needed), 1.5 * gravity + 5.0 * inertia)


# Oscillations that the simulation's step cannot follow.

def fastest(mass: Array, stiffness: Array, rotor: Array) -> tuple[float, int]:
    """Fastest oscillation of links M, rotors J and gears K in a posture [rad/s], and the gear that takes most part.

    Its squared frequencies are those of √K (M⁻¹ + J⁻¹) √K; a rigid gear has its rotor in M and no part in it.

    Args:
        mass: of the links ``(n, n)`` [kg m²].
        stiffness: of the gears ``(n,)`` [N m/rad], infinite where rigid.
        rotor: on the joint side ``(n,)`` [kg m²].
    """
    rigid = np.isinf(stiffness)
    root = np.sqrt(np.where(rigid, 0.0, stiffness))
    # A last link without inertia of its own gets a millionth of its rotor's.
    turned = np.linalg.inv(mass + np.diag(np.where(rigid, rotor, 1e-6 * rotor)))
    values, ways = np.linalg.eigh(root[:, None] * (turned + np.diag(np.where(rigid, 0.0, 1.0 / rotor))) * root)
    return float(np.sqrt(max(values[-1], 0.0))), int(np.argmax(np.abs(ways[:, -1])))


def too_fast(robot: Robot, stiffness: Array, damping: Array, rotor: Array) -> NDArray[np.bool_]:
    """Gears that have to be rigid ``(n,)``, so that the simulation step can follow all oscillations in any posture.

    And their damping: on a last link that is far lighter than its drive it acts faster than the gear oscillates.

    Where two axes fall together, a slim link between them alone holds their gears apart.

    Args:
        robot: the arm.
        stiffness: of its gears ``(n,)`` [N m/rad].
        damping: of its gears ``(n,)`` [N m s/rad].
        rotor: on the joint side ``(n,)`` [kg m²].
    """
    model, data = robot.pinocchio, robot.pinocchio.createData()
    low, high = np.clip(robot.q_min, -np.pi, np.pi), np.clip(robot.q_max, -np.pi, np.pi)
    swept = np.tile(robot.home, (robot.n, SWEPT, 1))
    for j in range(robot.n):
        swept[j, :, j] = np.linspace(low[j], high[j], SWEPT)
    stiffened = np.array(stiffness)
    for q in [*spread_postures(robot.q_min, robot.q_max), *swept.reshape(-1, robot.n)]:
        mass = mass_matrix(model, data, q)
        while (worst := fastest(mass, stiffened, rotor))[0] > FOLLOWED / STEP:
            stiffened[worst[1]] = np.inf
        # The rates are those of √D (M⁻¹ + J⁻¹) √D.
        while (worst := fastest(mass, np.where(np.isinf(stiffened), np.inf, damping), rotor))[0] ** 2 > FOLLOWED / STEP:
            stiffened[worst[1]] = np.inf
    return np.isinf(stiffened)


# Stability of a cascade on a rotor that a spring connects with its link.

def _stable(gain: float, rotor: float, links: tuple[float, ...], stiffness: float, damping: float) -> float:
    """The gain of the velocity loop [N m s/rad], lowered until the cascade has its margin with each of ``links``."""
    while gain > 1e-3 * BANDWIDTH * rotor and max(
            growth(factor * gain, rotor, link, stiffness, damping) for link in links for factor in (1.0, MARGIN)) > 0.0:
        gain *= 0.9
    return gain


def growth(gain: float, rotor: float, link: float, stiffness: float, damping: float, k_v: float = 20.0,
           T_i: float = 0.05) -> float:
    """Largest real part of the poles of a cascade [1/s]; below 0 it is stable.

    States: rotor and link with their velocities, the velocity loop's integral, and the torque, which lags twice.

    Args:
        gain: of the velocity loop [N m s/rad].
        rotor: [kg m²].
        link: [kg m²].
        stiffness: of the gear [N m/rad].
        damping: of the gear [N m s/rad].
        k_v: position gain [1/s].
        T_i: integral time [s].
    """
    link = max(link, 1e-9)
    A = np.zeros((7, 7))
    A[0, 1] = A[2, 3] = 1.0
    A[1] = np.array([-stiffness, -damping, stiffness, damping, 0.0, 0.0, 1.0]) / rotor
    A[3] = np.array([stiffness, damping, -stiffness, -damping, 0.0, 0.0, 0.0]) / link
    A[4, :2] = -k_v, -1.0
    A[5] = np.array([-gain * k_v, -gain, 0.0, 0.0, gain / T_i, -1.0, 0.0]) / (0.5 * LAG)
    A[6, 5], A[6, 6] = 2.0 / LAG, -2.0 / LAG
    return float(np.max(np.linalg.eigvals(A).real))
