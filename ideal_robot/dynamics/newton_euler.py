"""Inverse and forward dynamics of a serial chain, compiled: the recursive Newton–Euler algorithm body by body.

Pinocchio is the reference (a test compares them); this is for the two places where a call per sample costs too much:
the simulation of the identified loop, and the control cycle.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError


class Chain(NamedTuple):
    """Kinematics and inertias of a serial arm as plain arrays, in the order of the joints.

    Attributes:
        rotation, position: placement of each joint in the frame of the joint before it, ``(n, 3, 3)`` and ``(n, 3)``.
        axis: joint axis in the joint's frame ``(n, 3)``.
        prismatic: 1 where the joint slides along its axis, 0 where it turns about it ``(n,)``.
        mass, com, inertia: of the body behind each joint: [kg] ``(n,)``, centre of mass in the joint's frame ``(n, 3)``
            [m], inertia about it ``(n, 3, 3)`` [kg m²].
        gravity: in the base frame ``(3,)`` [m/s²].
        armature: inertia that resists the joint's own acceleration alone ``(n,)`` [kg m², kg]; negative where a share
            of the bodies' is counted to the rotor.
    """

    rotation: Array
    position: Array
    axis: Array
    prismatic: Array
    mass: Array
    com: Array
    inertia: Array
    gravity: Array
    armature: Array


def chain_of(model: pin.Model) -> Chain:
    """The chain of a Pinocchio model, without armature: rotors are not part of the links.

    Raises:
        InputError: the model branches, or a joint has more than one degree of freedom.
    """
    n = model.nv
    rotation, position = np.zeros((n, 3, 3)), np.zeros((n, 3))
    axis, prismatic = np.zeros((n, 3)), np.zeros(n)
    mass, com, inertia = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    for i in range(n):
        joint = model.joints[i + 1]
        if joint.nv != 1 or model.parents[i + 1] != i:
            raise InputError("expected a serial chain of one-degree-of-freedom joints", field="urdf", value=model.name)
        placement, body = model.jointPlacements[i + 1], model.inertias[i + 1]
        data = joint.createData()
        joint.calc(data, pin.neutral(model)[joint.idx_q : joint.idx_q + joint.nq])
        motion = np.asarray(data.S).reshape(6)
        prismatic[i] = float(np.linalg.norm(motion[:3]) > 0.5)
        axis[i] = motion[:3] if prismatic[i] else motion[3:]
        rotation[i], position[i] = placement.rotation, placement.translation
        mass[i], com[i], inertia[i] = body.mass, body.lever, body.inertia
    return Chain(rotation, position, axis, prismatic, mass, com, inertia, np.array(model.gravity.linear), np.zeros(n))


@numba.njit(cache=True, inline="always")
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, inline="always")
def _turned(R: Array, v: Array, out: Array) -> None:
    for r in range(3):
        out[r] = R[r, 0] * v[0] + R[r, 1] * v[1] + R[r, 2] * v[2]


@numba.njit(cache=True, inline="always")
def _turned_back(R: Array, v: Array, out: Array) -> None:
    for r in range(3):
        out[r] = R[0, r] * v[0] + R[1, r] * v[1] + R[2, r] * v[2]


@numba.njit(cache=True)
def joint_frames(chain: Chain, q: Array, R: Array, p: Array) -> None:
    """Rotation and position of each joint's frame in the one before it, at ``q (n,)``; written to ``R``, ``p``.

    Args:
        chain: the arm's rigid bodies.
        q: joint positions ``(n,)`` [rad].
        R: rotation of each joint's frame in the one before it ``(n, 3, 3)``, written to.
        p: position of each joint's frame in the one before it ``(n, 3)`` [m], written to.
    """
    turn = np.empty((3, 3))
    for i in range(len(q)):
        x, y, z = chain.axis[i, 0], chain.axis[i, 1], chain.axis[i, 2]
        for r in range(3):
            p[i, r] = chain.position[i, r]
        if chain.prismatic[i] > 0.5:
            for r in range(3):
                for c in range(3):
                    R[i, r, c] = chain.rotation[i, r, c]
                p[i, r] += q[i] * (chain.rotation[i, r, 0] * x + chain.rotation[i, r, 1] * y
                                   + chain.rotation[i, r, 2] * z)
            continue
        # Rodrigues' formula.
        s, c0 = np.sin(q[i]), np.cos(q[i])
        v = 1.0 - c0
        turn[0, 0], turn[0, 1], turn[0, 2] = c0 + x * x * v, x * y * v - z * s, x * z * v + y * s
        turn[1, 0], turn[1, 1], turn[1, 2] = y * x * v + z * s, c0 + y * y * v, y * z * v - x * s
        turn[2, 0], turn[2, 1], turn[2, 2] = z * x * v - y * s, z * y * v + x * s, c0 + z * z * v
        for r in range(3):
            for c in range(3):
                R[i, r, c] = (chain.rotation[i, r, 0] * turn[0, c] + chain.rotation[i, r, 1] * turn[1, c]
                              + chain.rotation[i, r, 2] * turn[2, c])


@numba.njit(cache=True)
def torque_at(chain: Chain, R: Array, p: Array, qd: Array, qdd: Array, gravity: float, tau: Array) -> None:
    """Joint torques at the posture whose frames are ``R``, ``p`` ([G] (5)), written to ``tau (n,)`` [N m].

    ``gravity`` scales the chain's gravity: 1 for all of (5), 0 for the columns of the mass matrix.

    Args:
        chain: the arm's rigid bodies.
        R: rotation of each joint's frame in the one before it ``(n, 3, 3)``.
        p: position of each joint's frame in the one before it ``(n, 3)`` [m].
        qd: joint velocities ``(n,)`` [rad/s].
        qdd: joint accelerations ``(n,)`` [rad/s²].
        gravity: factor on the chain's gravity.
        tau: result ``(n,)`` [N m], written to.
    """
    n = len(qd)
    force, moment = np.zeros((n, 3)), np.zeros((n, 3))
    w, wd, a = np.zeros(3), np.zeros(3), np.empty(3)
    for r in range(3):
        a[r] = -gravity * chain.gravity[r]
    w_new, wd_new, a_new = np.empty(3), np.empty(3), np.empty(3)
    x, y, z = np.empty(3), np.empty(3), np.empty(3)
    for i in range(n):
        axis = chain.axis[i]
        _turned_back(R[i], w, w_new)
        _turned_back(R[i], wd, wd_new)
        _cross(wd, p[i], x)
        _cross(w, p[i], y)
        _cross(w, y, z)
        for r in range(3):
            x[r] += a[r] + z[r]
        _turned_back(R[i], x, a_new)
        _cross(w_new, axis, x)
        if chain.prismatic[i] > 0.5:
            for r in range(3):
                a_new[r] += 2.0 * x[r] * qd[i] + axis[r] * qdd[i]
        else:
            for r in range(3):
                wd_new[r] += x[r] * qd[i] + axis[r] * qdd[i]
                w_new[r] += axis[r] * qd[i]
        for r in range(3):
            w[r], wd[r], a[r] = w_new[r], wd_new[r], a_new[r]
        com = chain.com[i]
        _cross(wd, com, x)
        _cross(w, com, y)
        _cross(w, y, z)
        for r in range(3):
            force[i, r] = chain.mass[i] * (a[r] + x[r] + z[r])
        _turned(chain.inertia[i], w, x)
        _cross(w, x, y)
        _turned(chain.inertia[i], wd, x)
        _cross(com, force[i], z)
        for r in range(3):
            moment[i, r] = x[r] + y[r] + z[r]
    for i in range(n - 1, -1, -1):
        load = force[i] if chain.prismatic[i] > 0.5 else moment[i]
        tau[i] = (chain.axis[i, 0] * load[0] + chain.axis[i, 1] * load[1] + chain.axis[i, 2] * load[2]
                  + chain.armature[i] * qdd[i])
        if i > 0:
            _turned(R[i], force[i], x)
            _turned(R[i], moment[i], y)
            _cross(p[i], x, z)
            for r in range(3):
                force[i - 1, r] += x[r]
                moment[i - 1, r] += y[r] + z[r]


@numba.njit(cache=True)
def inverse_dynamics(chain: Chain, q: Array, qd: Array, qdd: Array) -> Array:
    """[G] (5): joint torques ``(N, n)`` [N m] of positions, velocities and accelerations ``(N, n)``.

    Args:
        chain: the arm's rigid bodies.
        q: joint positions ``(N, n)`` [rad].
        qd: joint velocities ``(N, n)`` [rad/s].
        qdd: joint accelerations ``(N, n)`` [rad/s²].
    """
    N, n = q.shape
    tau = np.empty((N, n))
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    for k in range(N):
        joint_frames(chain, q[k], R, p)
        torque_at(chain, R, p, qd[k], qdd[k], 1.0, tau[k])
    return tau


def gravity_across(chain: Chain, q: Array) -> Array:
    """Torques ``(N, n, 2)`` [N m] of 1 m/s² of gravity along the base's x and y axes at positions ``(N, n)`` [rad]."""
    still = np.zeros_like(q)
    sides = [chain._replace(gravity=np.eye(3)[axis]) for axis in range(2)]
    return np.stack([inverse_dynamics(side, q, still, still) for side in sides], axis=2)


@numba.njit(cache=True)
def mass_matrix(chain: Chain, R: Array, p: Array, M: Array) -> None:
    """Mass matrix at the posture whose frames are ``R``, ``p``, written to ``M (n, n)`` [kg m²], column by column.

    Args:
        chain: the arm's rigid bodies.
        R: rotation of each joint's frame in the one before it ``(n, 3, 3)``.
        p: position of each joint's frame in the one before it ``(n, 3)`` [m].
        M: result ``(n, n)`` [kg m²], written to.
    """
    n = len(chain.mass)
    rest, unit = np.zeros(n), np.zeros(n)
    for j in range(n):
        unit[j] = 1.0
        torque_at(chain, R, p, rest, unit, 0.0, M[j])
        unit[j] = 0.0
