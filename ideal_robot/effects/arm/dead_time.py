"""An arm or TCP measurement that is late against the motor's."""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.domain import ARM_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class ArmDeadTime(Effect):
    """``q_a(t) = q(t - delta)``: to first order ``-delta qd``."""

    name = "dead_time"
    domain = ARM_POSITION
    coefficient_names = ("delay",)
    coefficient_units = ("s",)
    source = "first-order expansion of a pure delay"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, -signals.qd[:, joint - 1])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Milliseconds, not tenths of a second."""
        return bool(abs(coefficients[0]) < 0.1)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Nowhere: it is in the recording alone."""
        return LoopChange(nowhere="only the record is late: the arm moves as it did")
