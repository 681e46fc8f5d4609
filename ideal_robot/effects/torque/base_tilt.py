"""A base that is not upright: gravity comes from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals

_G = 9.80665


class BaseTilt(Effect):
    """Gravity has components across the base frame's z axis: ``tau = g_x tau_x(q) + g_y tau_y(q)``.

    ``tau_x`` is what the rigid body feels of 1 m/s² of gravity along the base's x axis, so the effect needs no inertia
    of its own: one cause for all joints (joint 0). To first order in the angle; a turn about the vertical is none.
    """

    name = "base_tilt"
    coefficient_names = ("gravity along x", "gravity along y")
    coefficient_units = ("m/s²", "m/s²")
    depends_on_joint = False
    source = "[G] (5) with another direction of gravity"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """What gravity across does has to be known, and there has to be more than one joint to tell it from springs."""
        return signals.n > 1 and signals.gravity_across is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 2)``."""
        if signals.gravity_across is None:
            return np.zeros((len(signals.t), signals.n, 2))
        return np.asarray(signals.gravity_across(signals.q))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Below 15°; what hangs from a wall or a ceiling is mounted so on purpose."""
        return bool(np.hypot(*coefficients) < 0.26 * _G)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The angle, and the direction in which the base's z axis leans."""
        x, y = (float(v) for v in coefficients)
        size = float(np.hypot(x, y))
        across = float(np.hypot(x * std[0], y * std[1]) / max(size, 1e-12))
        along = float(np.hypot(y * std[0], x * std[1]) / max(size, 1e-12) ** 2)
        return [EffectParameter("angle", size / _G, across / _G, "rad"),
                EffectParameter("direction", float(np.arctan2(-y, -x)), along, "rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Gravity from elsewhere."""
        return LoopChange(gravity=(coefficients[0], coefficients[1]))
