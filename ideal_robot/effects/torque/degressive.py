"""Friction that rises ever less with speed: the third terms of [G] (2) and (3)."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class Degressive(Effect):
    """``tau = a_3 arctan(a_4 qd)`` ([G] (3)); ``a_4 → 0`` of a wide range comes close to ``qd^(1/3)`` of [G] (2).

    Physically the rise is upwards, ``a_3 > 0``: with a falling characteristic it is the Stribeck effect.
    """

    name = "degressive"
    theta_names = ("a_4",)
    theta_units = ("s/rad",)
    coefficient_names = ("a_3",)
    of_slow_motion = True
    standstill = 1
    discriminating_motion = (
        ("viscous", "constant-velocity runs over the whole range of speeds"),
    )
    source = "[G] (2), (3)"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """From a bend at the fastest speed of the recording to one at a fortieth of it."""
        top = float(np.percentile(np.abs(signals.qd[:, joint - 1]), 99)) + 1e-12
        return [(factor / top,) for factor in (2.0, 4.0, 8.0, 16.0, 40.0)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """The bend lies inside the range of speeds that was driven."""
        top = float(np.percentile(np.abs(signals.qd[:, joint - 1]), 99)) + 1e-12
        return [(1.5 / top, 80.0 / top)]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, np.arctan(theta[0] * signals.qd[:, joint - 1]))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. The characteristic bends downwards from a rise."""
        return bool(coefficients[0] > 0.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction over speed."""
        return LoopChange(friction_curve=True)
