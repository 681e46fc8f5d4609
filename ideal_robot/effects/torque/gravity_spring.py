"""A spring that balances gravity, mounted between two links."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.signals import Signals

_LEAST_RANGE = 0.3
"""Range of a joint over which a balancing spring's sine can be told from a line at all [rad]."""
_LEAST_WEIGHT = 0.02
"""Of a joint's largest torque, what gravity has to ask of it for a balancing spring to make sense."""


class GravitySpring(Effect):
    """Torque of a spring between a point on the link and one on the frame ([J] section 2: gravity compensator).

    With lever ratio ``rho`` of the two attachment points and the angle ``phi`` at which they are in line, the length
    in units of the longer lever is ``l = sqrt(1 + rho^2 + 2 rho cos(q - phi))`` and the torque

        tau = c_1 sin(q - phi) + c_2 sin(q - phi) / l ,

    the first term from the stiffness, the second from the preload; the first alone is like gravity.
    """

    name = "gravity_spring"
    theta_names = ("phi", "rho")
    theta_units = ("rad", "1")
    coefficient_names = ("stiffness term", "preload term")
    coefficient_units = ("N m", "N m")
    discriminating_motion = (
        ("cable_spring", "the joint's whole range: a cable pulls in proportion, a balancer with the sine"),
    )
    flexible = True
    caution = 1.5
    of_angle_alone = True
    source = "[J] section 2"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Eight directions, two lever ratios."""
        return [(float(phi), rho) for phi in np.arange(8) * np.pi / 4 for rho in (0.35, 0.7)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Any direction; levers neither equal (the spring would vanish) nor one of them zero (no torque)."""
        return [(-np.pi, 3.0 * np.pi), (0.1, 0.9)]

    def usable(self, signals: Signals, joint: int) -> bool:
        """Over a small range the shape is a straight line; where gravity does nothing none is balanced."""
        if np.ptp(signals.q[:, joint - 1]) <= _LEAST_RANGE:
            return False
        if signals.weight is None:
            return True
        weight, torque = (np.max(np.abs(values[:, joint - 1])) for values in (signals.weight, signals.torque))
        return bool(weight > _LEAST_WEIGHT * torque)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 2)``."""
        phi, rho = theta
        angle = signals.q[:, joint - 1] - phi
        length = np.sqrt(1.0 + rho**2 + 2.0 * rho * np.cos(angle))
        return signals.on_joint(joint, np.sin(angle), np.sin(angle) / length)

    def like_the_model(self, signals: Signals, joint: int) -> Array:
        """See ``Effect.like_the_model``. Gravity's two components, turned with the joint."""
        q = signals.q[:, joint - 1]
        return signals.on_joint(joint, np.sin(q), np.cos(q))

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. As they are, with the angle within one turn."""
        found = super().parameters(coefficients, std, theta, theta_std)
        angle = found[2]
        return [*found[:2], EffectParameter(angle.name, float(np.angle(np.exp(1j * angle.value))), angle.std,
                                            angle.unit), found[3]]
