"""A force sensor that shows something when nothing touches the tool."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.domain import SENSOR
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals

MOMENTS = "moments"
"""Signal that says whether the sensor measures moments (1) or only forces (0)."""


class ForceBias(Effect):
    """A constant in the sensor's own frame, ``delta w = b``, whatever the tool's orientation.

    The tool's weight turns with the orientation, ``f = m R' g``, ``m = (m c) × R' g``, and is fitted beside it.
    """

    name = "force_bias"
    domain = SENSOR
    prefix = "force"
    depends_on_joint = False
    coefficient_names = ("fx", "fy", "fz", "mx", "my", "mz")
    coefficient_units = ("N", "N", "N", "N m", "N m", "N m")
    source = "[L] 4.4: bias and weight of the tool from several orientations"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The sensor."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """A wrench in free motion has to be there."""
        return MOMENTS in signals.extra

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 6, 6)``, or ``(N, 3, 3)`` for a sensor of forces alone."""
        count = 6 if MOMENTS in signals.extra and bool(np.all(signals.extra[MOMENTS] > 0.5)) else 3
        return np.tile(np.eye(count), (len(signals.t), 1, 1))

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The components of the wrench that the sensor has."""
        return [EffectParameter(name, float(value), float(s), unit) for name, unit, value, s in
                zip(self.coefficient_names, self.coefficient_units, coefficients, std, strict=False)]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The wrench that the sensor measures."""
        return LoopChange(wrench=coefficients)
