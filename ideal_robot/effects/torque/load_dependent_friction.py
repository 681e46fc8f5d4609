"""Dry friction that grows with the load on the gear's teeth."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class LoadDependentFriction(Effect):
    """``tau = mu |tau_load - I qdd| sign(qd)`` with ``mu > 0``: teeth pressed together by their load.

    theta is the inertia ``I`` that is counted among links but sits on the motor's side of the gear: motions tell the
    sum of the two only, and what a gear carries is a matter of which is which.
    """

    name = "load_dependent_friction"
    theta_names = ("inertia before the gear",)
    theta_units = ("kg m²",)
    coefficient_names = ("friction per load",)
    coefficient_units = ("1",)
    discriminating_motion: ClassVar[tuple[tuple[str, str], ...]] = (
        ("coulomb", "the same strokes at postures of high and of low gravity load"),
    )
    source = "P. Hamon, M. Gautier, P. Garrec, IROS 2010: dry friction depending on load"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The load has to vary, or the effect is Coulomb friction."""
        load = np.abs(signals.borne(joint))
        return bool(np.std(load) > 0.05 * (np.mean(load) + 1e-12))

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """A tenth, half and most of what the load has of inertia."""
        largest = self._inertia(signals, joint)
        return [(share * largest,) for share in (0.1, 0.5, 0.9)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Between nothing and all."""
        largest = self._inertia(signals, joint)
        return [(1e-3 * largest, largest)]

    def bounds_near(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> list[tuple[float, float]]:
        """See ``Effect.bounds_near``. As the bounds: all of them are of one scale."""
        return self.bounds(signals, joint)

    def _inertia(self, signals: Signals, joint: int) -> float:
        """Slope of the load over the joint's acceleration [kg m²]."""
        qdd = signals.qdd[:, joint - 1] - np.mean(signals.qdd[:, joint - 1])
        return max(float(qdd @ signals.load[:, joint - 1] / (qdd @ qdd + 1e-12)), 1e-9)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, np.abs(self.carried(signals, joint, theta)) * signals.sliding_direction(joint))

    def carried(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """What the teeth carry ``(N,)`` [N m]: the load and what else may be weight, without the inertia before them.

        Args:
            signals: of ``N`` samples.
            joint: from 1.
            theta: the inertia [kg m²].
        """
        # Files of earlier versions have no theta.
        before = theta[0] if theta else 0.0
        return np.asarray(signals.borne(joint) - before * signals.qdd[:, joint - 1])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. More load, more friction; never as much as the load itself."""
        return bool(0.0 < coefficients[0] < 1.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Friction by load."""
        return LoopChange(friction_per_load=coefficients[0])
