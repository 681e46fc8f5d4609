"""A motor torque that is recorded late."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy import ndimage

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


def delayed(values: Array, delay: float, dt: float) -> Array:
    """A signal that is late, by cubic splines between samples; the ends are held.

    Args:
        values: the signal ``(N,)``, in any unit.
        delay: by which it is late [s].
        dt: between samples [s].
    """
    return np.asarray(ndimage.shift(values, delay / dt, order=3, mode="nearest"))


HOLD = 5e-4
"""What a torque is early by in every drive, at most [s]: it is held over a cycle of the loop, a millisecond or less,
and acts half a cycle after its stamp in the mean."""


class DeadTime(Effect):
    """The torque of one joint is recorded late by ``delta``: ``tau_j(t) = tau_model,j(t - delta)``.

    To first order ``-delta d tau_model/dt``, by which it competes with a soft gear, whose trace is the *second*
    derivative of the load. The column is the chord ``(tau_model(t - theta) - tau_model(t))/theta``, exact where
    theta has become ``delta``. Negative: the torque is early, i.e. the position is late.
    """

    name = "dead_time"
    theta_names: ClassVar[tuple[str, ...]] = ("chord",)
    theta_units: ClassVar[tuple[str, ...]] = ("s",)
    theta_is_physical = False
    coefficient_names = ("delay",)
    coefficient_units = ("s",)
    discriminating_motion: ClassVar[tuple[tuple[str, str], ...]] = (
        ("joint_elasticity", "the same path at half and at double speed: a delay grows with the torque's rate, a soft "
                             "gear with its second derivative"),
        ("presliding_hysteresis", "long strokes with few reversals at high speed: hysteresis shows after reversals "
                                  "only, a delay everywhere"),
    )
    source = "first-order expansion of a pure delay"
    caution = 2.5
    at_all_frequencies = True
    longest = 0.06
    _shortest = 5e-5

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        torque = signals.torque[:, joint - 1]
        return signals.on_joint(joint, (delayed(torque, theta[0], signals.dt) - torque) / theta[0])

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """A tangent, and chords to either side."""
        return [(delay,) for delay in (1e-3, -1e-3, 8e-3, -8e-3)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """The longest delay to either side."""
        return [(-self.longest, self.longest)]

    def consistent_theta(self, coefficients: Array, theta: tuple[float, ...]) -> tuple[float, ...]:
        """The chord as long as the delay, where it is exact."""
        delay = float(np.clip(coefficients[0], -self.longest, self.longest))
        return (float(np.copysign(max(abs(delay), self._shortest), delay)),)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The delay alone; the chord is only how it was computed."""
        return [EffectParameter("delay", float(coefficients[0]), float(std[0]), "s")]

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. Milliseconds, not tenths of a second; early by more than what is held."""
        return bool(abs(coefficients[0]) < self.longest and not -HOLD < coefficients[0] < 0.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """Nowhere: it is in the recording alone."""
        return LoopChange(nowhere="only the record is late: the arm moves as it did")
