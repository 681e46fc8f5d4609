"""Friction of a gear as it truly is in the simulated world: a dynamic law none of the fitted models can copy.

Bristles (LuGre, Canudas de Wit et al. 1995) carry the dry part, an Eyring fluid the hydrodynamic one:

    z'    = v - σ0 |v| / g(v) z                       presliding: bristles bend elastically by z
    g(v)  = (F_c + F_s exp(-(v / v_s)²)) · load · dry temperature       Coulomb and Stribeck
    τ_f   = σ0 z + σ1 z' + viscosity(T) · (f_v v + F_e asinh(v / v_e))   asinh: degressive (Eyring)
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ideal_robot.interface import Array
from sim.world import World


@njit(cache=True, inline="always")
def bristle_step(z: float, v: float, g: float, sigma0: float, dt: float) -> float:
    """Bristle deflection after ``dt`` at constant velocity: the exact solution, so stable at any step."""
    if v == 0.0:
        return z
    settled = g / sigma0 if v > 0.0 else -g / sigma0
    return settled + (z - settled) * math.exp(-abs(v) * sigma0 * dt / g)


@njit(cache=True, inline="always")
def dry_level(v: float, coulomb: float, surplus: float, v_stribeck: float, asymmetry: float) -> float:
    """Level g(v) of dry friction at the reference temperature and without load [N m]."""
    side = 1.0 + asymmetry if v > 0.0 else 1.0 - asymmetry
    ratio = v / v_stribeck
    return side * (coulomb + surplus * math.exp(-ratio * ratio))


@njit(cache=True, inline="always")
def hydrodynamic(v: float, viscous: float, degressive: float, v_degressive: float) -> float:
    """Fluid friction at the reference temperature [N m]."""
    return viscous * v + degressive * math.asinh(v / v_degressive)


def steady_friction(world: World, n: int, velocity: Array, temperature: float | None = None) -> Array:
    """Friction torque ``(N, n)`` [N m] after sliding long enough at ``velocity (N, n)``, without load.

    For tests and documents about the world; no model may use it.
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
