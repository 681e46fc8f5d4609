"""A body on an inner link that the model does not know."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.payload import Payload


class LinkLoad(Effect):
    """Mass, first moments and inertias added to one link, [G] (5) with its columns; against a model known before.

    A body away from the axis turns with it: without its inertia a load on the first links would be looked for further
    out. On the last link it is a payload.
    """

    name = "link_load"
    coefficient_names = Payload.coefficient_names
    coefficient_units = Payload.coefficient_units
    absorbed_by_base = True
    # Inertia without mass is no body but how gears, rotors or filters bend the inertia that a motion shows.
    without_which_none = (0, 1, 2, 3)
    source = "[G] (5)"

    def joints(self, signals: Signals) -> Iterator[int]:
        """All links but the last."""
        yield from range(1, signals.n)

    def usable(self, signals: Signals, joint: int) -> bool:
        """The regressor of the links has to be known."""
        return signals.bodies is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 10)``."""
        if signals.bodies is None:
            return np.zeros((len(signals.t), signals.n, 10))
        return np.asarray(signals.bodies(joint))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Some columns of the first links show nothing; what shows has a lever of an arm."""
        return bool(np.any(np.abs(coefficients) > 1e-9))

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. As they are: of the mass and the lever often the product alone shows."""
        return super().parameters(coefficients, std, theta, theta_std)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """A body on the link."""
        return LoopChange(body=coefficients)
