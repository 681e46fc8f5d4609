"""A gear that gives: the arm is not where the motor is."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.signals.preprocess import lowpass


class JointElasticity(Effect):
    """Seen in the motor torque: the arm moves on ``q_a = q - tau_load/K``.

        delta tau = tau_rigid(q - tau_load/K, …) - tau_rigid(q, …) ,

    on all joints, taken to first order in the compliance ``1/K``. Its trace is the second derivative of the load.
    """

    name = "joint_elasticity"
    coefficient_names = ("compliance",)
    coefficient_units = ("rad/(N m)",)
    source = "[J] (1), (2): elastic joint"

    _slow = 2.5
    """The position filter lets pass all of the band that is looked at; the load counts up to two thirds of that."""

    def usable(self, signals: Signals, joint: int) -> bool:
        """The rigid body has to be known as a function, and there has to be a load."""
        return signals.rigid is not None and float(np.std(signals.load[:, joint - 1])) > 0.0

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        if signals.derivatives is None or len(signals.t) < 3:
            return np.zeros((len(signals.t), signals.n, 1))
        bend = self.bend(signals, joint, theta)
        if signals.cutoff is not None:
            # The bend is in the recorded position, and of that the filter let pass only the slow part.
            bend = lowpass(bend, signals.dt, signals.cutoff)
        rate = signals.rate(bend)
        return -signals.derivatives.along(joint, bend, rate, signals.rate(rate))[:, :, None]

    def bend(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """What a unit coefficient bends the gear by.

        Args:
            signals: of ``N`` samples.
            joint: from 1.
            theta: nonlinear parameters, in ``theta_units``.

        Returns:
            Shape ``(N,)``, in rad (m) per unit of the coefficient.
        """
        return self.slow_load(signals, joint)

    def slow_load(self, signals: Signals, joint: int) -> Array:
        """Load as far as the motion asks for it ``(N,)``.

        It is computed from the motor's position, which holds the bend: where the bend sets in, the motor's acceleration
        jumps, and that jump is no load of the arm. In recorded motions it is filtered out.
        """
        load = signals.load[:, joint - 1]
        return load if signals.cutoff is None else lowpass(load, signals.dt, signals.cutoff / self._slow)

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. A spring holds, and bends by less than a twentieth of a radian in use."""
        bend = float(np.max(np.abs(signals.load[:, joint - 1])))
        return bool(0.0 < coefficients[0] * bend < 0.05) if bend else False

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The stiffness."""
        c = float(coefficients[0])
        return [EffectParameter("stiffness", 1.0 / c, float(std[0]) / c**2, "N m/rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The gear, as the torque says it: all of it."""
        return LoopChange(gear_compliance=coefficients[0])
