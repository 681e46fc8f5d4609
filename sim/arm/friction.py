"""Friction of a gear as it truly is in the simulated world: a dynamic law none of the fitted models can copy.

Bristles (LuGre, Canudas de Wit et al. 1995) carry the dry part, an Eyring fluid the hydrodynamic one:

    z'    = v - σ0 |v| / g(v) z                       presliding: bristles bend elastically by z
    g(v)  = (F_c + F_s exp(-(v / v_s)²)) · load · dry temperature       Coulomb and Stribeck
    τ_f   = σ0 z + σ1 z' + viscosity(T) · (f_v v + F_e asinh(v / v_e))   asinh: degressive (Eyring)
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from sim.arm.world import World


def steady_friction(world: World, n: int, velocity: Array, temperature: float | None = None) -> Array:
    """Friction torque ``(N, n)`` [N m] after sliding long enough at ``velocity (N, n)``, without load.

    For tests and documents about the world; no model may use it.

    Args:
        world: the true world.
        n: number of joints.
        velocity: on the joint side ``(N, n)`` [rad/s].
        temperature: of all gears [°C]; the world's reference temperature if None.
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
