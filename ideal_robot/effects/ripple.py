"""Effects of uneven gears and motors, which repeat with the joint's position."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import ARM_POSITION, TCP_POSITION, Effect, EffectParameter, Theta
from ideal_robot.effects.elasticity import shows_gear, turned_arm
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals

_FEW = 4.5
"""Periods within the range that was driven below which a spring, gravity or an odd shape looks like a ripple."""


class TorqueRipple(Effect):
    """Torque ripple ``tau = a cos(k q) + b sin(k q)``: amplitude, phase and order ``k`` per joint radian (or metre).

    The order is found by scanning the residual over position. With fewer than two periods in the driven range a
    repetition cannot be seen.
    """

    name = "torque_ripple"
    theta_names = ("order",)
    theta_units = ("1/rad",)
    coefficient_names = ("cosine", "sine")
    coefficient_units = ("N m", "N m")
    source = "motor cogging and gear meshing; order = periods per joint turn"
    least_periods: ClassVar[float] = 2.0

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta within the physical bounds; see ``Effect.starts``.

        Orders on a grid of a third of a period over the range; ``starts_from_residual`` narrows them down.
        """
        low, high = self.bounds(signals, joint)[0]
        span = signals.span(joint)
        count = int(np.clip((high - low) * span / 2.0, 2, 4000))
        return [(float(order),) for order in np.linspace(low, high, count)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta, the order: from a few periods in the range to what the samples of slow motion resolve.

        Slow is the speed that a quarter of the moving samples do not exceed. Where the motion is so fast that the
        ripple's frequency is above the band, it is removed from columns and residual alike.
        """
        span = signals.span(joint)
        speed = np.abs(signals.qd[:, joint - 1])
        moving = speed[speed > 0.05 * speed.max()] if speed.max() > 0 else speed
        typical = float(np.percentile(moving, 25.0)) + 1e-12 if len(moving) else 1e-12
        low = 2.0 * np.pi * self.least_periods / span
        high = max(0.35 * 2.0 * np.pi / signals.dt / typical, 2.0 * low)
        return [(low, min(high, low + 3000.0 * 2.0 / span))]

    def bounds_near(self, signals: Signals, joint: int, theta: Theta) -> list[tuple[float, float]]:
        """Bounds of theta near a start: within half a period over the range around the scan's peak.

        See ``Effect.bounds_near``.
        """
        width = 1.5 / float(np.ptp(signals.q[:, joint - 1]))
        return [(max(theta[0] - width, self.bounds(signals, joint)[0][0]), theta[0] + width)]

    def starts_from_residual(self, signals: Signals, joint: int, residual: Array,
                             use: np.ndarray) -> tuple[list[Theta], int]:
        """Start values of theta from a residual: orders at the highest peaks of the residual's spectrum over position.

        See ``Effect.starts_from_residual``.

        Low orders have a peak of their own, as slow curves over the range would otherwise dominate.
        """
        low, high = self.bounds(signals, joint)[0]
        part, counts = self.visible_part(signals, joint, residual, use)
        q = signals.q[:, joint - 1]
        between = 2.0 * np.pi * _FEW / signals.span(joint)
        orders, tries = spectral_peaks(q, part, counts, (max(low, between), high))
        if self.least_periods < _FEW:
            slow, more = spectral_peaks(q, part, counts, (low, between), peaks=1)
            orders, tries = orders + slow, tries + more
        return [(order,) for order in orders], tries

    def visible_part(self, signals: Signals, joint: int, residual: Array,
                     use: np.ndarray) -> tuple[Array, np.ndarray]:
        """Part of a residual that a ripple of this joint could cause ``(N,)``, and the samples that are used ``(N,)``.

        Args:
            signals, joint, residual, use: as in ``Effect.starts_from_residual``.
        """
        return residual[:, joint - 1], use[:, joint - 1]

    def wave(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Cosine and sine of the order times the joint's position ``(N, 2)``.

        Args:
            signals, joint, theta: as in ``columns``, theta being the order [1/rad].
        """
        turns = theta[0] / (2.0 * np.pi) * signals.q[:, joint - 1]
        # Reducing the argument to one turn halves the time of the sines.
        phase = 2.0 * np.pi * (turns - np.round(turns))
        return np.stack([np.cos(phase), np.sin(phase)]).T

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 2)``; see ``Effect.columns``."""
        return signals.on_joint(joint, *self.wave(signals, joint, theta).T)

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: amplitude, phase and order; see ``Effect.parameters``."""
        a, b = (float(v) for v in coefficients)
        size = float(np.hypot(a, b))
        sigma = float(np.hypot(a * std[0], b * std[1]) / max(size, 1e-12))
        return [EffectParameter("amplitude", size, sigma, self.coefficient_units[0]),
                EffectParameter("phase", float(np.arctan2(b, a)), sigma / max(size, 1e-12), "rad"),
                EffectParameter("order", theta[0], theta_std[0] if theta_std else 0.0, "1/rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: the motor's torque ripple; see ``Effect.loop_change``."""
        return LoopChange(ripple=(theta[0], coefficients[0], coefficients[1]))


class TransmissionError(TorqueRipple):
    """Transmission error ``q_a - q = a cos(k q) + b sin(k q)``: as ``torque_ripple``, but of the position."""

    name = "transmission_error"
    domain = ARM_POSITION
    coefficient_units = ("rad", "rad")
    # Fewer periods would fit the gear's deflection over the range.
    least_periods = _FEW
    source = "kinematic error of gears, k a multiple of the gear ratio"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the channels are measured behind the joint's gear; see ``shows_gear``."""
        return shows_gear(self.domain, signals, joint)

    def visible_part(self, signals: Signals, joint: int, residual: Array,
                     use: np.ndarray) -> tuple[Array, np.ndarray]:
        """Part of the residual that a transmission error of this joint could cause ``(N,)``, and used samples.

        See ``TorqueRipple.visible_part``.

        Residual of the TCP ``(N, 3)`` along the joint's motion, so that its spectrum is that of the angle.
        """
        if self.domain != TCP_POSITION:
            return super().visible_part(signals, joint, residual, use)
        if signals.frames is None:
            return np.zeros(len(residual)), use[:, 0]
        lever = signals.frames.jacobian[:, :, joint - 1]
        return np.asarray(np.einsum("ki,ki->k", lever, residual)), np.all(use, axis=1)

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 2)``, at the TCP ``(N, 3, 2)``; see ``Effect.columns``."""
        return turned_arm(self.domain, signals, joint, self.wave(signals, joint, theta))

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: the uneven transmission of the gear; see ``Effect.loop_change``."""
        return LoopChange(uneven=(theta[0], coefficients[0], coefficients[1]))


def spectral_peaks(q: Array, residual: Array, use: np.ndarray, band: tuple[float, float],
                   peaks: int = 3) -> tuple[list[float], int]:
    """Orders at the highest peaks of a residual's spectrum over position, and how many orders were candidates.

    Orders that differ by less than one period over the driven range are not distinguishable and make one candidate.
    The residual is summed in narrow bins of position; the Fourier transform of those sums is that of the residual at
    the (unevenly spread) positions.

    Args:
        q, residual: position ``(N,)`` [rad or m], and the residual there ``(N,)``, in any unit.
        use: samples that are used ``(N,)``.
        band: lowest and highest order [1/rad or 1/m].
        peaks: number of peaks, the highest first.
    """
    low, high = band
    span = float(np.ptp(q)) + 1e-12
    # Fine enough for eight bins per shortest period.
    count = int(np.clip(8.0 * high * span / (2.0 * np.pi), 64, 1 << 17))
    index = np.clip(((q - q.min()) / span * count).astype(int), 0, count - 1)
    sums = np.bincount(index, residual * use, count)
    weights = np.bincount(index, use.astype(float), count)
    padded = 4 * count
    step = 2.0 * np.pi / (span * padded / count)
    power = np.abs(np.fft.rfft(sums, padded)) ** 2 / max(weights.sum(), 1.0)
    orders = step * np.arange(len(power))
    power = np.where((orders >= low) & (orders <= high), power, 0.0)
    tries = max(int((high - low) * span / (2.0 * np.pi)), 1)
    highest: list[float] = []
    for _ in range(peaks):
        k = int(np.argmax(power))
        if power[k] <= 0.0:
            break
        highest.append(float(orders[k]))
        power[max(0, k - 8) : k + 9] = 0.0
    return highest, tries
