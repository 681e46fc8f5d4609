"""Signals for the terms of a command law: a motion with its derivatives, torques, and rigid-body torques."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import pinocchio as pin
from scipy.interpolate import make_interp_spline

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, chain_of, inverse_dynamics

_KEPT = 100
"""Rows up to which the matrices of derivatives are kept: those of a control cycle's horizon."""
_DEGREE = 5
"""Of the splines that are differentiated: a quintic has continuous third derivatives."""


@dataclass(frozen=True)
class Bodies:
    """The rigid bodies of an arm with their rotors.

    Attributes:
        chain: of the links.
        rotor_inertia: reflected to the joint side ``(n,)`` [kg m², kg where a joint slides].
    """

    chain: Chain
    rotor_inertia: Array

    @classmethod
    def of(cls, dynamics: pin.Model, rotor_inertia: Array) -> Bodies:
        """The bodies of a Pinocchio model and rotor inertias ``(n,)``."""
        return cls(chain_of(dynamics), np.array(rotor_inertia))

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Motor torque ``(N, n)`` [N m] of a motion by the rigid bodies, without friction.

        Args:
            q, qd, qdd: positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²].
        """
        body = inverse_dynamics(self.chain, *(np.ascontiguousarray(x, dtype=float) for x in (q, qd, qdd)))
        return np.asarray(body + self.rotor_inertia * qdd)

    def mass(self, q: Array) -> Array:
        """Mass matrices ``(N, n, n)`` [kg m²], rotors included."""
        n, still = q.shape[1], np.zeros_like(q)
        at_rest = self.torque(q, still, still)
        columns = [self.torque(q, still, np.tile(unit, (len(q), 1))) - at_rest for unit in np.eye(n)]
        return np.stack(columns, axis=2)


@dataclass(frozen=True)
class Motion:
    """A motion of all joints at even instants.

    Attributes:
        dt: their distance [s].
        q, qd, qdd, qddd: positions and derivatives ``(N, n)`` [rad, rad/s, …].
        still: speed below which a joint is treated as reversing ``(n,)`` [rad/s].
        torque: of the motors ``(N, n)`` [N m]; None where nobody knows it.
        bodies: of the arm; None where nobody knows them.
    """

    dt: float
    q: Array
    qd: Array
    qdd: Array
    qddd: Array
    still: Array
    torque: Array | None = None
    bodies: Bodies | None = None

    @classmethod
    def of(cls, q: Array, dt: float, still: Array, bodies: Bodies | None = None) -> Motion:
        """The motion of smooth positions, with derivatives.

        Args:
            q, dt: positions ``(N, n)`` [rad], and their distance [s].
            still: speed below which a joint is treated as reversing ``(n,)`` [rad/s].
            bodies: of the arm; None where nobody knows them.
        """
        qd, qdd, qddd = spline_derivatives(q, dt, 3)
        return cls(dt, q, qd, qdd, qddd, still, None, bodies)

    def with_torque(self, torque: Array | None) -> Motion:
        """The same motion with torques ``(N, n)`` [N m]."""
        return replace(self, torque=torque)

    @cached_property
    def torque_rate(self) -> Array:
        """Rate of the torques ``(N, n)`` [N m/s]."""
        assert self.torque is not None
        return spline_derivatives(self.torque, self.dt, 1, degree=3)[0]

    @cached_property
    def direction(self) -> Array:
        """Direction in which each joint slides ``(N, n)``, -1 to 1."""
        return np.tanh(self.qd / self.still)

    @cached_property
    def body(self) -> Array:
        """Torque of the bodies ``(N, n)`` [N m]."""
        assert self.bodies is not None
        return self.bodies.torque(self.q, self.qd, self.qdd)

    @cached_property
    def body_rate(self) -> Array:
        """Rate of the torque of the bodies ``(N, n)`` [N m/s]."""
        return spline_derivatives(self.body, self.dt, 1, degree=3)[0]

    @cached_property
    def gravity(self) -> Array:
        """Gravity torque of the bodies ``(N, n)`` [N m]."""
        assert self.bodies is not None
        still = np.zeros_like(self.q)
        return self.bodies.torque(self.q, still, still)

    @cached_property
    def coriolis(self) -> Array:
        """Torque of centrifugal and Coriolis forces ``(N, n)`` [N m]."""
        assert self.bodies is not None
        return self.bodies.torque(self.q, self.qd, np.zeros_like(self.q)) - self.gravity

    @cached_property
    def free_acceleration(self) -> tuple[Array, Array]:
        """Accelerations ``(N, n)`` of the bodies by the motor torques alone, and by gravity and Coriolis alone."""
        assert self.bodies is not None
        assert self.torque is not None
        M = self.bodies.mass(self.q)
        both: Array = np.asarray(np.linalg.solve(M, np.stack([self.torque, self.gravity + self.coriolis], axis=2)),
                                 dtype=float)
        return both[:, :, 0], both[:, :, 1]


def spline_derivatives(rows: Array, dt: float, orders: int, degree: int = _DEGREE) -> list[Array]:
    """First and further derivatives ``(N, n)`` of the spline through rows.

    Args:
        rows, dt: ``(N, n)``, and their distance [s].
        orders, degree: how many derivatives, and of the spline.
    """
    if len(rows) <= _KEPT:
        return [D @ rows for D in _operators(len(rows), dt, orders, degree)]
    return _derived(rows, dt, orders, degree)


def _derived(rows: Array, dt: float, orders: int, degree: int) -> list[Array]:
    t = dt * np.arange(float(len(rows)))
    spline = make_interp_spline(t, rows, k=min(degree, len(rows) - 1))
    return [np.asarray(spline(t, nu=k)) for k in range(1, orders + 1)]


@lru_cache(maxsize=32)
def _operators(count: int, dt: float, orders: int, degree: int) -> tuple[Array, ...]:
    """Matrices ``(N, N)`` that make derivatives of ``count`` rows: horizons have the same length in every cycle."""
    return tuple(_derived(np.eye(count), dt, orders, degree))
