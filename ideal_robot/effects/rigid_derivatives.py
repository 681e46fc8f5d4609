"""How the torques of a rigid body change with position, velocity and acceleration of one joint, along a motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array

_STEP = 1e-3
"""Of a position [rad or m]: rounding costs ``1e-13`` of the torque, curvature a millionth of the derivative."""
_KEPT = 128e6
"""Bytes of derivatives that are kept; the joint asked for last is kept at any length."""


class RigidDerivatives:
    """Derivatives by one joint after the other, each computed once as far as memory allows.

    Torques are linear in accelerations and quadratic in velocities, so central differences are exact there.

    Args:
        rigid: torque ``(N, n)`` of ``q, qd, qdd`` ``(N, n)`` each.
        q: positions ``(N, n)`` [rad or m].
        qd: velocities ``(N, n)`` [rad/s].
        qdd: accelerations ``(N, n)`` [rad/s²].
    """

    def __init__(self, rigid: Callable[[Array, Array, Array], Array], q: Array, qd: Array, qdd: Array) -> None:
        self._rigid, self._motion = rigid, (q, qd, qdd)
        self._known: dict[int, tuple[Array, Array, Array]] = {}

    def by(self, joint: int) -> tuple[Array, Array, Array]:
        """``d tau/dq_j, d tau/dqd_j, d tau/dqdd_j``, each ``(N, n)``, of ``joint`` (from 1)."""
        known = self._known.pop(joint, None) or self._computed(joint - 1)
        size = sum(one.nbytes for one in known)
        while self._known and size * (len(self._known) + 1) > _KEPT:
            del self._known[next(iter(self._known))]
        self._known[joint] = known
        return known

    def along(self, joint: int, position: Array, velocity: Array, acceleration: Array) -> Array:
        """What small changes of one joint's motion change in all torques ``(N, n)``, to first order.

        Args:
            joint: from 1.
            position: change ``(N,)`` [rad or m].
            velocity: change ``(N,)`` [rad/s].
            acceleration: change ``(N,)`` [rad/s²].
        """
        by_position, by_velocity, by_acceleration = self.by(joint)
        return np.asarray(by_position * position[:, None] + by_velocity * velocity[:, None]
                          + by_acceleration * acceleration[:, None])

    def _computed(self, j: int) -> tuple[Array, Array, Array]:
        by_position, by_velocity, by_acceleration = (self._difference(j, k, step)
                                                     for k, step in enumerate((_STEP, 1.0, 1.0)))
        return by_position, by_velocity, by_acceleration

    def _difference(self, j: int, k: int, step: float) -> Array:
        sides = []
        for sign in (1.0, -1.0):
            q, qd, qdd = (values.copy() if i == k else values for i, values in enumerate(self._motion))
            (q, qd, qdd)[k][:, j] += sign * step
            sides.append(self._rigid(q, qd, qdd))
        return np.asarray((sides[0] - sides[1]) / (2.0 * step))
