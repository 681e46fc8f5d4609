"""The controller's axis angles in degrees and the URDF's joint angles in radians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot


@dataclass(frozen=True)
class Axes:
    """``q = sign · (A - zero)``, joint by joint.

    Attributes:
        sign: 1, or -1 where the controller counts against the URDF's axis ``(n,)``.
        zero: what the controller shows where the URDF's angle is zero ``(n,)`` [deg].
        known: whether the robot's data said so, or nothing is known and both are taken to count alike.
    """

    sign: Array
    zero: Array
    known: bool

    @classmethod
    def of(cls, robot: Robot) -> Axes:
        """From the table ``[rsi]`` of the robot's data: ``axis_sign`` and ``axis_zero`` [deg].

        Raises:
            InputError: a sliding joint, wrong length or values.
        """
        if robot.prismatic.any():
            raise InputError("sliding joints cannot be corrected in degrees; RSI needs an arm with turning joints",
                             file=robot.urdf, field="joint")
        table = robot.data.get("rsi", {})
        sign = _per_axis(table, "axis_sign", np.ones(robot.n))
        if not np.isin(sign, (-1.0, 1.0)).all():
            raise InputError("expected 1 or -1 for every joint", field="rsi.axis_sign", value=sign.tolist())
        return cls(sign, _per_axis(table, "axis_zero", np.zeros(robot.n)), "axis_sign" in table)

    def joints(self, angles: Array) -> Array:
        """Joint angles ``(n,)`` [rad] of axis angles [deg]."""
        return np.asarray(self.sign * np.radians(angles - self.zero))

    def turned(self, degrees: Array) -> Array:
        """Changes of joint angles ``(n,)`` [rad] of changes of axis angles [deg]."""
        return np.asarray(self.sign * np.radians(degrees))

    def angles(self, q: Array) -> Array:
        """Axis angles ``(n,)`` [deg] of joint angles [rad]."""
        return np.asarray(self.sign * np.degrees(q) + self.zero)


def _per_axis(table: dict[str, object], key: str, default: Array) -> Array:
    try:
        values = np.array(table.get(key, default), dtype=float)
    except (TypeError, ValueError):
        values = np.array([])
    if values.shape != default.shape or not np.isfinite(values).all():
        raise InputError(f"expected {len(default)} numbers, one per joint", field=f"rsi.{key}", value=table.get(key))
    return values
