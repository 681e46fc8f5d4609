"""Friction that changes while the gear warms up, [G] Figs 3 and 12."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals

_TURNS = 0.3
"""Change of friction at one end of the speeds, over that at the other, up to which it may have the other sign."""


def warming_starts(signals: Signals, joint: int) -> list[tuple[float, ...]]:
    """Time constants to start from [s]: a tenth of the recording to three of it, and 0 for temperature if it varies."""
    span = float(signals.t[-1] - signals.t[0])
    starts: list[tuple[float, ...]] = [(span * factor,) for factor in (0.1, 0.3, 1.0, 3.0)]
    if signals.temperature is not None and float(np.ptp(signals.temperature[:, joint - 1])) > 0.5:
        starts.append((0.0,))
    return starts


def warming_bounds(signals: Signals) -> list[tuple[float, float]]:
    """Faster than a twentieth of the recording is no warming, slower than four times it is a straight line."""
    span = float(signals.t[-1] - signals.t[0])
    return [(0.05 * span, 4.0 * span)]


class ThermalDrift(Effect):
    """Viscous and dry friction follow the gear temperature, or the time since the start where it was not measured.

    ``tau = w (d_v qd + d_c sign(qd))`` with ``w`` the temperature above that of the start [K], or
    ``w = 1 - exp(-t/T)``: the warm-up of a first-order body. theta is ``T``; ``T = 0`` stands for "by temperature".
    """

    name = "thermal_drift"
    theta_names = ("T",)
    theta_units = ("s",)
    coefficient_names = ("change of viscous friction", "change of Coulomb friction")
    coefficient_units = ("N m s/rad", "N m")
    source = "[G] Figs 3, 12"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """By temperature if it varies; by time with constants from a tenth of the recording to three of it."""
        return warming_starts(signals, joint)

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Faster than a twentieth of the recording is no warming, slower than four times it is a straight line."""
        return warming_bounds(signals)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 2)``."""
        qd = signals.qd[:, joint - 1]
        if theta[0] > 0.0:
            warm = 1.0 - np.exp(-signals.t / theta[0])
        elif signals.temperature is not None:
            warm = signals.temperature[:, joint - 1] - signals.temperature[0, joint - 1]
        else:
            warm = np.zeros_like(qd)
        return signals.on_joint(joint, warm * qd, warm * signals.sliding_direction(joint))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. A gear that warms up loses friction, slow or fast; [G] Fig 12 has it rise nowhere.

        Less at one end of the speeds and more at the other is another curve over speed, not another temperature.
        """
        top = float(np.percentile(np.abs(signals.qd[:, joint - 1]), 99))
        slow, fast = float(coefficients[1]), float(coefficients[1] + coefficients[0] * top)
        return slow * fast > -_TURNS * max(slow**2, fast**2)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. Changes per kelvin where temperature was used."""
        if theta[0] > 0.0:
            return super().parameters(coefficients, std, theta, theta_std)
        units = ("N m s/(rad K)", "N m/K")
        return [EffectParameter(name, float(value), float(s), unit) for name, unit, value, s in
                zip(self.coefficient_names, units, coefficients, std, strict=True)]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Nowhere: the loop is not told how warm the gear is."""
        return LoopChange(nowhere="how warm a gear is when a path begins cannot be told from the time since a "
                                  "recording began; method adapted follows friction while the arm works")
