"""Dry friction that grows with the load on the gear's teeth."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class LoadDependentFriction(Effect):
    """``tau = mu |tau_load| sign(qd)`` with ``mu > 0``: the teeth are pressed together by what the gear carries."""

    name = "load_dependent_friction"
    coefficient_names = ("friction per load",)
    coefficient_units = ("1",)
    discriminating_motion = (
        ("coulomb", "the same strokes at postures of high and of low gravity load"),
    )
    source = "P. Hamon, M. Gautier, P. Garrec, IROS 2010: dry friction depending on load"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The load has to vary, or the effect is Coulomb friction."""
        load = np.abs(signals.load[:, joint - 1])
        return bool(np.std(load) > 0.05 * (np.mean(load) + 1e-12))

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        direction = signals.sliding_direction(joint)
        return signals.on_joint(joint, np.abs(signals.load[:, joint - 1]) * direction)

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. More load, more friction; never as much as the load itself."""
        return bool(0.0 < coefficients[0] < 1.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction by load."""
        return LoopChange(friction_per_load=coefficients[0])
