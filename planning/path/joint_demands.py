"""What travelling along a path demands of the joints: speed, acceleration and torque, by arc length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array, interpolated
from ideal_robot.robots.robot import Robot
from planning.path.joint_path import JointPath

FRICTION = 0.1
"""Share of a joint's torque limit that its friction takes and no rigid body shows. An estimate, for friction is not
known here: the identified models of KR 6, KR 15 and manutec r15 have 7 to 11 % at half speed, 9 to 14 % at full."""
GATHERED = 0.8
"""Share of an acceleration or torque limit that a steady speed may use; the rest is for changes of the speed."""


@dataclass(frozen=True)
class Demand:
    r"""One quantity of every joint along a path, :math:`|\alpha \ddot s + \beta \dot s^2| \le` its limit.

    Attributes:
        alpha, beta: by the path's acceleration and by its squared speed ``(K, n)``.
        limit: limit of each joint that the travel may use ``(K, n)``, infinite where unknown.
        unit: in messages.
    """

    alpha: Array
    beta: Array
    limit: Array
    unit: str

    def steady(self) -> Array:
        """Highest steady speed that each joint allows at each place ``(K, n)`` [m/s]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.sqrt(GATHERED * self.limit / np.abs(self.beta))

    def room(self, row: int, square: float) -> float:
        """Path acceleration that all joints allow at a place [m/s²], at a squared speed [m²/s²]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            rooms = (self.limit[row] - np.abs(self.beta[row]) * square) / np.abs(self.alpha[row])
        return float(np.nanmin(rooms, initial=np.inf))

    def used(self, s: Array, path_s: Array, speed: Array, acceleration: Array) -> Array:
        """Share of the limit that a travel uses ``(N,)``, of the joint that uses most.

        Args:
            s, speed, acceleration: of the travel ``(N,)`` [m, m/s, m/s²].
            path_s: arc lengths of the rows ``(K,)`` [m].
        """
        alpha, beta, limit = (interpolated(s, path_s, values) for values in (self.alpha, self.beta, self.limit))
        size = np.abs(alpha * acceleration[:, None] + beta * speed[:, None] ** 2)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.nanmax(size / limit, axis=1, initial=0.0))


@dataclass(frozen=True)
class JointDemands:
    """All limits of the joints on a travel along a path.

    Attributes:
        path: in joint space.
        v_max: speed that a joint may use ``(n,)`` [rad/s or m/s].
        demands: of acceleration and of torque.
    """

    path: JointPath
    v_max: Array
    demands: tuple[Demand, ...]

    @classmethod
    def of(cls, robot: Robot, path: JointPath, share: float) -> JointDemands:
        """The demands of a path on an arm.

        Torques are those of the URDF's rigid body and of the rotors. The travel may use the share of what the limit
        leaves after gravity and friction. A torque limit too small to hold the arm is ignored.

        Args:
            robot, path: the arm, and the path in joint space.
            share: of each limit that the travel may use.
        """
        acceleration = Demand(path.dq, path.ddq, np.broadcast_to(share * robot.a_max, path.q.shape), "rad/s²")
        gravity, alpha, beta = _torques(robot, path)
        free = (1.0 - FRICTION) * robot.tau_max - np.abs(gravity)
        free = np.where(free.min(axis=0) > 0.0, free, np.inf)
        return cls(path, share * robot.v_max, (acceleration, Demand(alpha, beta, share * free, "N m beside gravity")))

    def steady(self) -> Array:
        """Highest steady speed that each joint allows at each place ``(K, n)`` [m/s]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            speeds = [self.v_max / np.abs(self.path.dq), *(demand.steady() for demand in self.demands)]
        return np.asarray(np.min([np.nan_to_num(speed, nan=np.inf, posinf=np.inf) for speed in speeds], axis=0))

    def room(self, row: int, square: float) -> float:
        """Path acceleration that all joints allow at a place [m/s²], at a squared speed [m²/s²]."""
        return min(demand.room(row, square) for demand in self.demands)

    def excess(self, s: Array, speed: Array, acceleration: Array) -> Array:
        """Speed of a travel over what the joints allow at each instant ``(N,)``; at most 1 where it is allowed.

        Args:
            s, speed, acceleration: of the travel ``(N,)`` [m, m/s, m/s²].
        """
        turned = np.abs(interpolated(s, self.path.s, self.path.dq) * speed[:, None]) / self.v_max
        # Acceleration and torque rise with the square of the speed.
        return np.asarray(np.max([turned.max(axis=1), *(
            np.sqrt(demand.used(s, self.path.s, speed, acceleration)) for demand in self.demands)], axis=0))

    def needed(self, row: int, joint: int, speed: float) -> tuple[str, str]:
        """The speed or torque that a joint would need for a steady speed, and what it may use, in words.

        Args:
            row, joint: place and joint, counted from 0.
            speed: along the path [m/s].
        """
        turned = abs(self.path.dq[row, joint]) * speed
        if turned > self.v_max[joint]:
            return f"{turned:.2f} rad/s", f"{self.v_max[joint]:.2f} rad/s"
        worst = max(self.demands, key=lambda demand: abs(demand.beta[row, joint]) / demand.limit[row, joint])
        return (f"{abs(worst.beta[row, joint]) * speed**2:.3g} {worst.unit}",
                f"{worst.limit[row, joint]:.3g} {worst.unit}")


def _torques(robot: Robot, path: JointPath) -> tuple[Array, Array, Array]:
    """Torque of gravity, by path acceleration and by squared path speed, ``(K, n)`` each [N m, N s², N s²/m]."""
    model, data = robot.pinocchio, robot.pinocchio.createData()
    gravity, alpha, beta = (np.empty_like(path.q) for _ in range(3))
    rest = np.zeros(robot.n)
    for row, (q, dq, ddq) in enumerate(zip(path.q, path.dq, path.ddq, strict=True)):
        gravity[row] = pin.computeGeneralizedGravity(model, data, q)
        alpha[row] = pin.rnea(model, data, q, rest, dq)
        beta[row] = pin.rnea(model, data, q, dq, ddq)
    return (gravity, alpha - gravity + robot.rotor_inertia * path.dq, beta - gravity + robot.rotor_inertia * path.ddq)
