"""A torque that repeats with the motor's or gear's position: cogging, teeth, bearing races."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter, Signals


class TorqueRipple(Effect):
    """``tau = a cos(k q) + b sin(k q)``: amplitude, phase and order ``k`` per joint radian (or metre) from the data.

    The order is found by scanning the residual over position (``scan``); a ripple has more than four periods within
    the range that was driven, else a spring, gravity or an odd shape explains it as well.
    """

    name = "torque_ripple"
    theta_names = ("order",)
    theta_units = ("1/rad",)
    coefficient_names = ("cosine", "sine")
    coefficient_units = ("N m", "N m")
    source = "motor cogging and gear meshing; order = periods per joint turn"
    scanned = True

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Orders on a grid of a third of a period over the range; ``scan`` narrows them down by the residual."""
        low, high = self.bounds(signals, joint)[0]
        span = float(np.ptp(signals.q[:, joint - 1])) + 1e-12
        count = int(np.clip((high - low) * span / 2.0, 2, 4000))
        return [(float(order),) for order in np.linspace(low, high, count)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """From four and a half periods in the range to what the sampling still resolves at the median speed."""
        span = float(np.ptp(signals.q[:, joint - 1])) + 1e-12
        speed = np.abs(signals.qd[:, joint - 1])
        moving = speed[speed > 0.05 * speed.max()] if speed.max() > 0 else speed
        typical = float(np.median(moving)) + 1e-12 if len(moving) else 1e-12
        low = 2.0 * np.pi * 4.5 / span
        high = max(0.35 * 2.0 * np.pi / signals.dt / typical, 2.0 * low)
        return [(low, min(high, low + 3000.0 * 2.0 / span))]

    def seen(self, signals: Signals, joint: int, residual: Array, use: np.ndarray) -> tuple[Array, np.ndarray]:
        """What of a residual ``(N, c)`` a ripple of this joint could be ``(N,)``, and which samples count ``(N,)``."""
        return residual[:, joint - 1], use[:, joint - 1]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """Shape ``(N, n, 2)``."""
        phase = theta[0] * signals.q[:, joint - 1]
        return signals.on_joint(joint, np.cos(phase), np.sin(phase))

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """Amplitude, phase and order."""
        a, b = (float(v) for v in coefficients)
        size = float(np.hypot(a, b))
        sigma = float(np.hypot(a * std[0], b * std[1]) / max(size, 1e-12))
        return [EffectParameter("amplitude", size, sigma, "N m"),
                EffectParameter("phase", float(np.arctan2(b, a)), sigma / max(size, 1e-12), "rad"),
                EffectParameter("order", theta[0], theta_std[0] if theta_std else 0.0, "1/rad")]
