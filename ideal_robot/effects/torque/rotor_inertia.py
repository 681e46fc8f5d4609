"""Inertia on the motor side, as the joint feels it."""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class RotorInertia(Effect):
    """``tau = I_a qdd``: rotor, brake or coupling inertia times the gear ratio squared, missing in the model."""

    name = "rotor_inertia"
    coefficient_names = ("change of rotor inertia",)
    coefficient_units = ("kg m²",)
    absorbed_by_base = True
    # Ten numbers of a body can do what one inertia does, and bend with gears and filters besides.
    sooner_than = ("link_load",)
    source = "[J] (1): I_a"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, signals.qdd[:, joint - 1])

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Inertia of the motor."""
        return LoopChange(rotor_inertia=coefficients[0])
