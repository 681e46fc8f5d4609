"""Arm angles that are all late against the motors': one clock, one cause."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.arm.dead_time import ArmDeadTime
from ideal_robot.effects.signals import Signals


class CommonArmDeadTime(ArmDeadTime):
    """``q_a,i(t) = q_i(t - delta)`` of all joints with the same ``delta``: to first order ``-delta qd_i``."""

    prefix = "qa_all"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm, where it has several joints."""
        if signals.n > 1:
            yield 0

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return np.asarray(-signals.qd[:, :, None])
