"""A wrong torque per ampere: all of a joint's torque is larger or smaller than it is read."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class DriveGain(Effect):
    """``tau = g tau_model``: the joint's whole torque scaled; ``g`` is the relative error of the drive gain.

    Inertia and gravity couple the joints, so that a gain of one drive alone is no change of inertias.
    """

    name = "drive_gain"
    coefficient_names = ("relative error of the gain",)
    coefficient_units = ("1",)
    absorbed_by_base = True
    source = "[J] (15): drive gains"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, signals.torque[:, joint - 1])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. A gain is positive and not wrong by a factor of three."""
        return bool(np.abs(coefficients[0]) < 2.0 and coefficients[0] > -0.7)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The controller asks in units of what is read."""
        return LoopChange(gain=coefficients[0])
