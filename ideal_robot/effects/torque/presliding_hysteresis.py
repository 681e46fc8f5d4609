"""Presliding: after a reversal friction builds up over a displacement, not at once."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.jit import jit

_SPEED_OR_DISTANCE = ("reversals at very different accelerations: presliding follows the distance since the reversal, "
                      "friction laws the speed")


@jit()
def dahl(q: Array, sigma: float) -> Array:
    """P. R. Dahl's state ``z``: ``dz/dt = (qd - |qd| z) / sigma``, exact over each step of ``q (N,)``; within ±1."""
    z = np.empty(len(q))
    state = 0.0
    for k in range(len(q)):
        if k > 0:
            step = q[k] - q[k - 1]
            towards = 1.0 if step > 0.0 else -1.0
            state = towards + (state - towards) * np.exp(-abs(step) / sigma)
        z[k] = state
    return z


class PreslidingHysteresis(Effect):
    """``tau = F (z - sign(qd))`` with Dahl's ``z``: dry friction lags behind the reversal by a displacement ``sigma``.

    The column is the difference to Coulomb friction, so that the coefficient is the dry friction that hysteresis takes
    part in; fitted jointly with Coulomb friction itself.
    """

    name = "presliding_hysteresis"
    theta_names = ("sigma",)
    theta_units = ("rad",)
    coefficient_names = ("hysteretic friction",)
    discriminating_motion = (
        ("degressive", _SPEED_OR_DISTANCE),
        ("stribeck", _SPEED_OR_DISTANCE),
        ("backlash", "reversals at postures with and without load on the gear"),
    )
    tail_alone = True
    source = "Swevers et al. 2000, cited in [G]; the state of P. R. Dahl 1968"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Fractions of the range that was driven."""
        span = float(np.ptp(signals.q[:, joint - 1])) + 1e-12
        return [(span * factor,) for factor in (0.002, 0.006, 0.02, 0.06)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Short of a joint's range by far: else it is a spring."""
        span = float(np.ptp(signals.q[:, joint - 1])) + 1e-12
        return [(0.0005 * span, 0.15 * span)]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        z = dahl(np.ascontiguousarray(signals.q[:, joint - 1]), theta[0])
        return signals.on_joint(joint, z - signals.sliding_direction(joint))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Friction opposes motion."""
        return bool(coefficients[0] > 0.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction builds up over the displacement."""
        return LoopChange(presliding=theta[0])
