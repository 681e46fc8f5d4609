"""Dry friction: the second term of [G] (1)."""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class Coulomb(Effect):
    """``tau = a_2 sign(qd)`` ([G] (1)): more, or less, dry friction than the model has."""

    name = "coulomb"
    coefficient_names = ("change of Coulomb friction",)
    absorbed_by_base = True
    source = "[G] (1)"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, signals.sliding_direction(joint))

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction over speed."""
        return LoopChange(friction_curve=True)
