"""A body on the flange that the model does not know."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


class Payload(Effect):
    """Mass, first moments and inertias added to the last link, [G] (5) with that link's columns only.

    It acts on all joints, so it belongs to the whole arm (joint 0).
    """

    name = "payload"
    coefficient_names = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    coefficient_units = ("kg", "kg m", "kg m", "kg m", *["kg m²"] * 6)
    absorbed_by_base = True
    depends_on_joint = False
    # Moments without mass are no body but how gears, rotors or filters bend what a motion shows.
    without_which_none = (0,)
    # Its weight at a lever turns the wrist with gravity, which none of these do; its mass the strong joints show alone.
    enough_of_most = (1, 2, 3)
    # On the axis of the flange a body turns like the link before; tools are changed, links are not.
    sooner_than = ("link_load",)
    source = "[G] (5)"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """The regressor of the last link has to be known."""
        return signals.payload is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 10)``."""
        if signals.payload is None:
            return np.zeros((len(signals.t), signals.n, 10))
        return signals.payload

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``.

        A body has mass, or one has been taken off: its first moments then share the sign of a plausible lever.
        """
        mass, first = float(coefficients[0]), float(np.linalg.norm(coefficients[1:4]))
        return abs(mass) > 1e-9 and first < 3.0 * abs(mass) + 1e-9

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. Mass, and the centre in the frame of the last joint."""
        m = float(coefficients[0])
        centre = [EffectParameter(f"c_{axis}", float(coefficients[i + 1]) / m,
                                  float(np.hypot(std[i + 1] / m, coefficients[i + 1] * std[0] / m**2)), "m")
                  for i, axis in enumerate("xyz")]
        return [EffectParameter("mass", m, float(std[0]), "kg"), *centre]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """A body on the last link."""
        return LoopChange(body=coefficients)
