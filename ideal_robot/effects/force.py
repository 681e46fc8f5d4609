"""Effects of a force sensor's errors, and of a contact that is softer than assumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import SENSOR, Theta, WholeArmEffect
from ideal_robot.effects.fitted import FittedEffect
from ideal_robot.effects.signals import Signals

MOMENTS = "moments"
"""Signal that says whether the sensor measures moments (1) or only forces (0)."""
CONTACT_FORCE = "contact_force"
"""Signal: force along the surface's normal [N]."""
ASSUMED_GIVE = "assumed_give"
"""Signal, constant: 1/E as assumed [m/N]; 0 where contact is taken for rigid."""
_SMALLEST = 0.05
"""Compliance that counts, as a share of what is assumed: a normal that turns with the surface's slope moves it by some
percent."""


class ForceBias(WholeArmEffect):
    """Bias of a force sensor: a constant in its own frame, ``delta w = b``, in any orientation of the tool.

    The tool's weight turns with the orientation, ``f = m R' g``, ``m = (m c) × R' g``, and is fitted beside it.
    """

    name = "force_bias"
    domain = SENSOR
    prefix = "force"
    coefficient_names = ("fx", "fy", "fz", "mx", "my", "mz")
    coefficient_units = ("N", "N", "N", "N m", "N m", "N m")
    changes = "wrench"
    source = "[L] 4.4: bias and weight of the tool from several orientations"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: the recording needs a wrench in free motion."""
        return MOMENTS in signals.extra

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, 6, 6)``, or ``(N, 3, 3)`` for a sensor of forces alone; see ``Effect.columns``."""
        count = 6 if MOMENTS in signals.extra and bool(np.all(signals.extra[MOMENTS] > 0.5)) else 3
        return np.tile(np.eye(count), (len(signals.t), 1, 1))


class ForceCompliance(WholeArmEffect):
    """Compliance beyond the assumed one: the tip's distance to the surface is off in proportion to the force, ``-c F``.

    ``F = E (h - x_n)`` with the surface at ``h``, [L] (3): where ``E`` is assumed as ``E_0``, ``c = 1/E - 1/E_0``;
    where the contact is assumed rigid, ``c = 1/E``.
    """

    name = "force_compliance"
    domain = SENSOR
    prefix = "force_contact"
    coefficient_names = ("compliance",)
    coefficient_units = ("m/N",)
    changes = "give"
    source = "[L] (3): F_r - F = E delta x"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: the recording needs a contact; see ``Effect.usable``."""
        return CONTACT_FORCE in signals.extra

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, 1, 1)``; see ``Effect.columns``."""
        force = signals.extra.get(CONTACT_FORCE, np.zeros(len(signals.t)))
        return -np.asarray(force)[:, None, None]

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: the compliance is not much smaller than the assumed one.

        See ``Effect.plausible``.
        """
        assumed = float(np.max(signals.extra.get(ASSUMED_GIVE, np.zeros(1))))
        return bool(abs(coefficients[0]) > _SMALLEST * assumed)


@dataclass(frozen=True)
class ForceErrors:
    """The total errors of force sensor and contact, by which a force controller corrects its readings.

    The sensor shows a ``wrench (6,)`` [N, N m] when nothing touches the tool; ``give`` [m/N] is compliance beyond what
    is assumed.
    """

    wrench: Array
    give: float

    @classmethod
    def of(cls, effects: Sequence[FittedEffect]) -> ForceErrors:
        """Errors of a force sensor that all effects of a model make together."""
        changes = [effect.effect.loop_change(effect.coefficients, effect.theta) for effect in effects]
        wrench = np.zeros(6)
        for change in changes:
            wrench[: len(change.wrench)] += change.wrench
        return cls(wrench, sum(change.give for change in changes))

    def stiffness(self, assumed: float) -> float:
        """Elasticity of the contact [N/m] with the found compliance added to the ``assumed`` one; [L] (3)."""
        give = 1.0 / assumed + self.give
        return 1.0 / give if give > 0.0 else assumed
