"""The Stribeck effect: friction that falls with speed near standstill, [G] (4)."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class Stribeck(Effect):
    """``tau = a_3 sign(qd) exp(-a_4 |qd|)`` with ``a_3 > 0`` ([G] (4), written for both directions).

    theta is ``v_s = 1 / a_4``, the speed at which the excess has fallen to 37 %.
    """

    name = "stribeck"
    theta_names = ("v_s",)
    theta_units = ("rad/s",)
    coefficient_names = ("excess at standstill",)
    of_slow_motion = True
    standstill = -1
    discriminating_motion = (
        ("degressive", "constant-velocity runs at ten speeds, the slowest below 1 % of the highest"),
    )
    source = "[G] (4)"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """From a fiftieth of the top speed to a third of it."""
        top = float(np.percentile(np.abs(signals.qd[:, joint - 1]), 99)) + 1e-12
        return [(top * factor,) for factor in (0.02, 0.05, 0.1, 0.2, 0.35)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """The fall is over within the range of speeds that was driven."""
        top = float(np.percentile(np.abs(signals.qd[:, joint - 1]), 99)) + 1e-12
        return [(0.01 * top, 0.5 * top)]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        qd = signals.qd[:, joint - 1]
        return signals.on_joint(joint, signals.sliding_direction(joint) * np.exp(-np.abs(qd) / theta[0]))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Friction is larger, not smaller, near standstill."""
        return bool(coefficients[0] > 0.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction over speed."""
        return LoopChange(friction_curve=True)
