"""Effects of gravity and loads: unknown bodies, springs against gravity, a tilted base."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array, G
from ideal_robot.effects.base import Effect, EffectParameter, Theta, WholeArmEffect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals

_UPRIGHT = 1e-6
"""Weight that an axis carries, over the most that any does, up to which it stands upright."""


_MASS, _LEVER = 5.0, 0.25
"""What is carried beforehand [kg], and how far out on a link [m]."""
_NEAR = 0.1
"""How far the centre of a tool or part is from where tools are held, in each direction [m]."""


class LinkLoad(Effect):
    """Mass, first moments and inertias added to one link, [G] (5); only with a given model.

    A body away from the axis needs its inertia: without it a load on the first links would be placed further out. On
    the last link it is a ``Payload``. Often only the product of mass and lever is determined, so the parameters are
    reported as fitted.
    """

    prior = -1.1  # Links are hardly ever changed.
    name = "link_load"
    coefficient_names = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    coefficient_units = ("kg", "kg m", "kg m", "kg m", *["kg m²"] * 6)
    absorbed_by_base = True
    changes = "body"
    source = "[G] (5)"

    def joints(self, signals: Signals) -> Iterator[int]:
        """Joints with the effect: all links but the last; see ``Effect.joints``."""
        yield from range(1, signals.n)

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: they need the regressor of the links; see ``Effect.usable``."""
        return signals.bodies is not None

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 10)``; see ``Effect.columns``."""
        if signals.bodies is None:
            return np.zeros((len(signals.t), signals.n, 10))
        return np.asarray(signals.bodies(joint))

    def spread(self, signals: Signals, joint: int) -> Array | None:
        """Prior covariance of the coefficients: some kilograms at some decimetres; see ``Effect.spread``."""
        return np.diag(np.square([_MASS] + 3 * [_MASS * _LEVER] + 6 * [_MASS * _LEVER**2]))

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: the lever is within the arm's size.

        See ``Effect.plausible``.
        """
        return bool(np.any(np.abs(coefficients) > 1e-9))


def _point(place: Array) -> Array:
    """Parameters of a kilogram at a place ``(3,)`` [m] of a link ``(10,)``, in their order."""
    x, y, z = place
    return np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])


class Payload(WholeArmEffect, LinkLoad):
    """Mass, first moments and inertias added to the last link, [G] (5) with that link's columns only.

    It acts on all joints, so it belongs to the whole arm (joint 0).
    """

    prior = 3.0  # Tools are often changed, links are not.
    name = "payload"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: they need the regressor of the last link; see ``Effect.usable``."""
        return signals.payload is not None

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 10)``; see ``Effect.columns``."""
        if signals.payload is None:
            return np.zeros((len(signals.t), signals.n, 10))
        return signals.payload

    def spread(self, signals: Signals, joint: int) -> Array | None:
        """Prior covariance of the coefficients: the payload hangs at the tool, its centre some decimetres from it.

        Its torque in each joint is at most as large as the arm's own.
        """
        if signals.tool is None or signals.payload is None:
            return super().spread(signals, joint)
        step = 1e-3
        with np.errstate(divide="ignore", invalid="ignore"):
            bears = np.sqrt(np.mean(signals.torque**2, axis=0) /
                            np.mean((signals.payload @ _point(signals.tool)) ** 2, axis=0))
        mass = min(_MASS, float(np.min(bears, initial=np.inf, where=np.isfinite(bears) & (bears > 0.0))))
        moved = [(_point(signals.tool + step * axis) - _point(signals.tool - step * axis)) / (2.0 * step)
                 for axis in np.eye(3)]
        ways = mass * np.column_stack([_point(signals.tool), *(_NEAR * way for way in moved)])
        own = np.diag(np.square(mass * np.array([1e-3] + 3 * [1e-2] + 6 * [_NEAR**2])))
        return np.asarray(ways @ ways.T + own)

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible; see ``Effect.plausible``.

        The mass is positive, or negative for a removed body; the first moments then have a plausible lever.
        """
        mass, first = float(coefficients[0]), float(np.linalg.norm(coefficients[1:4]))
        return abs(mass) > 1e-9 and first < 3.0 * abs(mass) + 1e-9

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: mass, and the centre in the frame of the last joint; see ``Effect.parameters``."""
        m = float(coefficients[0])
        centre = [EffectParameter(f"c_{axis}", float(coefficients[i + 1]) / m,
                                  float(np.hypot(std[i + 1] / m, coefficients[i + 1] * std[0] / m**2)), "m")
                  for i, axis in enumerate("xyz")]
        return [EffectParameter("mass", m, float(std[0]), "kg"), *centre]


class BaseTilt(WholeArmEffect):
    """Tilted base: gravity has components across the base's z axis, ``tau = g_x tau_x(q) + g_y tau_y(q)``.

    ``tau_x`` is the rigid body's torque under 1 m/s² of gravity along the base's x axis: one cause for all joints
    (joint 0), to first order in the angle. A rotation about the vertical has no effect.

    About a vertical first axis gravity does nothing, and no motion determines the first moments, for which a model has
    the URDF's. On a tilted base they load that axis by ``c cos q_1 + s sin q_1``, [G] (5); both numbers are free, up to
    the moment of the whole arm about the axis.
    """

    name = "base_tilt"
    coefficient_names = ("gravity along x", "gravity along y", "unknown moments, cosine", "unknown moments, sine")
    coefficient_units = ("m/s²", "m/s²", "N m", "N m")
    source = "[G] (5) with another direction of gravity"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show it: they need torques of horizontal gravity, and a second joint."""
        return signals.n > 1 and signals.gravity_across is not None

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 4)``; see ``Effect.columns``."""
        result = np.zeros((len(signals.t), signals.n, 4))
        if signals.across is None:
            return result
        result[:, :, :2] = signals.across
        if not _carries_weight(signals) and np.any(result[:, 0, :2]):
            result[:, 0, 2:] = np.column_stack([np.cos(signals.q[:, 0]), np.sin(signals.q[:, 0])])
        return result

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: the angle is below 15°; a larger one is a mounting on purpose.

        See ``Effect.plausible``.
        """
        across, unknown = np.hypot(*coefficients[:2]), np.hypot(*coefficients[2:])
        if unknown > 0.0 and signals.across is not None:
            known = np.linalg.norm(signals.across[:, 0], axis=1)
            if unknown > across * float(np.max(known)):
                return False
        return bool(across < math.sin(math.radians(15.0)) * G)

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: the angle and direction of the base's tilt; see ``Effect.parameters``."""
        x, y = (float(v) for v in coefficients[:2])
        size = float(np.hypot(x, y))
        across = float(np.hypot(x * std[0], y * std[1]) / max(size, 1e-12))
        along = float(np.hypot(y * std[0], x * std[1]) / max(size, 1e-12) ** 2)
        return [EffectParameter("angle", size / G, across / G, "rad"),
                EffectParameter("direction", float(np.arctan2(y, x)), along, "rad")]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: tilted gravity; the first moments are the URDF's; see ``Effect.loop_change``."""
        return LoopChange(gravity=(coefficients[0], coefficients[1]))


class AngleLaw(Effect):
    """A function of its joint's angle alone; if a learned curve is needed beside it, its form is wrong."""


class CableSpring(AngleLaw):
    """A linear spring on one joint, such as a cable or hose: ``tau = k q``; its rest position is in the offset."""

    name = "cable_spring"
    coefficient_names = ("stiffness",)
    coefficient_units = ("N m/rad",)
    # The motor works against the pull: a spring resists, it does not drive.
    within = (0.0, np.inf)
    source = "hose packs and cables along the arm"

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        return signals.on_joint(joint, signals.q[:, joint - 1])


class SlackCable(AngleLaw):
    """A cable or hose with slack, which pulls where it is taut, progressively with its extension.

        tau = k (x - y) + k_2 (x² - y²),   x = max(q - q_above, 0),   y = max(q_below - q, 0)

    Between ``q_below`` and ``q_above`` it is slack. Most cables pull on one side only; the other bound is then outside
    the motion.
    """

    name = CableSpring.name
    prefix = "tau_taut"
    theta_names = ("taut below", "taut above")
    theta_units = ("rad", "rad")
    coefficient_names = ("stiffness", "growth of stiffness")
    coefficient_units = ("N m/rad", "N m/rad²")
    source = CableSpring.source

    @property
    def at_motor(self) -> bool:
        """Whether the effect is a torque at the motor; see ``Effect.at_motor``."""
        return True

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: taut on one side, from six places of the range, and taut on both sides."""
        (never, _), (_, nor) = self.bounds(signals, joint)
        low, turned = float(signals.q[:, joint - 1].min()), float(np.ptp(signals.q[:, joint - 1]))
        places = [low + share * turned for share in (0.1, 0.26, 0.42, 0.58, 0.74, 0.9)]
        return [*((never, place) for place in places), *((place, nor) for place in places), (places[1], places[4])]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Physical bounds of each theta; see ``Effect.bounds``.

        Within the joint's range in the motion, or as far again beyond it.
        """
        q = signals.q[:, joint - 1]
        low, high = float(q.min()), float(q.max())
        return [(2.0 * low - high, high), (low, 2.0 * high - low)]

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 2)``; see ``Effect.columns``."""
        q = signals.q[:, joint - 1]
        above, below = np.maximum(q - max(theta), 0.0), np.maximum(min(theta) - q, 0.0)
        return signals.on_joint(joint, above - below, above**2 - below**2)

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: it pulls back everywhere up to 1.5 times its extension.

        See ``Effect.plausible``.
        """
        q, (k, growth) = signals.q[:, joint - 1], coefficients
        furthest = max(float(q.max()) - max(theta), min(theta) - float(q.min()), 0.0)
        return bool(min(k + growth * furthest, k + 0.5 * growth * furthest) > 0.0)


class GravitySpring(AngleLaw):
    """Torque of a spring between a point on the link and one on the frame ([J] section 2: gravity compensator).

    With lever ratio ``rho`` of the two attachment points and the angle ``phi`` at which they are in line, the length
    in units of the longer lever is ``l = sqrt(1 + rho^2 + 2 rho cos(q - phi))``, ``l_0`` at a right angle, and the
    torque

        tau = c_1 sin(q - phi) + c_2 sin(q - phi) (1 / l - 1 / l_0) .

    ``c_1`` is the torque at a right angle, which is like gravity's; the deviation from a sine comes from the preload.
    """

    prior = -2.0  # Few arms have one, and only in one joint.
    name = "gravity_spring"
    theta_names = ("phi", "rho")
    theta_units = ("rad", "1")
    coefficient_names = ("torque at a right angle", "preload term")
    coefficient_units = ("N m", "N m")
    discriminating_motion = (
        ("cable_spring", "the joint's whole range: a cable pulls in proportion, a balancer with the sine"),
    )
    source = "[J] section 2"

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: eight directions, two lever ratios; see ``Effect.starts``."""
        return [(float(phi), rho) for phi in np.arange(8) * np.pi / 4 for rho in (0.35, 0.7)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Physical bounds of each theta; see ``Effect.bounds``.

        Any direction; levers neither equal (the spring would vanish) nor one of them zero (no torque).
        """
        return [(-np.pi, 3.0 * np.pi), (0.1, 0.9)]

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: gravity has to act on the joint; see ``Effect.usable``."""
        if signals.weight is None:
            return True
        size = np.abs(signals.weight).max(axis=0)
        return bool(size[joint - 1] > _UPRIGHT * size.max())

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 2)``; see ``Effect.columns``."""
        phi, rho = theta
        angle = signals.q[:, joint - 1] - phi
        length = np.sqrt(1.0 + rho**2 + 2.0 * rho * np.cos(angle))
        return signals.on_joint(joint, np.sin(angle), np.sin(angle) * (1.0 / length - 1.0 / np.sqrt(1.0 + rho**2)))

    def like_the_model(self, signals: Signals, joint: int) -> Array:
        """Gravity's two components over the joint's angle, which the model has, too; see ``Effect.like_the_model``."""
        q = signals.q[:, joint - 1]
        return signals.on_joint(joint, np.sin(q), np.cos(q))

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: as fitted, with the angle within one turn; see ``Effect.parameters``."""
        parameters = super().parameters(coefficients, std, theta, theta_std)
        angle = parameters[2]
        return [*parameters[:2], EffectParameter(angle.name, float(np.angle(np.exp(1j * angle.value))), angle.std,
                                                 angle.unit), parameters[3]]


def _carries_weight(signals: Signals) -> bool:
    """Whether gravity turns the first axis of the upright arm."""
    if signals.weight is None:
        return True
    size = np.abs(signals.weight).max(axis=0)
    return bool(size[0] > _UPRIGHT * size.max())
