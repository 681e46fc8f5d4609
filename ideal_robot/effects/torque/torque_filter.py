"""All motor torques are recorded late by one filter or one clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.effects.base import EffectParameter
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.dead_time import DeadTime, delayed


def lagged(values: Array, lag: float, dt: float) -> Array:
    """Signals behind a filter of first order, settled at the beginning, exact for straight lines between samples.

    Args:
        values: the signals ``(N, c)``, in any unit.
        lag: time constant [s].
        dt: between samples [s].
    """
    keep = float(np.exp(-dt / lag))
    # y(t + dt) = keep y(t) + the step response to a straight line from one sample to the next.
    ramp = 1.0 - lag / dt * (1.0 - keep)
    b, a = np.array([ramp, 1.0 - keep - ramp]), np.array([1.0, -keep])
    settled = signal.lfilter_zi(b, a)[:, None] * values[:1]
    return np.asarray(signal.lfilter(b, a, values, axis=0, zi=settled)[0])


class TorqueFilter(DeadTime):
    """The torques of all joints pass one lag ``T`` before they are recorded.

    Either ``tau(t) = tau_model(t - T)``, as with averages, clocks and filters of higher order, or of first order,
    ``T d tau/dt + tau = tau_model``; well below the corner they are the same. One number for the whole arm (joint 0),
    tried before any joint has a delay of its own. theta is the chord and the order of the filter, 0 for a delay.
    """

    name = "torque_filter"
    theta_names = ("chord", "order")
    theta_units = ("s", "1")
    coefficient_names = ("time constant",)
    depends_on_joint = False
    caution = 1.0
    at_all_frequencies = False
    discriminating_motion = ()
    source = "first-order expansion of a filter: its group delay at low frequency"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """Of one joint alone it is that joint's delay."""
        return signals.n > 1

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``."""
        if len(theta) > 1 and theta[1] > 0.5 and theta[0] > 0.0:
            late = lagged(signals.torque, theta[0], signals.dt)
        else:
            late = np.column_stack([delayed(torque, theta[0], signals.dt) for torque in signals.torque.T])
        return np.asarray((late - signals.torque)[:, :, None] / theta[0])

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """A tangent and chords to either side; a filter is never early."""
        return [*((delay, 0.0) for (delay,) in super().starts(signals, joint)), (8e-3, 1.0)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """The longest delay to either side; the order is a choice."""
        return [*super().bounds(signals, joint), (0.0, 1.0)]

    def consistent_theta(self, coefficients: Array, theta: tuple[float, ...]) -> tuple[float, ...]:
        """The chord as long as the delay, where it is exact; the order as it is."""
        return (*super().consistent_theta(coefficients, theta), *theta[1:])

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The lag alone; negative where the positions are late."""
        return [EffectParameter("time constant", float(coefficients[0]), float(std[0]), "s")]
