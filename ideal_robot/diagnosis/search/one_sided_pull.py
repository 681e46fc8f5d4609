"""A pull that begins at some angle: what a law that bends to nearly any curve has to be told from to be claimed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import Effect, Signals

_PLACES = np.linspace(0.1, 0.9, 17)
"""Where in the range a pull may begin: in what was seen it both is slack and pulls."""

_ORDERS = np.arange(1, 4)
"""Powers of the angle beyond the one where it begins."""


@dataclass(frozen=True)
class OneSidedPull(Effect):
    """Torque of a hose or a strap that is slack up to an angle and pulls back beyond it.

    With ``x`` the angle beyond ``start`` on its ``side``, and zero before it, ``tau = side (c_1 x + c_2 x² + c_3 x³)``:
    the first terms of whatever is slack in a part of the range and stiffens, in as many numbers as a balancing spring
    has. It is no cause of the library, and only says what else a curve over the angle may come from.

    Attributes:
        side: 1 where it pulls beyond the angle, -1 where it pulls below.
    """

    side: float

    name = "one_sided_pull"
    theta_names = ("start",)
    theta_units = ("rad",)
    coefficient_names = ("stiffness", "stiffening", "further stiffening")
    coefficient_units = ("N m/rad", "N m/rad²", "N m/rad³")
    source = "hoses and straps with slack"

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Evenly over the middle four fifths of the range."""
        low, high = np.percentile(signals.q[:, joint - 1], [1.0, 99.0])
        return [(float(place),) for place in low + _PLACES * (high - low)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Within what is tried to start from."""
        places = self.starts(signals, joint)
        return [(places[0][0], places[-1][0])]

    def bounds_near(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> list[tuple[float, float]]:
        """See ``Effect.bounds_near``. Up to the next places on either side: an angle has no scale."""
        [(low, high)] = self.bounds(signals, joint)
        step = (high - low) / (len(_PLACES) - 1)
        return [(max(low, theta[0] - step), min(high, theta[0] + step))]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 3)``."""
        x = np.maximum(self.side * (signals.q[:, joint - 1] - theta[0]), 0.0)
        return signals.on_joint(joint, self.side * x, self.side * x**2, self.side * x**3)

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. At the end of what was seen it pulls back, and the more the further."""
        x = float(np.max(self.side * (signals.q[:, joint - 1] - theta[0])))
        return bool(coefficients @ x**_ORDERS > 0.0 and coefficients @ (_ORDERS * x ** (_ORDERS - 1)) > 0.0)
