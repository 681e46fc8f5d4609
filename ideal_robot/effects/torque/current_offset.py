"""A constant error of the current measurement or of the zero of a torque."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class CurrentOffset(Effect):
    """``tau = o``: a constant the model does not have."""

    name = "current_offset"
    coefficient_names = ("offset",)
    absorbed_by_base = True
    source = "[J] section 3: offset of the current sensors"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, np.ones_like(signals.t))

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """A constant torque."""
        return LoopChange(offset=coefficients[0])
