"""Play in the gear as the motor torque shows it."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.joint_elasticity import JointElasticity


class Backlash(JointElasticity):
    """Seen in the motor torque: the arm lies on one side of the gap or the other, ``q_a = q - b tanh(tau_load/w)``.

    As a soft gear, but what it bends by does not grow with the load: it jumps where the load changes sign. theta is
    ``w``, the load over which it crosses; the coefficient is half the gap ``b``.
    """

    name = "backlash"
    theta_names = ("crossing load",)
    theta_units = ("N m",)
    coefficient_names = ("half gap",)
    coefficient_units = ("rad",)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002: dead zone model"

    _slow = 5.0
    """A gap is crossed at once: what the position filter makes of that is not taken for load, up to half as far."""

    def usable(self, signals: Signals, joint: int) -> bool:
        """The load has to change sign."""
        load = signals.load[:, joint - 1]
        return signals.rigid is not None and 0.02 < float(np.mean(load > 0.0)) < 0.98

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Fractions of the load."""
        size = float(np.std(signals.load[:, joint - 1])) + 1e-12
        return [(size * factor,) for factor in (0.05, 0.15, 0.4)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Sharper than the load itself."""
        size = float(np.std(signals.load[:, joint - 1])) + 1e-12
        return [(0.02 * size, 0.6 * size)]

    def bend(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``JointElasticity.bend``."""
        return np.asarray(np.tanh(self.slow_load(signals, joint) / theta[0]))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. A gap, not a range of motion."""
        return bool(0.0 < coefficients[0] < 0.02)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. Half the gap and the crossing load."""
        return Effect.parameters(self, coefficients, std, theta, theta_std)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The play, crossed where the load changes sign."""
        return LoopChange(half_gap=coefficients[0], gap_load=theta[0])
