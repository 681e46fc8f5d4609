"""A joint's zero is elsewhere than the controller believes; gravity betrays it."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class ZeroError(Effect):
    """The true angle is ``q_j + e``: ``delta tau = e d tau_rigid/d q_j`` on all joints.

    Masses that are free to change take most of it, so it is looked for against a model known before.
    """

    name = "zero_error"
    coefficient_names = ("angle",)
    coefficient_units = ("rad",)
    absorbed_by_base = True
    source = "derivative of [G] (5) by one angle"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The rigid body has to be known as a function, and the angle has to matter to it."""
        if signals.rigid is None:
            return False
        return bool(np.max(np.abs(self.columns(signals, joint, ()))) > 1e-6 * np.max(np.abs(signals.load)) + 1e-12)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        if signals.derivatives is None:
            return np.zeros((len(signals.t), signals.n, 1))
        return signals.derivatives.by(joint)[0][:, :, None]

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Degrees, not another mounting."""
        return bool(abs(coefficients[0]) < 0.2)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The rigid body is at other angles, and so is the tool."""
        return LoopChange(zero=coefficients[0])
