"""Settings of the simulated world as rows of a page, with their units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

UNITS = {
    "stiffness": "N m/rad", "damping": "N m s/rad", "backlash": "rad", "coulomb": "N m", "stribeck": "N m",
    "stribeck_velocity": "rad/s", "presliding": "rad", "viscous": "N m s/rad", "degressive": "N m",
    "degressive_velocity": "rad/s", "start_temperature": "°C", "ambient_temperature": "°C",
    "thermal_resistance": "K/W", "thermal_time_constant": "s", "viscosity_temperature": "1/K",
    "dry_temperature": "1/K", "reference_temperature": "°C", "lubrication_time": "s",
    "encoder_increments": "per motor turn", "current_noise": "of the limit", "torque_ripple": "of the limit",
    "ripple_order": "per motor turn", "low_pass": "s", "t_ipo": "s", "t_position": "s", "t_velocity": "s",
    "position_gain": "1/s", "velocity_gain": "N m s/rad", "integral_time": "s", "velocity_filter": "s",
    "current_lag": "s", "extra_rotor_inertia": "kg m²", "kinematic_error": "m", "zero_error": "rad",
    "twist_error": "rad",
    "transmission_error": "rad", "transmission_order": "per joint turn", "payload_mass": "kg", "payload_com": "m",
    "payload_inertia": "kg m²", "log_cycle": "s", "external_position_noise": "m", "external_rotation_noise": "rad",
}
"""Units of the settings that have one; the others are switches, shares and seeds."""
COLUMNS = ["setting", "value, per joint where there are several", "unit"]


def world_rows(world: Mapping[str, Any]) -> list[list[Any]]:
    """Rows of setting, value and unit.

    Args:
        world: from ``World.table()``.
    """
    return [[name.replace("_", " "), _short(value), UNITS.get(name, "")] for name, value in world.items()]


def _short(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return ", ".join(f"{one:.3g}" if isinstance(one, (int, float)) else str(one) for one in value)
    return value
