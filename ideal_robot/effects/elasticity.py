"""Gears between motor and arm: how what they do shows, and gears that give."""

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
    """A gear whose arm is not where the motor is: ``q_a = q - bend``.

    The bend is seen at the arm's angle, at the TCP through the Jacobian, and in the motor torque, which moves the arm
    on ``q_a``: ``delta tau = tau_rigid(q - bend, …) - tau_rigid(q, …)`` on all joints, to first order in the bend.
    """

    slow: ClassVar[float] = 2.5
    """The position filter lets pass all of the band that is looked at; the load counts up to two thirds of that."""

    def usable(self, signals: Signals, joint: int) -> bool:
        """See ``Effect.usable``: by torques where the rigid body is a known function, by a TCP that the joint moves."""
        return signals.rigid is not None if self.domain == MOTOR_TORQUE else shows_gear(self.domain, signals, joint)

    @abstractmethod
    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """What a unit coefficient bends the gear by ``(N,)``, in rad (m).

        Args:
            signals, joint, theta: as of ``Effect.columns``.
        """

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """See ``Effect.columns``. Shape ``(N, n, 1)``, at the TCP ``(N, 3, 1)``."""
        if self.domain != MOTOR_TORQUE:
            return turned_arm(self.domain, signals, joint, -self.bend(signals, joint, theta)[:, None])
        if signals.derivatives is None or len(signals.t) < 3:
            return np.zeros((len(signals.t), signals.n, 1))
        bend = self.bend(signals, joint, theta)
        if signals.cutoff is not None:
            # The bend is in the recorded position, and of that the filter let pass only the slow part.
            bend = lowpass(bend, signals.dt, signals.cutoff)
        rate = signals.rate(bend)
        return -signals.derivatives.along(joint, bend, rate, signals.rate(rate))[:, :, None]

    def load(self, signals: Signals, joint: int) -> Array:
        """Load that bends the gear ``(N,)`` [N m]; in torques as far as the motion asks for it.

        It is computed from the motor's position, which holds the bend: where the bend sets in, the motor's acceleration
        jumps, and that jump is no load of the arm. In recorded motions it is filtered out.
        """
        if self.domain == MOTOR_TORQUE and signals.cutoff is not None:
            return signals.slow_load(joint, signals.cutoff / self.slow)
        return signals.load[:, joint - 1]


class JointElasticity(GearEffect):
    """A gear that gives: ``q_a = q - tau_load/K``. In the torque its trace is the second derivative of the load."""

    usual = 1.0
    name = "joint_elasticity"
    coefficient_names = ("compliance",)
    coefficient_units = ("rad/(N m)",)
    source = "[J] (1), (2): elastic joint"

    def usable(self, signals: Signals, joint: int) -> bool:
        """See ``Effect.usable``.

        Without a load nothing bends; in torques a gear that the model knows gives further, or not at all.
        """
        known = self.domain == MOTOR_TORQUE and _known_gear(signals, joint)
        return super().usable(signals, joint) and not known and float(np.std(signals.load[:, joint - 1])) > 0.0

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """See ``GearEffect.bend``."""
        return self.load(signals, joint)

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. A spring holds; one in torques bends by less than a twentieth of a radian."""
        if self.domain != MOTOR_TORQUE:
            return bool(coefficients[0] > 0.0)
        bend = float(np.max(np.abs(signals.load[:, joint - 1])))
        return bool(0.0 < coefficients[0] * bend < 0.05) if bend else False

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """See ``Effect.parameters``. The stiffness."""
        c = float(coefficients[0])
        return [EffectParameter("stiffness", 1.0 / c, float(std[0]) / c**2, "N m/rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """See ``Effect.loop_change``. Torques give the whole compliance, angles what is added to the known one."""
        if self.domain == MOTOR_TORQUE:
            return LoopChange(gear_compliance=coefficients[0])
        return LoopChange(further_compliance=coefficients[0], from_arm_angle=self.domain == ARM_POSITION)


class FurtherElasticity(JointElasticity):
    """Seen in the motor torque beside a gear whose stiffness the model knows: what it gives beyond that."""

    coefficient_names = ("further compliance",)
    # A stiffer gear than the model's is as possible as a softer one.
    prefix = "tau_further"

    def usable(self, signals: Signals, joint: int) -> bool:
        """See ``Effect.usable``: only where the model has a stiffness of this gear."""
        return _known_gear(signals, joint) and GearEffect.usable(self, signals, joint)

    def spread(self, signals: Signals, joint: int) -> Array | None:
        """See ``Effect.spread``. A gear twice as soft as it is known to be is one standard deviation off."""
        known = 0.0 if signals.compliance is None else float(signals.compliance[joint - 1])
        return np.array([[known**2]])

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """See ``Effect.plausible``. A spring still holds."""
        known = 0.0 if signals.compliance is None else float(signals.compliance[joint - 1])
        return bool(coefficients[0] > -known)

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """See ``Effect.parameters``. The compliance, for the stiffness is the model's and this together."""
        return Effect.parameters(self, coefficients, std, theta, theta_std)

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """See ``Effect.loop_change``. Beyond what was known."""
        return LoopChange(further_compliance=coefficients[0])


def _known_gear(signals: Signals, joint: int) -> bool:
    return signals.compliance is not None and bool(signals.compliance[joint - 1] > 0.0)


class ElasticityAtArm(JointElasticity):
    """Seen at the arm's angle: ``q_a = q - (tau_load - J qdd)/K``, of what is taken for load the rotor's inertia ``J``.

    A rotor turns with its link, and torques tell the sum of their inertias; the link's alone bends the gear.
    """

    usual = 0.0
    theta_names = ("rotor inertia",)
    theta_units = ("kg m²",)

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """See ``Effect.starts``: the rotor inertia that the model has."""
        return [(0.0,)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """See ``Effect.bounds``.

        Either may have all of the inertia; of none, which a poorly identified model may have, there is nothing.
        """
        inertia = _mean_inertia(signals, joint)
        return [(-inertia, inertia)] if inertia > 0.0 else []

    def bounds_near(self, signals: Signals, joint: int, theta: Theta) -> list[tuple[float, float]]:
        """See ``Effect.bounds_near``. All of it: zero is as good as any."""
        return self.bounds(signals, joint)

    def complete(self, theta: Theta) -> bool:
        """See ``Effect.complete``. Without the rotor it is that of earlier versions."""
        return len(theta) <= 1

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """See ``GearEffect.bend``."""
        return np.asarray(self.load(signals, joint) - (theta[0] * signals.qdd[:, joint - 1] if theta else 0.0))

    def like_the_model(self, signals: Signals, joint: int) -> Array:
        """See ``Effect.like_the_model``. What the gear bends all the time is a constant of the measuring device."""
        return signals.on_joint(joint, np.ones(len(signals.t)))


class GearResonance(GearEffect):
    """Seen in the motor torque: what the arm is late by behind a soft gear is the answer of an oscillator to its load.

        M d²y/dt² + d dy/dt + K y = tau_load(q),   q_a = q - y,

    ``y`` the twist, ``M`` the inertia behind the gear, ``tau_load`` of the motor's own motion. ``JointElasticity`` is
    the limit of slow motion, ``y = tau_load/K``: at two thirds of the resonance ``sqrt(K/M)`` it has half of the twist,
    and above it the wrong sign. The coefficient is one where the inertia is right, in slow motion as well: what gives
    with the wrong sign there is no gear.
    """

    usual = 1.0
    name = JointElasticity.name
    theta_names = ("stiffness",)
    theta_units = ("N m/rad",)
    coefficient_names = ("share",)
    coefficient_units = ("1",)
    # The inertia that is set free is that behind the gear, as well as it is known.
    within = (0.4, 2.5)
    source = JointElasticity.source

    def usable(self, signals: Signals, joint: int) -> bool:
        """See ``Effect.usable``: there has to be a load, and an inertia behind the gear."""
        loaded = float(np.std(signals.load[:, joint - 1])) > 0.0 and _mean_inertia(signals, joint) > 0.0
        loaded = loaded and not _known_gear(signals, joint)
        return super().usable(signals, joint) and loaded and len(signals.t) > 2

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """See ``Effect.starts``: stiffnesses whose resonances lie at ``_HERTZ``."""
        return [(_stiffness(signals, joint, hertz),) for hertz in _HERTZ]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """See ``Effect.bounds``: stiffnesses whose resonances lie within the band."""
        return [(_stiffness(signals, joint, _LOWEST), _stiffness(signals, joint, _HIGHEST))]

    def bounds_near(self, signals: Signals, joint: int, theta: Theta) -> list[tuple[float, float]]:
        """See ``Effect.bounds_near``: from the start below to the start above."""
        (low, high), = self.bounds(signals, joint)
        return [(max(low, 0.72 * theta[0]), min(high, 1.4 * theta[0]))]

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """See ``GearEffect.bend``."""
        inertia = signals.inertia_behind(joint)
        return np.asarray(swinging(signals.load[:, joint - 1] / inertia, inertia, signals.dt, theta[0]))

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """See ``Effect.parameters``. The stiffness, no better than the inertia with which it swings is known."""
        sigma = theta_std[0] if theta_std else 0.0
        return [EffectParameter("stiffness", theta[0], float(np.hypot(sigma, theta[0] * (1.0 - coefficients[0]))),
                                "N m/rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """See ``Effect.loop_change``. The gear, as the torque says it: all of it."""
        return LoopChange(gear_compliance=1.0 / theta[0])


def turned_arm(domain: Domain, signals: Signals, joint: int, turn: Array) -> Array:
    """Columns of an arm that turns behind its gear: at the arm's angle ``(N, n, m)``, at the TCP ``(N, 3, m)``.

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
    """Whether what was measured lies behind the gear of a joint: arm angles do, a TCP if the joint moves it.

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
    """Twist of a gear that bends under its arm, from rest under the first load: motor less arm angle ``(N,)`` [rad].

    Args:
        acceleration: of the motor relative to the unloaded arm, ``tau_load/M`` ``(N,)`` [rad/s²].
        inertia: behind the gear ``(N,)`` [kg m²].
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
            # Implicit, so that it stays bounded where the inertia is small.
            speed = (speed + h * (driven - square * at)) / (1.0 + 2.0 * h * _DAMPING * np.sqrt(square) + h * h * square)
            at += h * speed
        twist[k] = at
    return twist


def _stiffness(signals: Signals, joint: int, hertz: float) -> float:
    return (2.0 * np.pi * hertz) ** 2 * max(_mean_inertia(signals, joint), 1e-12)


def _mean_inertia(signals: Signals, joint: int) -> float:
    return float(np.mean(signals.inertia[:, joint - 1]))
