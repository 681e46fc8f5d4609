"""A motor that turns with another axis as well, as in the wrists of many arms."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.signals import Signals


class AxisCoupling(Effect):
    """Inertia, viscous and dry friction of a motor that turns at ``qd_j + r qd_i``, ``r = ±1``.

        tau_j = I qdd_i + F_v qd_i + F_c sign(qd_j + r qd_i)      (and, where the shaft carries it back,
        tau_i = I qdd_j + F_v qd_j + r F_c sign(qd_j + r qd_i)) .

    theta is the partner axis ``i``, the sense ``r`` and whether both joints feel it (2) or only ``j`` (1).
    """

    name = "axis_coupling"
    theta_names = ("partner axis", "sense", "joints that feel it")
    theta_units = ("", "", "")
    coefficient_names = ("inertia", "viscous friction", "Coulomb friction")
    coefficient_units = ("kg m²", "N m s/rad", "N m")
    discriminating_motion = (
        ("thermal_drift", "the same motion again after an hour's rest: only warming comes back"),
    )
    source = "J. Swevers et al., IEEE CSM 27(5), 2007; M. Gautier, wrist of the Stäubli RX 90"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Every axis near by, both senses; what both joints feel is named after the higher-numbered one."""
        return [(float(i), sense, sides) for i in range(1, signals.n + 1) if i != joint and abs(i - joint) <= 2
                for sense in (1.0, -1.0) for sides in ((1.0, 2.0) if joint > i else (1.0,))]

    def usable(self, signals: Signals, joint: int) -> bool:
        """There has to be another axis."""
        return signals.n > 1

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 3)``."""
        j, i, sense = joint - 1, int(theta[0]) - 1, theta[1]
        together = signals.direction(signals.qd[:, j] + sense * signals.qd[:, i], joint)
        result = signals.on_joint(joint, signals.qdd[:, i], signals.qd[:, i], together)
        if theta[2] > 1.5:
            result[:, i] = np.column_stack([signals.qdd[:, j], signals.qd[:, j], sense * together])
        return result

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. The shaft has inertia and friction, not less than none.

        Small terms may come out below zero: the negative ones are less than a fifth of the largest.
        """
        i, sense = int(theta[0]) - 1, theta[1]
        sizes = np.array([np.std(signals.qdd[:, i]), np.std(signals.qd[:, i]), 1.0])
        parts = coefficients * sizes * np.array([sense, sense, 1.0])
        return bool(-np.min(parts) < 0.2 * np.max(parts))

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The three coefficients and the partner, which is a choice and has no deviation."""
        found = super().parameters(coefficients, std, theta, (0.0,) * 3)
        return found
