"""Friction that differs between the two directions of motion."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class AsymmetricFriction(Effect):
    """``tau = d_v |qd| + d_c sign(qd)^2``: half the differences of viscous and dry friction between the directions.

    With ``Fv+, Fv-`` for the two directions ``d_v = (Fv+ - Fv-)/2``, and likewise ``d_c``; while the joint moves
    ``d_c`` cannot be told from a constant offset, so only the viscous part is evidence where an offset is fitted too.
    """

    name = "asymmetric_friction"
    coefficient_names = ("half difference of viscous friction",)
    coefficient_units = ("N m s/rad",)
    of_slow_motion = True
    source = "A. Janot, M. Gautier, M. Brunot, data set EMPS: friction of a worn ball screw"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, np.abs(signals.qd[:, joint - 1]))

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction over speed."""
        return LoopChange(friction_curve=True)
