"""The default world of an arm without a world file: sizes in proportion to its inertias and torque limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot

RESONANCE = 15.0
"""[Hz] of a link on its gear with the motor held, in the home posture; 10 to 20 Hz is common for base axes."""
DAMPING = 0.07
"""Of that resonance, relative to critical."""
SAG = 1.0e-3
"""[rad] that gravity may twist a gear in the home posture."""
BANDWIDTH = 60.0
"""[rad/s] of the velocity loop."""


def generic_world(robot: Robot) -> dict[str, Any]:
    """The settings that ``World`` needs per joint, for any robot that Pinocchio can load.

    Friction takes about a tenth of the torque limit (of the gravity and inertia torque of a moderate motion where no
    limit is given). Rotors that the robot data do not know get the inertia that the torque limit turns with
    300 rad/s² (a third of the link's where no limit is given): no geared drive is without.

    Returns:
        Settings by name, ready for ``World(robot=…, **settings)``.
    """
    model = robot.pinocchio
    mass = pin.crba(model, model.createData(), robot.home).diagonal().copy()
    guess = np.where(np.isfinite(robot.tau_max), robot.tau_max / 300.0, mass / 3.0)
    extra = np.where(robot.rotor_inertia > 0.0, 0.0, guess)
    rotor = robot.rotor_inertia + extra
    strength = _strength(robot, mass + rotor)
    fast = np.where(np.isfinite(robot.v_max), robot.v_max, 2.0)
    # A light last link must not ask for oscillations that a 0.5 ms step cannot follow.
    link = np.maximum(mass, 0.2 * rotor)
    stiffness = np.maximum((2 * np.pi * RESONANCE) ** 2 * link, _gravity(robot) / SAG)
    settings: dict[str, Array] = {
        "extra_rotor_inertia": extra,
        "stiffness": stiffness,
        "damping": 2 * DAMPING * np.sqrt(stiffness * link),
        "coulomb": 0.045 * strength,
        "stribeck": 0.012 * strength,
        "stribeck_velocity": 0.015 * fast,
        "presliding": np.full(robot.n, 3.0e-4),
        "viscous": 0.02 * strength / fast,
        "degressive": 0.010 * strength,
        "degressive_velocity": 0.05 * fast,
        "load_friction": np.full(robot.n, 0.25),
        "thermal_resistance": 25.0 / (0.1 * strength * 0.4 * fast),
        "velocity_gain": BANDWIDTH * (mass + rotor),
        # Ripple and noise are relative to the torque limit, which may be far above what the joint needs.
        "torque_ripple": 0.004 * strength / np.where(np.isfinite(robot.tau_max), robot.tau_max, strength),
        "current_noise": 0.005 * strength / np.where(np.isfinite(robot.tau_max), robot.tau_max, strength),
    }
    return {name: tuple(float(v) for v in values) for name, values in settings.items()}


def _strength(robot: Robot, inertia: Array) -> Array:
    """What friction is measured by ``(n,)`` [N m]: the torque limit, or gravity and 5 rad/s² where none is given.

    A limit far above what gravity and 60 rad/s² ask for does not count: such a drive would stick, which no real
    one does.
    """
    gravity = 1.5 * _gravity(robot)
    return np.where(np.isfinite(robot.tau_max), np.minimum(robot.tau_max, gravity + 60.0 * inertia),
                    gravity + 5.0 * inertia)


def _gravity(robot: Robot) -> Array:
    """Size of the gravity torque in the home posture ``(n,)`` [N m]."""
    return np.abs(pin.computeGeneralizedGravity(robot.pinocchio, robot.pinocchio.createData(), robot.home))
