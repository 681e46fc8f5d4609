"""Effects on an arm angle as they show at the tool, through the Jacobian."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.domain import ARM_POSITION, TCP_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals

LEVER = 1e-4
"""A turn about an axis this close to the TCP [m] does not move it."""


class AtTool(Effect):
    """An effect on an arm angle, seen at the TCP: ``delta x = J_j delta q_j``.

    Attributes:
        inner: the effect on the angle.
    """

    domain = TCP_POSITION
    inner: ClassVar[Effect]

    def __init_subclass__(cls) -> None:
        """Takes names and units from the effect on the angle; what has a channel of its own there has one here."""
        for key in ("name", "theta_names", "theta_units", "coefficient_names", "coefficient_units", "source"):
            setattr(cls, key, getattr(cls.inner, key))
        cls.prefix = cls.inner.channel_prefix.replace(ARM_POSITION.prefix, TCP_POSITION.prefix, 1)

    def usable(self, signals: Signals, joint: int) -> bool:
        """As the angle's effect; frames have to be known, with a gear between motor and what was measured."""
        return shows_gears(signals, joint) and self.inner.usable(signals, joint)

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """As the angle's effect."""
        return self.inner.starts(signals, joint)

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """As the angle's effect."""
        return self.inner.bounds(signals, joint)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 3, m)``."""
        inner = self.inner.columns(signals, joint, theta)[:, joint - 1]
        if signals.frames is None:
            return np.zeros((len(signals.t), 3, inner.shape[1]))
        return np.asarray(signals.frames.jacobian[:, :, joint - 1, None] * inner[:, None, :])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. As the angle's effect."""
        return self.inner.plausible(coefficients, theta, signals, joint)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. As the angle's effect."""
        return self.inner.parameters(coefficients, std, theta, theta_std)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """As the angle's effect."""
        return self.inner.loop_change(coefficients, theta)


def shows_gears(signals: Signals, joint: int) -> bool:
    """Whether the TCP moves with a joint whose gear is between motor and what was measured."""
    if signals.frames is None or not np.any(signals.load[:, joint - 1] != 0.0):
        return False
    return bool(np.max(np.abs(signals.frames.jacobian[:, :, joint - 1])) > LEVER)
