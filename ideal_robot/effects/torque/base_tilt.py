"""A base that is not upright: gravity comes from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals

_G = 9.80665
_UPRIGHT = 1e-6
"""Weight that the first axis carries, over the most that any does, up to which it stands upright."""


class BaseTilt(Effect):
    """Gravity has components across the base frame's z axis: ``tau = g_x tau_x(q) + g_y tau_y(q)``.

    ``tau_x`` is what the rigid body feels of 1 m/s² of gravity along the base's x axis, so the effect needs no inertia
    of its own: one cause for all joints (joint 0). To first order in the angle; a turn about the vertical is none.

    About a first axis that stood upright, gravity did nothing and no motion told the first moments: of these a model
    has what the URDF says. Leaning, they turn that axis by ``c cos q_1 + s sin q_1``, [G] (5), beside what the links
    further out do; both numbers are free, up to the moment that the whole arm has about the axis.
    """

    name = "base_tilt"
    coefficient_names = ("gravity along x", "gravity along y", "unknown moments, cosine", "unknown moments, sine")
    coefficient_units = ("m/s²", "m/s²", "N m", "N m")
    depends_on_joint = False
    # Moments of a base that does not lean turn nothing.
    without_which_none = (0, 1)
    source = "[G] (5) with another direction of gravity"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """What gravity across does has to be known, and there has to be more than one joint to tell it from springs."""
        return signals.n > 1 and signals.gravity_across is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 4)``."""
        result = np.zeros((len(signals.t), signals.n, 4))
        if signals.gravity_across is None:
            return result
        result[:, :, :2] = signals.gravity_across(signals.q)
        if not _carries_weight(signals) and np.any(result[:, 0, :2]):
            result[:, 0, 2:] = np.column_stack([np.cos(signals.q[:, 0]), np.sin(signals.q[:, 0])])
        return result

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Below 15°; what hangs from a wall or a ceiling is mounted so on purpose."""
        across, unknown = np.hypot(*coefficients[:2]), np.hypot(*coefficients[2:])
        if unknown > 0.0 and signals.gravity_across is not None:
            known = np.linalg.norm(np.asarray(signals.gravity_across(signals.q))[:, 0], axis=1)
            if unknown > across * float(np.max(known)):
                return False
        return bool(across < 0.26 * _G)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The angle, and the direction in which the base's z axis leans."""
        x, y = (float(v) for v in coefficients[:2])
        size = float(np.hypot(x, y))
        across = float(np.hypot(x * std[0], y * std[1]) / max(size, 1e-12))
        along = float(np.hypot(y * std[0], x * std[1]) / max(size, 1e-12) ** 2)
        return [EffectParameter("angle", size / _G, across / _G, "rad"),
                EffectParameter("direction", float(np.arctan2(-y, -x)), along, "rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Gravity from elsewhere; the moments are the URDF's."""
        return LoopChange(gravity=(coefficients[0], coefficients[1]))


def _carries_weight(signals: Signals) -> bool:
    """Whether gravity turns the first axis of the upright arm."""
    if signals.weight is None:
        return True
    size = np.abs(signals.weight).max(axis=0)
    return bool(size[0] > _UPRIGHT * size.max())
