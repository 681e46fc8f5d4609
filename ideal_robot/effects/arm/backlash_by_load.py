"""Play in the gear as the arm angle shows it, crossed where the load changes sign."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.domain import ARM_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class ArmBacklashByLoad(Effect):
    """Seen in the arm's position, load deciding: ``q_a - q = -b tanh(tau_load/w)``."""

    name = "backlash"
    domain = ARM_POSITION
    prefix = "qa_load"
    theta_names = ("crossing load",)
    theta_units = ("N m",)
    coefficient_names = ("half gap",)
    coefficient_units = ("rad",)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002: dead zone model"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The load has to change sign."""
        return 0.02 < float(np.mean(signals.load[:, joint - 1] > 0.0)) < 0.98

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Fractions of the load."""
        size = float(np.std(signals.load[:, joint - 1])) + 1e-12
        return [(size * factor,) for factor in (0.05, 0.15)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Much sharper than the load itself."""
        size = float(np.std(signals.load[:, joint - 1])) + 1e-12
        return [(0.01 * size, 0.4 * size)]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, -np.tanh(signals.load[:, joint - 1] / theta[0]))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. The load pushes the arm away, not towards itself."""
        return bool(coefficients[0] > 0.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The play, crossed where the load changes sign."""
        return LoopChange(half_gap=coefficients[0], gap_load=theta[0])
