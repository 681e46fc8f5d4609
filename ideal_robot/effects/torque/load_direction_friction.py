"""Dry friction of a gear's load that is there only where the motor drives the load, not where the load drives it."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.load_dependent_friction import LoadDependentFriction


class LoadDirectionFriction(LoadDependentFriction):
    """``tau = mu/2 (|tau_c| s + tau_c |s|)``, ``tau_c = tau_load - I qdd``, ``s = sign(qd)``, ``mu > 0``.

    That is ``mu tau_c`` where ``tau_c qd > 0``, so that the motor drives, and none where the load does: teeth lose more
    in the one sense of power than in the other. What a gear loses in both is ``load_dependent_friction``; a gear that
    has both laws shows both. theta is as there.

    Half of it is a share of the load itself. Where the model's parameters or a gain can take that half the other one
    alone is seen, which is ``load_dependent_friction`` of half the size: masses that other joints show, or that are
    known, tell the two apart.
    """

    name = "load_direction_friction"
    coefficient_names = ("friction per load driven",)
    coefficient_units = ("1",)
    discriminating_motion = (
        ("load_dependent_friction", "strokes against and with gravity, of all joints or with masses known from before"),
        ("coulomb", "the same strokes at postures of high and of low gravity load"),
        ("drive_gain", "slow strokes up and down: a gain shows in both alike"),
    )
    source = ("P. Hamon, M. Gautier, P. Garrec, IROS 2010: dry friction depending on load, "
              "other where the load drives than where the motor does")

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        carried, sense = self.carried(signals, joint, theta), signals.sliding_direction(joint)
        return signals.on_joint(joint, 0.5 * (np.abs(carried) * sense + carried * np.abs(sense)))

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction by load where the motor drives it."""
        return LoopChange(friction_per_driven_load=coefficients[0])
