"""All motor torques are recorded late by one filter or one clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import EffectParameter
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.dead_time import DeadTime, delayed


class TorqueFilter(DeadTime):
    """The torques of all joints pass one lag ``T`` before they are recorded: ``tau(t) = tau_model(t - T)``.

    Averaging, filters of any order and a clock of their own look alike well below their corner: a delay. One number
    for the whole arm (joint 0), tried before any joint has a delay of its own. A column of a filter of first order was
    tried: it weakens fast motion, too, and was named where nothing was filtered.
    """

    name = "torque_filter"
    coefficient_names = ("time constant",)
    depends_on_joint = False
    caution = 1.0
    sooner_than = ("dead_time",)
    at_all_frequencies = False
    discriminating_motion = ()
    source = "first-order expansion of a filter: its group delay at low frequency"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """Of one joint alone it is that joint's delay."""
        return signals.n > 1

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        late = np.column_stack([delayed(torque, theta[0], signals.dt) for torque in signals.torque.T])
        return np.asarray((late - signals.torque)[:, :, None] / theta[0])

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The lag alone; negative where the positions are late."""
        return [EffectParameter("time constant", float(coefficients[0]), float(std[0]), "s")]
