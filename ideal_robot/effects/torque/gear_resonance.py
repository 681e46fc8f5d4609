"""A gear so soft that the arm swings behind it within the band that is looked at."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.torque.joint_elasticity import JointElasticity
from ideal_robot.jit import jit

_HERTZ = (5.0, 6.0, 7.0, 8.2, 9.6, 11.2, 13.0)
"""Resonances behind a motor that stands [Hz] that are looked for: above the band of torques the gear bends as its load
asks, which ``JointElasticity`` says; arms in use do not swing slower."""
_LOWEST, _HIGHEST = 4.0, 14.0
_DAMPING = 0.1
"""Of the gear, as a share of the critical: that of loaded gears is between a few hundredths and a few tenths."""
_STEP = 1e-3
"""[s] of the integration, at most."""


@jit()
def swinging(acceleration: Array, inertia: Array, dt: float, stiffness: float) -> Array:
    """Twist of a gear that bends under its arm, from rest under the first load.

    Args:
        acceleration: of the motor relative to the unloaded arm, ``tau_load/M`` ``(N,)`` [rad/s²].
        inertia: behind the gear ``(N,)`` [kg m²].
        dt: between samples [s].
        stiffness: of the gear [N m/rad].

    Returns:
        Motor less arm angle ``(N,)`` [rad].
    """
    count = max(1, int(np.ceil(dt / _STEP)))
    h = dt / count
    twist = np.empty(len(acceleration))
    at, speed = acceleration[0] * inertia[0] / stiffness, 0.0
    twist[0] = at
    for k in range(1, len(acceleration)):
        for i in range(count):
            share = (i + 0.5) / count
            driven = acceleration[k - 1] + share * (acceleration[k] - acceleration[k - 1])
            square = stiffness / (inertia[k - 1] + share * (inertia[k] - inertia[k - 1]))
            # Implicit, so that it stays bounded where the inertia is small.
            speed = (speed + h * (driven - square * at)) / (1.0 + 2.0 * h * _DAMPING * np.sqrt(square) + h * h * square)
            at += h * speed
        twist[k] = at
    return twist


class GearResonance(JointElasticity):
    """Seen in the motor torque: what the arm is late by behind a soft gear is the answer of an oscillator to its load.

        M d²y/dt² + d dy/dt + K y = tau_load(q),   q_a = q - y,

    ``y`` the twist, ``M`` the inertia behind the gear, ``tau_load`` of the motor's own motion. ``JointElasticity`` is
    the limit of slow motion, ``y = tau_load/K``: at two thirds of the resonance ``sqrt(K/M)`` it has half of the twist,
    and above it the wrong sign. The coefficient is one where the inertia is right, in slow motion as well: what gives
    with the wrong sign there is no gear.
    """

    prefix = "tau_resonance"
    theta_names = ("stiffness",)
    theta_units = ("N m/rad",)
    coefficient_names = ("share",)
    coefficient_units = ("1",)
    at_all_frequencies = True

    def usable(self, signals: Signals, joint: int) -> bool:
        """There has to be a load, and an inertia behind the gear."""
        return super().usable(signals, joint) and len(signals.t) > 2 and _mean_inertia(signals, joint) > 0.0

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """By the resonance."""
        return [(self._stiffness(signals, joint, hertz),) for hertz in _HERTZ]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Resonances within the band."""
        return [(self._stiffness(signals, joint, _LOWEST), self._stiffness(signals, joint, _HIGHEST))]

    def bounds_near(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> list[tuple[float, float]]:
        """See ``Effect.bounds_near``. From one start to the next."""
        (low, high), = self.bounds(signals, joint)
        return [(max(low, 0.72 * theta[0]), min(high, 1.4 * theta[0]))]

    def bend(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``JointElasticity.bend``."""
        inertia = signals.inertia_behind(joint)
        return np.asarray(swinging(signals.load[:, joint - 1] / inertia, inertia, signals.dt, theta[0]))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. The inertia that is set free is that behind the gear, as well as it is known."""
        return bool(0.4 < coefficients[0] < 2.5)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. The stiffness, no better than the inertia with which it swings is known."""
        sigma = theta_std[0] if theta_std else 0.0
        return [EffectParameter("stiffness", theta[0], float(np.hypot(sigma, theta[0] * (1.0 - coefficients[0]))),
                                "N m/rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The gear, as the torque says it: all of it."""
        return LoopChange(gear_compliance=1.0 / theta[0])

    def _stiffness(self, signals: Signals, joint: int, hertz: float) -> float:
        return (2.0 * np.pi * hertz) ** 2 * max(_mean_inertia(signals, joint), 1e-12)


def _mean_inertia(signals: Signals, joint: int) -> float:
    return float(np.mean(signals.inertia[:, joint - 1]))
