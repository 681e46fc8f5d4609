"""A body on an inner link that the model does not know."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class LinkLoad(Effect):
    """Mass and first moments added to one link, [G] (5) with those four columns; against a model known before.

    A body small against its distance from the axis has no inertia of its own that shows. On the last link it is a
    payload, which has all ten.
    """

    name = "link_load"
    coefficient_names = ("m", "mx", "my", "mz")
    coefficient_units = ("kg", "kg m", "kg m", "kg m")
    absorbed_by_base = True
    source = "[G] (5)"

    def joints(self, signals: Signals) -> Iterator[int]:
        """All links but the last."""
        yield from range(1, signals.n)

    def usable(self, signals: Signals, joint: int) -> bool:
        """The regressor of the links has to be known."""
        return signals.bodies is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 4)``."""
        if signals.bodies is None:
            return np.zeros((len(signals.t), signals.n, 4))
        return np.asarray(signals.bodies(joint)[:, :, :4])

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
