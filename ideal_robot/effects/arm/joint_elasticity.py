"""A gear that gives, as the arm angle shows it."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.domain import ARM_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class ArmElasticity(Effect):
    """Seen in the arm's position: ``q_a - q = -tau_load/K``."""

    name = "joint_elasticity"
    domain = ARM_POSITION
    coefficient_names = ("compliance",)
    coefficient_units = ("rad/(N m)",)
    source = "[J] (2)"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Without a load nothing bends."""
        return float(np.std(signals.load[:, joint - 1])) > 0.0

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, -signals.load[:, joint - 1])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. A spring gives way, it does not push back."""
        return bool(coefficients[0] > 0.0)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The stiffness."""
        c = float(coefficients[0])
        return [EffectParameter("stiffness", 1.0 / c, float(std[0]) / c**2, "N m/rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """What the gear gives beyond what was known."""
        return LoopChange(further_compliance=coefficients[0], from_arm_angle=True)
