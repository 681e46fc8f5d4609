"""A gear that does not turn evenly."""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.effects.base import EffectParameter
from ideal_robot.effects.domain import ARM_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.torque.torque_ripple import TorqueRipple


class TransmissionError(TorqueRipple):
    """``q_a - q = a cos(k q) + b sin(k q)``: as ``torque_ripple``, of the position instead of the torque."""

    name = "transmission_error"
    domain = ARM_POSITION
    coefficient_units = ("rad", "rad")
    # Fewer are how bodies bend a gear over the range.
    least_periods = 4.5
    source = "kinematic error of gears, k a multiple of the gear ratio"

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. Amplitude in radians."""
        size, phase, order = super().parameters(coefficients, std, theta, theta_std)
        return [EffectParameter(size.name, size.value, size.std, "rad"), phase, order]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The gear turns unevenly."""
        return LoopChange(uneven=(theta[0], coefficients[0], coefficients[1]))
