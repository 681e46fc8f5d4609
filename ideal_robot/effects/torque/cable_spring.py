"""A cable or hose that pulls a joint back."""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.signals import Signals


class CableSpring(Effect):
    """``tau = k q``: a linear spring on one joint; its rest position goes into the constant offset."""

    name = "cable_spring"
    coefficient_names = ("stiffness",)
    coefficient_units = ("N m/rad",)
    of_angle_alone = True
    source = "hose packs and cables along the arm"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, signals.q[:, joint - 1])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. The motor works against the pull: a spring holds back, it does not push on."""
        return bool(coefficients[0] > 0.0)
