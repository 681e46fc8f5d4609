"""The Stribeck effect where the surplus falls with the square of speed at first."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.stribeck import Stribeck


class BellStribeck(Stribeck):
    """``tau = a_3 sign(qd) exp(-(qd/v_s)²)``: friction is flat at standstill, and falls fastest about ``v_s``.

    Which of the two forms a gear has is a matter of its lubricant and its surfaces: exponents from a half to two and
    more are published. Of the one fitted by the other a rise near standstill is left that looks like ``degressive``.
    """

    prefix = "tau_bell"
    source = "B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, Automatica 30(7), 1994, (5): exponent 2"

    @property
    def at_motor(self) -> bool:
        """See ``Effect.at_motor``."""
        return True

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        ratio = signals.qd[:, joint - 1] / theta[0]
        return signals.on_joint(joint, signals.sliding_direction(joint) * np.exp(-(ratio**2)))
