"""Friction proportional to velocity: the first term of [G] (1)."""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class Viscous(Effect):
    """``tau = a_1 qd`` ([G] (1)): more, or less, viscous friction than the model has."""

    name = "viscous"
    coefficient_names = ("change of viscous friction",)
    coefficient_units = ("N m s/rad",)
    absorbed_by_base = True
    source = "[G] (1)"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, signals.qd[:, joint - 1])

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction over speed."""
        return LoopChange(friction_curve=True)
