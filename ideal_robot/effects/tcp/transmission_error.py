"""A gear that does not turn evenly, as the TCP shows it."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.arm.transmission_error import TransmissionError
from ideal_robot.effects.domain import TCP_POSITION
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.tcp.at_tool import shows_gears


class ToolTransmissionError(TransmissionError):
    """A gear that does not turn evenly, seen at the TCP: ``delta x = J_j (a cos(k q_j) + b sin(k q_j))``."""

    domain = TCP_POSITION

    def usable(self, signals: Signals, joint: int) -> bool:
        """As all gear effects: known frames, and a gear between motor and what was measured."""
        return shows_gears(signals, joint)

    def visible_part(self, signals: Signals, joint: int, residual: Array,
                     use: np.ndarray) -> tuple[Array, np.ndarray]:
        """See ``TorqueRipple.visible_part``.

        Residual of the TCP ``(N, 3)`` along the joint's motion, so that its spectrum is that of the angle.
        """
        if signals.frames is None:
            return np.zeros(len(residual)), use[:, 0]
        lever = signals.frames.jacobian[:, :, joint - 1]
        return np.asarray(np.einsum("ki,ki->k", lever, residual)), np.all(use, axis=1)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 3, 2)``."""
        if signals.frames is None:
            return np.zeros((len(signals.t), 3, 2))
        phase = theta[0] * signals.q[:, joint - 1]
        wave = np.column_stack([np.cos(phase), np.sin(phase)])
        return np.asarray(signals.frames.jacobian[:, :, joint - 1, None] * wave[:, None, :])
