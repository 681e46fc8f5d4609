"""Play in the gear as the arm angle shows it: the motor turns back a little before the arm does."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.domain import ARM_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.jit import jit


@jit()
def play(q: Array, half_gap: float) -> Array:
    """Play operator: the output follows ``q (N,)`` only when it is half a gap away from it.

    >>> play(np.array([0.0, 1.0, 2.0, 1.8, 1.0]), 0.25)
    array([0.  , 0.75, 1.75, 1.75, 1.25])
    """
    follower = np.empty(len(q))
    state = q[0]
    for k in range(len(q)):
        state = min(max(state, q[k] - half_gap), q[k] + half_gap)
        follower[k] = state
    return follower


class ArmBacklash(Effect):
    """Seen in the arm's position: ``q_a - q`` follows the play operator of half a gap."""

    name = "backlash"
    domain = ARM_POSITION
    theta_names = ("half gap",)
    theta_units = ("rad",)
    coefficient_names = ("share",)
    coefficient_units = ("1",)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Small fractions of the range that was driven."""
        span = float(np.ptp(signals.q[:, joint - 1])) + 1e-12
        return [(span * factor,) for factor in (2e-5, 1e-4, 5e-4, 2e-3)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """A gap, not a range of motion."""
        span = float(np.ptp(signals.q[:, joint - 1])) + 1e-12
        return [(5e-6 * span, 0.01 * span)]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``.

        Shape ``(N, n, 1)``: scaled by the gap so that the coefficient of a pure play is one.
        """
        q = np.ascontiguousarray(signals.q[:, joint - 1])
        return signals.on_joint(joint, play(q, theta[0]) - q)

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. The arm lags."""
        return bool(coefficients[0] > 0.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The play, crossed where the motion turns; the coefficient is a share of it."""
        return LoopChange(half_gap=coefficients[0] * theta[0])
