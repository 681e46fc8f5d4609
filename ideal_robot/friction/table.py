"""Friction of all joints as a table for compiled code: dry and fluid friction over speed, load, presliding."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.friction.laws import PerJointFriction
from ideal_robot.friction.presliding import friction_torque, presliding_state
from ideal_robot.jit import jit
from ideal_robot.tolerances import CREEP

FORWARD, BACKWARD = 0, 1
DRY, FLUID = 0, 1


class Friction(NamedTuple):
    """Friction of ``n`` joints over ``m`` speeds; the equations are in ``ideal_robot.friction.presliding``.

    Attributes:
        speeds: rising from 0 ``(n, m)`` [rad/s]; linear in between, constant beyond.
        sizes: dry and fluid friction of an unloaded gear, forward and backward ``(n, 2, m, 2)`` [N m].
        per_load: dry friction per torque that the gear transmits, and its increase where the motor drives the load
            ``(n, 2)`` [1].
        distance: presliding distance ``(n,)`` [rad]; 0 where dry friction jumps.
    """

    speeds: Array
    sizes: Array
    per_load: Array
    distance: Array

    @classmethod
    def of(cls, law: PerJointFriction, v_max: Array) -> Friction:
        """The table of an identified law.

        Args:
            law: of every joint.
            v_max: speed limits ``(n,)`` [rad/s].
        """
        speeds = speed_grid(v_max)
        v = np.maximum(speeds, CREEP).T
        sizes = np.stack([np.stack(law.sizes(sign * v), axis=-1) for sign in (1.0, -1.0)]).transpose(2, 0, 1, 3)
        sizes = np.ascontiguousarray(sizes)
        braking(sizes)
        per_load = np.array([(one.coefficients[-1, 0] if one.loaded else 0.0, 0.0) for one in law.laws])
        return cls(speeds, sizes, per_load, law.distance)

    @property
    def dry(self) -> Array:
        """Dry friction at standstill, mean of both directions ``(n,)`` [N m]."""
        return np.asarray(self.sizes[:, :, 0, DRY].mean(axis=1))

    @property
    def sliding(self) -> Array:
        """Sliding friction of an unloaded gear, forward and backward ``(n, 2, m)`` [N m]."""
        return np.asarray(self.sizes.sum(axis=3))


@jit()
def braking(sizes: Array) -> None:
    """Makes sizes of friction dissipative: negative fluid friction is subtracted from the dry one, both end above zero.

    Args:
        sizes: dry and fluid friction ``(n, 2, m, 2)`` [N m], written to.
    """
    for i in range(sizes.shape[0]):
        for side in range(sizes.shape[1]):
            for k in range(sizes.shape[2]):
                dry, fluid = sizes[i, side, k, 0], sizes[i, side, k, 1]
                sizes[i, side, k, 0] = max(dry + min(fluid, 0.0), 0.0)
                sizes[i, side, k, 1] = max(fluid, 0.0)


@jit()
def distance_with(friction: Friction, sizes: Array) -> Array:
    """Presliding distance ``(n,)`` [rad] of friction with other sizes.

    The contacts' stiffness D(0)/d is constant, so they deform further with larger friction (LuGre: constant bristle
    stiffness). Load differs: it brings more contacts together, and the distance stays.

    Args:
        friction: friction before the step.
        sizes: dry and fluid friction as it is now ``(n, 2, m, 2)`` [N m].
    """
    distance = friction.distance.copy()
    for i in range(len(distance)):
        before = friction.sizes[i, 0, 0, 0] + friction.sizes[i, 1, 0, 0]
        now = sizes[i, 0, 0, 0] + sizes[i, 1, 0, 0]
        if before > 0.0 and now > 0.0:
            distance[i] *= now / before
    return distance


def largest_speeds(v_max: Array) -> Array:
    """Largest speeds of the friction tables ``(n,)`` [rad/s]: the limits, 10 rad/s where an arm has none."""
    return np.where(np.isfinite(v_max), v_max, 10.0)


def speed_grid(v_max: Array) -> Array:
    """Speeds ``(n, 161)`` [rad/s] at which friction is tabled: dense near zero, up to 1.2 × the limit."""
    return np.ascontiguousarray(1.2 * largest_speeds(v_max)[:, None] * np.linspace(0.0, 1.0, 161) ** 3)


# Inlined, as passing the record on took an eighth of the loop's simulation time.
@jit(inline="always")
def friction_sizes(friction: Friction, joint: int, v: float, load: float) -> tuple[float, float]:
    """Sizes of dry and fluid friction of a joint [N m].

    Args:
        friction, joint: of the arm, and which joint, from 0.
        v: velocity of the motor [rad/s]. At rest the forward value is used.
        load: torque that the gear transmits [N m].
    """
    speed, side, low, high = abs(v), 0 if v >= 0.0 else 1, 0, friction.speeds.shape[1] - 1
    dry, fluid = friction.sizes[joint, side, high, 0], friction.sizes[joint, side, high, 1]
    if speed < friction.speeds[joint, high]:
        while high - low > 1:
            middle = (low + high) // 2
            if speed < friction.speeds[joint, middle]:
                high = middle
            else:
                low = middle
        share = ((speed - friction.speeds[joint, low])
                 / (friction.speeds[joint, high] - friction.speeds[joint, low]))
        dry, fluid = friction.sizes[joint, side, low, 0], friction.sizes[joint, side, low, 1]
        dry += share * (friction.sizes[joint, side, high, 0] - dry)
        fluid += share * (friction.sizes[joint, side, high, 1] - fluid)
    per_load = friction.per_load[joint, 0]
    if load * v > 0.0:
        per_load += friction.per_load[joint, 1]
    return dry + per_load * abs(load), fluid


@jit(inline="always")
def friction_step(friction: Friction, joint: int, v: float, load: float, force: float, step: float
                  ) -> tuple[float, float]:
    """Friction torque of a joint, and its presliding state after a step [N m]; the equations: ``friction_torque``.

    Args:
        friction, joint, v, load: as in ``friction_sizes``.
        force: presliding state before the step [N m].
        step: displacement of the motor [rad].
    """
    dry, fluid = friction_sizes(friction, joint, v, load)
    return friction_torque(dry, fluid, v, force, step, friction.distance[joint])


class Presliding(NamedTuple):
    """Presliding state of all joints, ``(n,)`` each, or along a motion ``(m, n)``.

    Attributes:
        force: of the contacts [N m].
        direction: of sliding, -1 to 1: the force of a unit of dry friction.
    """

    force: Array
    direction: Array

    @classmethod
    def none(cls, n: int) -> Presliding:
        """State of ``n`` joints without any presliding."""
        return cls(np.zeros(n), np.zeros(n))


@jit()
def friction_along(friction: Friction, v: Array, load: Array, steps: Array, before: Presliding
                   ) -> tuple[Array, Presliding]:
    """Friction torques along a motion ``(m, n)`` [N m], and the presliding states.

    Args:
        friction, v, load, steps: of ``friction_step``, ``(m, n)`` each but the first.
        before: state of the ``n`` joints before the motion.
    """
    torque, forces, directions = np.empty_like(v), np.empty_like(v), np.empty_like(v)
    for i in range(v.shape[1]):
        force, direction, distance = before.force[i], before.direction[i], friction.distance[i]
        for k in range(len(v)):
            torque[k, i], force = friction_step(friction, i, v[k, i], load[k, i], force, steps[k, i])
            direction = presliding_state(1.0, v[k, i], direction, steps[k, i], distance)
            forces[k, i], directions[k, i] = force, direction
    return torque, Presliding(forces, directions)
