"""A tool, sensor or surface that gives way under the force more than is assumed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect
from ideal_robot.effects.domain import SENSOR
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals

CONTACT_FORCE = "contact_force"
"""Signal: force along the surface's normal [N]."""

ASSUMED_GIVE = "assumed_give"
"""Signal, constant: 1/E as assumed [m/N]; 0 where contact is taken for rigid."""
_SMALLEST = 0.05


class ForceCompliance(Effect):
    """The position at which the tip is, given the surface, is off in proportion to the force: ``delta x_n = -c F``.

    ``F = E (h - x_n)`` with the surface at ``h``, [L] (3): where ``E`` is assumed as ``E_0``, ``c = 1/E - 1/E_0``;
    where contact is taken for rigid, ``c = 1/E``.
    """

    name = "force_compliance"
    domain = SENSOR
    prefix = "force_contact"
    depends_on_joint = False
    coefficient_names = ("compliance",)
    coefficient_units = ("m/N",)
    source = "[L] (3): F_r - F = E delta x"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The tool."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """There has to be a contact."""
        return CONTACT_FORCE in signals.extra

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``.

        Large against what is assumed: a normal that turns with the surface's slope moves that by some percent.
        """
        assumed = float(np.max(signals.extra.get(ASSUMED_GIVE, np.zeros(1))))
        return bool(abs(coefficients[0]) > _SMALLEST * assumed)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 1, 1)``."""
        force = signals.extra.get(CONTACT_FORCE, np.zeros(len(signals.t)))
        return -np.asarray(force)[:, None, None]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The elasticity that the force controller counts with."""
        return LoopChange(give=coefficients[0])
