"""Inverse and forward dynamics of a serial chain, compiled: the recursive Newton–Euler algorithm body by body.

Pinocchio is the reference (a test compares them); this is for the two places where a call per sample costs too much:
the simulation of the identified loop, and the control cycle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.jit import jit


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

    Raises InputError where the model branches, or a joint has more than one degree of freedom.
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


@jit()
def point_mass(chain: Chain, place: Array) -> Chain:
    """The same kinematics with nothing but 1 kg at ``place (3,)`` [m] in the last joint's frame."""
    n = len(chain.mass)
    mass, com = np.zeros(n), np.zeros((n, 3))
    mass[n - 1], com[n - 1] = 1.0, place
    return Chain(chain.rotation, chain.position, chain.axis, chain.prismatic, mass, com, np.zeros((n, 3, 3)),
                 chain.gravity, np.zeros(n))


@jit(inline="always")
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@jit(inline="always")
def _turned_back(R: Array, v: Array, out: Array) -> None:
    for r in range(3):
        out[r] = R[0, r] * v[0] + R[1, r] * v[1] + R[2, r] * v[2]


@jit()
def joint_frames(chain: Chain, q: Array, R: Array, p: Array) -> None:
    """Rotation and position of each joint's frame in the one before it.

    Args:
        chain: the arm's rigid bodies.
        q: joint positions ``(n,)`` [rad].
        R, p: the frames ``(n, 3, 3)`` and ``(n, 3)`` [m], written to.
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


@jit()
def joint_places(chain: Chain, q: Array, joint: int, point: Array) -> Array:
    """Where the joints are in the base frame ``(N, n, 3)``, and behind them a point of the arm: ``(N, n + 1, 3)`` [m].

    Args:
        chain: kinematics.
        q: joint positions ``(N, n)`` [rad].
        joint: that carries the point, counted from 1; 0 for the base.
        point: in that joint's frame ``(3,)`` [m].
    """
    N, n = q.shape
    places = np.empty((N, n + 1, 3))
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    turn, turned = np.empty((3, 3)), np.empty((3, 3))
    for k in range(N):
        joint_frames(chain, q[k], R, p)
        turn[:] = np.eye(3)
        places[k, n] = point
        for i in range(n):
            for r in range(3):
                places[k, i, r] = turn[r, 0] * p[i, 0] + turn[r, 1] * p[i, 1] + turn[r, 2] * p[i, 2]
                if i > 0:
                    places[k, i, r] += places[k, i - 1, r]
                for c in range(3):
                    turned[r, c] = turn[r, 0] * R[i, 0, c] + turn[r, 1] * R[i, 1, c] + turn[r, 2] * R[i, 2, c]
            turn[:] = turned
            if i == joint - 1:
                for r in range(3):
                    places[k, n, r] = (places[k, i, r] + turn[r, 0] * point[0] + turn[r, 1] * point[1]
                                       + turn[r, 2] * point[2])
    return places


@jit(inline="always")
def _wrenches_on_bodies(chain: Chain, R: Array, p: Array, qd: Array, qdd: Array, gravity: float, force: Array,
                        moment: Array) -> None:
    """Writes the force on each body and the moment about its frame's origin, from the base to the last link."""
    # Numbers by themselves rather than vectors: the compiler keeps them in registers.
    w0, w1, w2, d0, d1, d2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a0, a1, a2 = -gravity * chain.gravity[0], -gravity * chain.gravity[1], -gravity * chain.gravity[2]
    for i in range(len(qd)):
        E, r0, r1, r2 = R[i], p[i, 0], p[i, 1], p[i, 2]
        # Acceleration of the frame's origin: a + ẇ × p + w × (w × p).
        y0, y1, y2 = w1 * r2 - w2 * r1, w2 * r0 - w0 * r2, w0 * r1 - w1 * r0
        x0 = d1 * r2 - d2 * r1 + (a0 + (w1 * y2 - w2 * y1))
        x1 = d2 * r0 - d0 * r2 + (a1 + (w2 * y0 - w0 * y2))
        x2 = d0 * r1 - d1 * r0 + (a2 + (w0 * y1 - w1 * y0))
        a0, a1, a2 = (E[0, 0] * x0 + E[1, 0] * x1 + E[2, 0] * x2, E[0, 1] * x0 + E[1, 1] * x1 + E[2, 1] * x2,
                      E[0, 2] * x0 + E[1, 2] * x1 + E[2, 2] * x2)
        w0, w1, w2 = (E[0, 0] * w0 + E[1, 0] * w1 + E[2, 0] * w2, E[0, 1] * w0 + E[1, 1] * w1 + E[2, 1] * w2,
                      E[0, 2] * w0 + E[1, 2] * w1 + E[2, 2] * w2)
        d0, d1, d2 = (E[0, 0] * d0 + E[1, 0] * d1 + E[2, 0] * d2, E[0, 1] * d0 + E[1, 1] * d1 + E[2, 1] * d2,
                      E[0, 2] * d0 + E[1, 2] * d1 + E[2, 2] * d2)
        z0, z1, z2 = chain.axis[i, 0], chain.axis[i, 1], chain.axis[i, 2]
        x0, x1, x2 = w1 * z2 - w2 * z1, w2 * z0 - w0 * z2, w0 * z1 - w1 * z0
        if chain.prismatic[i] > 0.5:
            a0 += 2.0 * x0 * qd[i] + z0 * qdd[i]
            a1 += 2.0 * x1 * qd[i] + z1 * qdd[i]
            a2 += 2.0 * x2 * qd[i] + z2 * qdd[i]
        else:
            d0 += x0 * qd[i] + z0 * qdd[i]
            d1 += x1 * qd[i] + z1 * qdd[i]
            d2 += x2 * qd[i] + z2 * qdd[i]
            w0 += z0 * qd[i]
            w1 += z1 * qd[i]
            w2 += z2 * qd[i]
        # Force on the body and moment about the frame's origin.
        c0, c1, c2 = chain.com[i, 0], chain.com[i, 1], chain.com[i, 2]
        y0, y1, y2 = w1 * c2 - w2 * c1, w2 * c0 - w0 * c2, w0 * c1 - w1 * c0
        f0 = chain.mass[i] * (a0 + (d1 * c2 - d2 * c1) + (w1 * y2 - w2 * y1))
        f1 = chain.mass[i] * (a1 + (d2 * c0 - d0 * c2) + (w2 * y0 - w0 * y2))
        f2 = chain.mass[i] * (a2 + (d0 * c1 - d1 * c0) + (w0 * y1 - w1 * y0))
        force[i, 0], force[i, 1], force[i, 2] = f0, f1, f2
        J = chain.inertia[i]
        x0, x1, x2 = (J[0, 0] * w0 + J[0, 1] * w1 + J[0, 2] * w2, J[1, 0] * w0 + J[1, 1] * w1 + J[1, 2] * w2,
                      J[2, 0] * w0 + J[2, 1] * w1 + J[2, 2] * w2)
        moment[i, 0] = (J[0, 0] * d0 + J[0, 1] * d1 + J[0, 2] * d2) + (w1 * x2 - w2 * x1) + (c1 * f2 - c2 * f1)
        moment[i, 1] = (J[1, 0] * d0 + J[1, 1] * d1 + J[1, 2] * d2) + (w2 * x0 - w0 * x2) + (c2 * f0 - c0 * f2)
        moment[i, 2] = (J[2, 0] * d0 + J[2, 1] * d1 + J[2, 2] * d2) + (w0 * x1 - w1 * x0) + (c0 * f1 - c1 * f0)


@jit(inline="always")
def _torques_of_wrenches(chain: Chain, R: Array, p: Array, qdd: Array, force: Array, moment: Array, tau: Array
                         ) -> None:
    """Writes the joint torques, from the last link to the base; each joint carries the bodies behind it."""
    for i in range(len(qdd) - 1, -1, -1):
        load = force[i] if chain.prismatic[i] > 0.5 else moment[i]
        tau[i] = (chain.axis[i, 0] * load[0] + chain.axis[i, 1] * load[1] + chain.axis[i, 2] * load[2]
                  + chain.armature[i] * qdd[i])
        if i > 0:
            E, f0, f1, f2, x0, x1, x2 = (R[i], force[i, 0], force[i, 1], force[i, 2], moment[i, 0], moment[i, 1],
                                         moment[i, 2])
            y0, y1, y2 = (E[0, 0] * f0 + E[0, 1] * f1 + E[0, 2] * f2, E[1, 0] * f0 + E[1, 1] * f1 + E[1, 2] * f2,
                          E[2, 0] * f0 + E[2, 1] * f1 + E[2, 2] * f2)
            r0, r1, r2 = p[i, 0], p[i, 1], p[i, 2]
            force[i - 1, 0] += y0
            force[i - 1, 1] += y1
            force[i - 1, 2] += y2
            moment[i - 1, 0] += (E[0, 0] * x0 + E[0, 1] * x1 + E[0, 2] * x2) + (r1 * y2 - r2 * y1)
            moment[i - 1, 1] += (E[1, 0] * x0 + E[1, 1] * x1 + E[1, 2] * x2) + (r2 * y0 - r0 * y2)
            moment[i - 1, 2] += (E[2, 0] * x0 + E[2, 1] * x1 + E[2, 2] * x2) + (r0 * y1 - r1 * y0)


@jit()
def torque_at(chain: Chain, R: Array, p: Array, qd: Array, qdd: Array, gravity: float, tau: Array) -> None:
    """Joint torques at the posture whose frames are ``R``, ``p`` ([G] (5)), written to ``tau``.

    Args:
        chain: the arm's rigid bodies.
        R, p: from ``joint_frames``.
        qd, qdd: joint velocities and accelerations ``(n,)`` [rad/s, rad/s²].
        gravity: factor on the chain's gravity: 1 for all of (5), 0 for the columns of the mass matrix.
        tau: result ``(n,)`` [N m], written to.
    """
    force, moment = np.empty((len(qd), 3)), np.empty((len(qd), 3))
    _wrenches_on_bodies(chain, R, p, qd, qdd, gravity, force, moment)
    _torques_of_wrenches(chain, R, p, qdd, force, moment, tau)


@jit()
def inverse_dynamics(chain: Chain, q: Array, qd: Array, qdd: Array) -> Array:
    """[G] (5): joint torques ``(N, n)`` [N m].

    Args:
        chain: the arm's rigid bodies.
        q, qd, qdd: joint positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²].
    """
    N, n = q.shape
    tau = np.empty((N, n))
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    for k in range(N):
        joint_frames(chain, q[k], R, p)
        torque_at(chain, R, p, qd[k], qdd[k], 1.0, tau[k])
    return tau


@jit()
def inverse_dynamics_with_point(chain: Chain, place: Array, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
    """``inverse_dynamics``, and the torques of 1 kg at a point of the last link, each ``(N, n)``.

    Args:
        chain, q, qd, qdd: as there.
        place: of the mass in the last joint's frame ``(3,)`` [m].
    """
    N, n = q.shape
    tau, weight, kilogram = np.empty((N, n)), np.empty((N, n)), point_mass(chain, place)
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    for k in range(N):
        joint_frames(chain, q[k], R, p)
        torque_at(chain, R, p, qd[k], qdd[k], 1.0, tau[k])
        torque_at(kilogram, R, p, qd[k], qdd[k], 1.0, weight[k])
    return tau, weight


def gravity_across(chain: Chain, q: Array) -> Array:
    """Torques ``(N, n, 2)`` [N m] of 1 m/s² of gravity along the base's x and y axes at positions ``(N, n)`` [rad]."""
    still = np.zeros_like(q)
    sides = [chain._replace(gravity=np.eye(3)[axis]) for axis in range(2)]
    return np.stack([inverse_dynamics(side, q, still, still) for side in sides], axis=2)


@jit()
def mass_matrix(chain: Chain, R: Array, p: Array, M: Array) -> None:
    """Mass matrix at the posture whose frames are ``R``, ``p``, column by column.

    Args:
        chain: the arm's rigid bodies.
        R, p: from ``joint_frames``.
        M: result ``(n, n)`` [kg m²], written to.
    """
    n = len(chain.mass)
    rest, unit = np.zeros(n), np.zeros(n)
    for j in range(n):
        unit[j] = 1.0
        torque_at(chain, R, p, rest, unit, 0.0, M[j])
        unit[j] = 0.0
