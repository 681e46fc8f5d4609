"""A motor position that is recorded late."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.dead_time import HOLD


class PositionDeadTime(Effect):
    """The position of one joint is recorded late by ``delta``: every torque is computed from an old angle.

    ``delta tau = delta (dtau/dq_j qd_j + dtau/dqd_j qdd_j + dtau/dqdd_j d(qdd_j)/dt)`` on all joints, from differences
    of the rigid body.
    """

    name = "dead_time"
    prefix = "q"
    coefficient_names = ("delay",)
    coefficient_units = ("s",)
    source = "first-order expansion of a pure delay"
    caution = 2.5
    at_all_frequencies = True
    longest = 0.06

    def usable(self, signals: Signals, joint: int) -> bool:
        """With one joint alone it is the torque's delay with the other sign."""
        return signals.n > 1 and signals.rigid is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        if signals.derivatives is None or len(signals.t) < 3:
            return np.zeros((len(signals.t), signals.n, 1))
        j = joint - 1
        column = signals.derivatives.along(joint, signals.qd[:, j], signals.qdd[:, j], signals.rate(signals.qdd[:, j]))
        column[:, j] += signals.rate(signals.torque[:, j] - signals.load[:, j])
        return np.asarray(column[:, :, None])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Milliseconds, not tenths of a second; late by more than torques are held."""
        return bool(abs(coefficients[0]) < self.longest and not 0.0 < coefficients[0] < HOLD)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Nowhere: it is in the recording alone."""
        return LoopChange(nowhere="only the record is late: the arm moves as it did")
