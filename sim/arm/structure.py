"""Tool motion beyond the joints': links and bearings that bend, a column that sways, links that grow with heat.

The joints' motion is PyBullet's. From it follow the forces at each joint, and from those the displacement of the tool,
to first order in angles of some 0.1 mrad:

    φ_i   = -c_i (1 - a_i a_iᵀ) M_i                      bearing and link of joint i tilt across its axis a_i
    φ̈_0 + 2 d ω φ̇_0 + ω² φ_0 = -ω² M_0 / k_0              the column tilts about the base's x and y axes
    δ     = Σ φ_i × (x - p_i) + φ_0 × x + Σ α (T_i - T_ref) (p_{i+1} - p_i)

M_i is the moment about joint i of everything behind it, M_0 that of the whole arm about the foot of the column, p_i
where joint i is, x the tool, T_i the temperature of gear i. The links' motion is not affected: these parts are stiffer
than the gears, and the column heavier than the arm.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.joints import joint_motions, own_joints
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import RowLog
from sim.arm.world import World

TOUCHED = 0.01
"""Time constant with which a force at the tool bends the structure [s]: it has no oscillation of its own here, and on a
stiff surface force and bending would otherwise answer each other from step to step."""


class Structure:
    """Displacement of the tool by the structure's compliance and heat along one run.

    Args:
        robot: the data sheet.
        model: the true links.
        world: the true world.
        step: time between two updates [s].

    Attributes:
        touch: force on the tool in the base frame ``(3,)`` [N].
        off: displacement [m] and rotation vector [rad] of the tool in the base frame now ``(6,)``.
    """

    def __init__(self, robot: Robot, model: pin.Model, world: World, step: float) -> None:
        n = robot.n
        self._model, self._data, self._tool = model, model.createData(), robot.tool_id
        self._frame = model.frames[robot.tool_id]
        stiffness = world.per_joint("stiffness", n) * world.per_joint("stiffness_scale", n)
        self._compliance = world.per_joint("link_bending", n) / stiffness
        self._axes, self._own = _axes(model), own_joints(model)
        self._expansion, self._reference = world.thermal_expansion, world.reference_temperature
        self._column = 0.0 if np.isinf(world.column_stiffness) else 1.0 / world.column_stiffness
        self._step = step
        self._F, self._drive = _oscillation(2.0 * math.pi * world.column_frequency, world.column_damping, step)
        self._share = 1.0 - math.exp(-step / TOUCHED)

    @staticmethod
    def of(robot: Robot, model: pin.Model, world: World, step: float) -> Structure | None:
        """The structure of an arm; None where all of it is rigid.

        Args:
            robot, model, world, step: see the class.
        """
        rigid = not np.any(world.per_joint("link_bending", robot.n)) and np.isinf(world.column_stiffness)
        return None if rigid and world.thermal_expansion == 0.0 else Structure(robot, model, world, step)

    def reset(self, q: Array, temperature: Array) -> None:
        """Puts the structure to rest at arm angles ``q (n,)`` [rad], gears at ``temperature`` [°C]; empties the log."""
        self.touch, self._felt = np.zeros(3), np.zeros(3)
        self._before: Array | None = None
        self._swing = np.zeros((2, 2))
        self.log = RowLog(6)
        still = np.zeros(len(q))
        self._swing[0] = -self._column * self._moments(q, still, still)[1][:2]
        self.off = self._off(q, still, still, temperature, swings=False)

    def update(self, q: Array, qd: Array, temperature: Array) -> None:
        """Advances by a step and logs the tool's displacement.

        Args:
            q: arm angles ``(n,)`` [rad].
            qd: arm velocities ``(n,)`` [rad/s].
            temperature: of the gears ``(n,)`` [°C].
        """
        acceleration = np.zeros(len(q)) if self._before is None else (qd - self._before) / self._step
        self._before = qd.copy()
        self._felt += self._share * (self.touch - self._felt)
        self.off = self._off(q, qd, acceleration, temperature, swings=True)
        self.log.append(tuple(self.off))

    def at(self, t: float) -> Array:
        """Displacement and rotation ``(6,)`` [m, rad] at ``t`` [s], linear between updates, constant afterwards."""
        rows = self.log.rows
        if rows == 0:
            return self.off
        i = min(max(int(t / self._step + 1e-6), 0), rows - 1)
        here = np.array(self.log.row(i))
        after = np.array(self.log.row(i + 1)) if i + 1 < rows else self.off
        return np.asarray(here + min(max(t / self._step - i, 0.0), 1.0) * (after - here))

    def _off(self, q: Array, qd: Array, qdd: Array, temperature: Array, *, swings: bool) -> Array:
        """Displacement and rotation of the tool ``(6,)``; the column goes on by a step if it ``swings``."""
        moments, foot = self._moments(q, qd, qdd)
        if swings:
            self._swing = self._F @ self._swing - np.outer(self._drive, self._column * foot[:2])
        places, rotations = self._places, self._rotations
        tilts = -self._compliance[:, None] * (moments - np.vecdot(moments, self._axes)[:, None] * self._axes)
        tilts = (rotations @ tilts[:, :, None])[:, :, 0]
        column = np.array([*self._swing[0], 0.0])
        # The antisymmetric part of Σ φ_i r_iᵀ is Σ φ_i × r_i.
        G = tilts.T @ (places[-1] - places[:-1]) + np.outer(column, places[-1])
        off = np.empty(6)
        off[:3] = G[1, 2] - G[2, 1], G[2, 0] - G[0, 2], G[0, 1] - G[1, 0]
        off[3:] = tilts.sum(axis=0) + column
        if self._expansion:
            off[:3] += self._expansion * (temperature - self._reference) @ np.diff(places, axis=0)
        return off

    def _moments(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """Moments about the joints, each in its joint's frame ``(n, 3)``, and about the foot of the column ``(3,)``.

        Notes where joints and tool are ``(n + 1, 3)`` [m], and how the joints' frames are turned ``(n, 3, 3)``.
        """
        model, data = self._model, self._data
        pin.rnea(model, data, q, qd, qdd)
        pin.framesForwardKinematics(model, data, q)
        poses = [data.oMi[i] for i in self._own]
        self._rotations = np.array([pose.rotation for pose in poses])
        self._places = np.array([*(pose.translation for pose in poses), data.oMf[self._tool].translation])
        moments = np.array([data.f[i].angular for i in self._own])
        foot = np.array(data.oMi[1].act(data.f[1]).angular)
        if self._felt.any():
            # The joints carry the external force on the tool.
            x, times_felt = self._places[-1], _cross(self._felt)
            moments -= (((x - self._places[:-1]) @ times_felt)[:, None, :] @ self._rotations)[:, 0]
            foot -= x @ times_felt
        return moments, foot


def _cross(v: Array) -> Array:
    """Matrix ``(3, 3)`` that a row is multiplied with for its cross product with ``v (3,)``."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def moved(pose: pin.SE3, off: Array) -> pin.SE3:
    """A pose after a displacement and a rotation vector ``off (6,)`` [m, rad] in the base frame."""
    return pin.SE3(pin.exp3(off[3:]) @ pose.rotation, pose.translation + off[:3])


def _axes(model: pin.Model) -> Array:
    """Axes of the joints in their own frames ``(n, 3)``; zero of those that slide, whose bearings tilt either way."""
    motions = joint_motions(model)
    return np.where(motions.prismatic[:, None], 0.0, motions.axis)[motions.own]


def _oscillation(omega: float, damping: float, step: float) -> tuple[Array, Array]:
    """Exact step of (angle, velocity) ``(2, 2)`` under a load that stays, and what a static angle of 1 adds ``(2,)``.

    Args:
        omega: frequency [rad/s].
        damping: relative to critical, below 1.
        step: [s].
    """
    decay, ringing = damping * omega, omega * math.sqrt(1.0 - damping * damping)
    e, c, s = math.exp(-decay * step), math.cos(ringing * step), math.sin(ringing * step)
    F = e * np.array([[c + decay / ringing * s, s / ringing], [-omega * omega / ringing * s, c - decay / ringing * s]])
    return F, (np.eye(2) - F) @ np.array([1.0, 0.0])
