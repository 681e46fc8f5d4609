"""What the settings of a world may be: types and ranges, key by key."""

from __future__ import annotations

from typing import Any

import numpy as np

from ideal_robot.errors import InputError

_POSITIVE = {"stiffness", "stribeck_velocity", "presliding", "degressive_velocity", "thermal_time_constant",
             "encoder_increments", "t_ipo", "t_position", "t_velocity", "log_cycle", "velocity_gain", "integral_time",
             "position_gain", "lubrication_time", "ripple_order", "transmission_order"}
_SIGNED = {"start_temperature", "ambient_temperature", "reference_temperature", "payload_com", "friction_asymmetry"}
_CYCLES = {"t_ipo", "t_position", "t_velocity", "log_cycle"}
_LONGEST = 1.0
"""Longest cycle [s]."""
_FRACTION = {"inertia_tolerance": 0.9, "drive_gain_error": 0.9, "friction_asymmetry": 0.9}


def checked_value(name: str, kind: str, value: Any) -> Any:
    """The value in its final type: ``bool``, ``int``, ``float`` or a tuple of ``float``.

    Args:
        name: the key.
        kind: the type that its field is annotated with.
        value: what was given.

    Raises:
        InputError: wrong type or out of range; names the key.
    """
    if name in ("robot", "extra_torque"):
        return value
    field = f"world.{name}"
    if kind == "bool":
        if not isinstance(value, bool):
            raise InputError("expected true or false", field=field, value=value)
        return value
    if kind == "int":
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise InputError("expected a whole number that is not negative", field=field, value=value)
        return value
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError("expected a number or a list of numbers", field=field) from error
    if isinstance(value, (bool, str)) or np.isnan(array).any():
        raise InputError("expected a number or a list of numbers", field=field, value=value)
    if np.isinf(array).any() and name != "stiffness":
        raise InputError("must be finite", field=field)
    if name in _POSITIVE and (array <= 0).any():
        raise InputError("must be positive", field=field, value=array.tolist())
    if name not in _SIGNED and (array < 0).any():
        raise InputError("must not be negative", field=field, value=array.tolist())
    if name in _FRACTION and (np.abs(array) > _FRACTION[name]).any():
        raise InputError(f"is a fraction, at most {_FRACTION[name]}", field=field, value=array.tolist())
    if name in _CYCLES and (array > _LONGEST).any():
        raise InputError(f"must be at most {_LONGEST:g} s", field=field, value=array.tolist())
    if array.ndim == 0 and name != "payload_com":
        return float(array)
    if array.ndim != 1 or kind == "float" or (name == "payload_com" and array.shape != (3,)):
        expected = {"float": "one number", "PerJoint": "one number or one per joint"}.get(kind, "three numbers")
        raise InputError(f"expected {expected}", field=field, value=array.tolist())
    return tuple(array.tolist())
