"""A TCP measurement that is late."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.domain import TCP_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class ToolDeadTime(Effect):
    """The TCP measurement is late: ``x(t) = x_kin(t - delta)``, to first order ``-delta J qd``; of the whole arm."""

    name = "dead_time"
    domain = TCP_POSITION
    depends_on_joint = False
    coefficient_names = ("delay",)
    coefficient_units = ("s",)
    source = "first-order expansion of a pure delay"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """The frames have to be known."""
        return signals.frames is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 3, 1)``."""
        if signals.frames is None:
            return np.zeros((len(signals.t), 3, 1))
        return np.asarray(-np.einsum("kij,kj->ki", signals.frames.jacobian, signals.qd)[:, :, None])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Milliseconds, not tenths of a second."""
        return bool(abs(coefficients[0]) < 0.1)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Nowhere: it is in the recording alone."""
        return LoopChange(nowhere="only the record is late: the arm moves as it did")
