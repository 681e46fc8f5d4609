"""Elastic gears between motor and arm: the channels that show a gear, and compliant gears."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import ARM_POSITION, MOTOR_TORQUE, TCP_POSITION, Domain, Effect, EffectParameter, Theta
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import LEVER, Signals
from ideal_robot.jit import jit
from ideal_robot.signals.filters import lowpass

_HERTZ = (5.0, 6.0, 7.0, 8.2, 9.6, 11.2, 13.0)
"""Resonances behind a motor that stands [Hz] that are looked for: above the band of torques the gear bends as its load
asks, which ``JointElasticity`` says; arms in use do not swing slower."""
_LOWEST, _HIGHEST = 4.0, 14.0
"""Ends of the search: a step beyond the lowest and the highest of ``_HERTZ`` [Hz]."""
_DAMPING = 0.1
"""Of the gear, as a share of the critical: that of loaded gears is between a few hundredths and a few tenths."""
_STEP = 1e-3
"""[s] of the integration, at most."""


class GearEffect(Effect):
    """A gear behind which the arm angle differs from the motor angle: ``q_a = q - bend``.

    The deflection ``bend`` is seen at the arm's angle, at the TCP through the Jacobian, and in the motor torque, which
    moves the arm on ``q_a``: ``delta tau = tau_rigid(q - bend, …) - tau_rigid(q, …)`` on all joints, to first order in
    the deflection.
    """

    slow: ClassVar[float] = 2.5
    """The position filter lets pass all of the band that is looked at; the load counts up to two thirds of that."""

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show it: torques need a rigid-body function, a TCP needs a joint that moves it."""
        return signals.rigid is not None if self.domain == MOTOR_TORQUE else shows_gear(self.domain, signals, joint)

    @abstractmethod
    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Deflection of the gear for a unit coefficient ``(N,)`` [rad or m].

        Args:
            signals, joint, theta: as in ``Effect.columns``.
        """

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``, at the TCP ``(N, 3, 1)``; see ``Effect.columns``."""
        if self.domain != MOTOR_TORQUE:
            return turned_arm(self.domain, signals, joint, -self.bend(signals, joint, theta)[:, None])
        if signals.derivatives is None or len(signals.t) < 3:
            return np.zeros((len(signals.t), signals.n, 1))
        bend = self.bend(signals, joint, theta)
        if signals.cutoff is not None:
            # The deflection is in the recorded position, of which the filter passed only the slow part.
            bend = lowpass(bend, signals.dt, signals.cutoff)
        rate = signals.rate(bend)
        return -signals.derivatives.along(joint, bend, rate, signals.rate(rate))[:, :, None]

    def load(self, signals: Signals, joint: int) -> Array:
        """Load that deflects the gear ``(N,)`` [N m]; for torques only within the band of the motion.

        It is computed from the motor's position, which contains the deflection: where that sets in, the motor's
        acceleration jumps without a load of the arm. In recorded motions this is filtered out.
        """
        if self.domain == MOTOR_TORQUE and signals.cutoff is not None:
            return signals.slow_load(joint, signals.cutoff / self.slow)
        return signals.load[:, joint - 1]


class JointElasticity(GearEffect):
    """A compliant gear: ``q_a = q - tau_load/K``; in torques it shows as the second derivative of the load."""

    usual = 1.0
    name = "joint_elasticity"
    coefficient_names = ("compliance",)
    coefficient_units = ("rad/(N m)",)
    source = "[J] (1), (2): elastic joint"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the needed signals exist and the joint moves enough to show the effect; see ``Effect.usable``.

        It needs a load; in torques, a gear whose stiffness the model has is left to ``FurtherElasticity``.
        """
        known = self.domain == MOTOR_TORQUE and _known_gear(signals, joint)
        return super().usable(signals, joint) and not known and float(np.std(signals.load[:, joint - 1])) > 0.0

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Deflection of the gear for a unit coefficient ``(N,)`` [rad or m]; see ``GearEffect.bend``."""
        return self.load(signals, joint)

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: a positive stiffness; in torques a deflection below 0.05 rad.

        See ``Effect.plausible``.
        """
        if self.domain != MOTOR_TORQUE:
            return bool(coefficients[0] > 0.0)
        bend = float(np.max(np.abs(signals.load[:, joint - 1])))
        return bool(0.0 < coefficients[0] * bend < 0.05) if bend else False

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: the stiffness; see ``Effect.parameters``."""
        c = float(coefficients[0])
        return [EffectParameter("stiffness", 1.0 / c, float(std[0]) / c**2, "N m/rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: torques determine the whole compliance, angles what is added to the known one."""
        if self.domain == MOTOR_TORQUE:
            return LoopChange(gear_compliance=coefficients[0])
        return LoopChange(further_compliance=coefficients[0], from_arm_angle=self.domain == ARM_POSITION)


class FurtherElasticity(JointElasticity):
    """Compliance of a gear beyond the stiffness that the model has, as seen in motor torques."""

    coefficient_names = ("further compliance",)
    # A stiffer gear than the model's is as possible as a softer one.
    prefix = "tau_further"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: only where the model has a stiffness of this gear."""
        return _known_gear(signals, joint) and GearEffect.usable(self, signals, joint)

    def spread(self, signals: Signals, joint: int) -> Array | None:
        """Prior covariance of the coefficients: one standard deviation is a gear twice as soft as in the model."""
        known = 0.0 if signals.compliance is None else float(signals.compliance[joint - 1])
        return np.array([[known**2]])

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: the total stiffness stays positive; see ``Effect.plausible``."""
        known = 0.0 if signals.compliance is None else float(signals.compliance[joint - 1])
        return bool(coefficients[0] > -known)

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: the additional compliance, as the stiffness also depends on the model's.

        See ``Effect.parameters``.
        """
        return Effect.parameters(self, coefficients, std, theta, theta_std)

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: compliance beyond the known one; see ``Effect.loop_change``."""
        return LoopChange(further_compliance=coefficients[0])


def _known_gear(signals: Signals, joint: int) -> bool:
    return signals.compliance is not None and bool(signals.compliance[joint - 1] > 0.0)


class ElasticityAtArm(JointElasticity):
    """Compliant gear seen at the arm angle: ``q_a = q - (tau_load - J qdd)/K``, without the rotor inertia ``J``.

    Torques determine the sum of rotor's and link's inertia; only the link's deflects the gear.
    """

    usual = 0.0
    theta_names = ("rotor inertia",)
    theta_units = ("kg m²",)

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: the rotor inertia that the model has; see ``Effect.starts``."""
        return [(0.0,)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Physical bounds of each theta; see ``Effect.bounds``.

        From none to all of the inertia; a poorly identified model may have none.
        """
        inertia = _mean_inertia(signals, joint)
        return [(-inertia, inertia)] if inertia > 0.0 else []

    def bounds_near(self, signals: Signals, joint: int, theta: Theta) -> list[tuple[float, float]]:
        """Bounds of theta near a start: the full range, as zero is a valid start; see ``Effect.bounds_near``."""
        return self.bounds(signals, joint)

    def complete(self, theta: Theta) -> bool:
        """Whether theta is complete: files of earlier versions lack the rotor inertia; see ``Effect.complete``."""
        return len(theta) <= 1

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Deflection of the gear for a unit coefficient ``(N,)`` [rad or m]; see ``GearEffect.bend``."""
        return np.asarray(self.load(signals, joint) - (theta[0] * signals.qdd[:, joint - 1] if theta else 0.0))

    def like_the_model(self, signals: Signals, joint: int) -> Array:
        """A constant column, as a constant deflection equals an offset of the measuring device."""
        return signals.on_joint(joint, np.ones(len(signals.t)))


class GearResonance(GearEffect):
    """Resonance of a soft gear in the motor torque: the arm follows the motor as an oscillator under its load.

        M d²y/dt² + d dy/dt + K y = tau_load(q),   q_a = q - y,

    ``y`` the twist, ``M`` the inertia behind the gear, ``tau_load`` of the motor's own motion. ``JointElasticity`` is
    the limit of slow motion, ``y = tau_load/K``: at two thirds of the resonance ``sqrt(K/M)`` it has half of the twist,
    and above it the wrong sign. The coefficient is one if the inertia is right, also in slow motion; a negative one is
    not a gear.
    """

    usual = 1.0
    name = JointElasticity.name
    theta_names = ("stiffness",)
    theta_units = ("N m/rad",)
    coefficient_names = ("share",)
    coefficient_units = ("1",)
    # The inertia in the free motion is that behind the gear, within the model's accuracy.
    within = (0.4, 2.5)
    source = JointElasticity.source

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: there has to be a load, and an inertia behind the gear."""
        loaded = float(np.std(signals.load[:, joint - 1])) > 0.0 and _mean_inertia(signals, joint) > 0.0
        loaded = loaded and not _known_gear(signals, joint)
        return super().usable(signals, joint) and loaded and len(signals.t) > 2

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: stiffnesses whose resonances lie at ``_HERTZ``; see ``Effect.starts``."""
        return [(_stiffness(signals, joint, hertz),) for hertz in _HERTZ]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta: stiffnesses whose resonances lie within the band; see ``Effect.bounds``."""
        return [(_stiffness(signals, joint, _LOWEST), _stiffness(signals, joint, _HIGHEST))]

    def bounds_near(self, signals: Signals, joint: int, theta: Theta) -> list[tuple[float, float]]:
        """Bounds of theta near a start: from the start below to the start above; see ``Effect.bounds_near``."""
        (low, high), = self.bounds(signals, joint)
        return [(max(low, 0.72 * theta[0]), min(high, 1.4 * theta[0]))]

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Deflection of the gear for a unit coefficient ``(N,)`` [rad or m]; see ``GearEffect.bend``."""
        inertia = signals.inertia_behind(joint)
        return np.asarray(swinging(signals.load[:, joint - 1] / inertia, inertia, signals.dt, theta[0]))

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: the stiffness, no more accurate than the inertia behind the gear.

        See ``Effect.parameters``.
        """
        sigma = theta_std[0] if theta_std else 0.0
        return [EffectParameter("stiffness", theta[0], float(np.hypot(sigma, theta[0] * (1.0 - coefficients[0]))),
                                "N m/rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: the whole compliance of the gear, as from torques; see ``Effect.loop_change``."""
        return LoopChange(gear_compliance=1.0 / theta[0])


def turned_arm(domain: Domain, signals: Signals, joint: int, turn: Array) -> Array:
    """Columns of a rotation of the arm behind its gear: at the arm's angle ``(N, n, m)``, at the TCP ``(N, 3, m)``.

    Args:
        domain: of arm angles or of the TCP.
        signals, joint: of ``N`` samples, and from 1.
        turn: of the joint ``(N, m)`` [rad or m per unit of the coefficient].
    """
    if domain != TCP_POSITION:
        return signals.on_joint(joint, *turn.T)
    if signals.frames is None:
        return np.zeros((len(signals.t), 3, turn.shape[1]))
    return np.asarray(signals.frames.jacobian[:, :, joint - 1, None] * turn[:, None, :])


def shows_gear(domain: Domain, signals: Signals, joint: int) -> bool:
    """Whether a domain measures behind the gear of a joint: arm angles do, a TCP if the joint moves it.

    Args:
        domain: of arm angles or of the TCP.
        signals, joint: of the recording, and from 1.
    """
    if domain != TCP_POSITION:
        return True
    if signals.frames is None or not np.any(signals.load[:, joint - 1] != 0.0):
        return False
    return bool(np.max(np.abs(signals.frames.jacobian[:, :, joint - 1])) > LEVER)


@jit()
def swinging(acceleration: Array, inertia: Array, dt: float, stiffness: float) -> Array:
    """Twist of a gear that oscillates with its arm, from rest under the first load: motor less arm ``(N,)`` [rad].

    Args:
        acceleration: of the motor relative to the unloaded arm, ``tau_load/M`` ``(N,)`` [rad/s²].
        inertia: inertia on the load side of the gear ``(N,)`` [kg m²].
        dt: between samples [s].
        stiffness: of the gear [N m/rad].
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
            # Implicit, so that it stays bounded for a small inertia.
            speed = (speed + h * (driven - square * at)) / (1.0 + 2.0 * h * _DAMPING * np.sqrt(square) + h * h * square)
            at += h * speed
        twist[k] = at
    return twist


def _stiffness(signals: Signals, joint: int, hertz: float) -> float:
    return (2.0 * np.pi * hertz) ** 2 * max(_mean_inertia(signals, joint), 1e-12)


def _mean_inertia(signals: Signals, joint: int) -> float:
    return float(np.mean(signals.inertia[:, joint - 1]))
