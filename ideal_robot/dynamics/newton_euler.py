"""Inverse and forward dynamics of a serial chain, compiled: the recursive Newton–Euler algorithm body by body.

Pinocchio is the reference (a test compares them); this is for the two places where a call per sample costs too much:
the simulation of the identified loop, and the control cycle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.jit import jit
from ideal_robot.robots.joints import joint_motions


class Chain(NamedTuple):
    """Kinematics and inertias of a serial arm as plain arrays: ``b`` joints in their order, ``n`` of them free.

    The others are coupled to one of those (``ideal_robot.robots.joints``); where none does, b is n.

    Attributes:
        rotation, position: placement of each joint in the frame of the joint before it, ``(b, 3, 3)`` and ``(b, 3)``.
        axis: joint axis in the joint's frame ``(b, 3)``.
        prismatic: 1 where the joint slides along its axis, 0 where it turns about it ``(b,)``.
        coordinate: index, from 0, of the coordinate that moves each joint ``(b,)``.
        ratio, offset: each joint's angle is ratio times its coordinate plus offset ``(b,)`` [-, rad or m].
        own: index, from 0, of the joint whose angle is each coordinate ``(n,)``.
        mass, com, inertia: of the body behind each joint: [kg] ``(b,)``, centre of mass in the joint's frame ``(b, 3)``
            [m], inertia about it ``(b, 3, 3)`` [kg m²].
        gravity: in the base frame ``(3,)`` [m/s²].
        armature: inertia that resists a coordinate's own acceleration alone ``(n,)`` [kg m², kg]; negative where a part
            of the bodies' inertia is assigned to the rotor.
    """

    rotation: Array
    position: Array
    axis: Array
    prismatic: Array
    coordinate: NDArray[np.int64]
    ratio: Array
    offset: Array
    own: NDArray[np.int64]
    mass: Array
    com: Array
    inertia: Array
    gravity: Array
    armature: Array


def chain_of(model: pin.Model) -> Chain:
    """The chain of a Pinocchio model, without armature: rotors are not part of the links.

    Raises InputError where the model branches, or a joint has more than one degree of freedom.
    """
    joints, parents = list(model.joints)[1:], list(model.parents)[1:]
    if any(joint.nv > 1 for joint in joints) or parents != list(range(len(joints))):
        raise InputError("expected a serial chain of one-degree-of-freedom joints", field="urdf", value=model.name)
    placements, bodies = list(model.jointPlacements)[1:], list(model.inertias)[1:]
    motions = joint_motions(model)
    return Chain(
        rotation=np.array([place.rotation for place in placements]),
        position=np.array([place.translation for place in placements]),
        axis=motions.axis, prismatic=motions.prismatic.astype(float), coordinate=motions.coordinate.astype(np.uintp),
        ratio=motions.ratio, offset=motions.offset, own=np.flatnonzero(motions.own),
        mass=np.array([body.mass for body in bodies]),
        com=np.array([body.lever for body in bodies]), inertia=np.array([body.inertia for body in bodies]),
        gravity=np.array(model.gravity.linear), armature=np.zeros(model.nv))


@jit()
def point_mass(chain: Chain, place: Array) -> Chain:
    """The same kinematics with a single mass of 1 kg at ``place (3,)`` [m] in the last joint's frame."""
    b = len(chain.mass)
    mass, com = np.zeros(b), np.zeros((b, 3))
    mass[b - 1], com[b - 1] = 1.0, place
    return Chain(chain.rotation, chain.position, chain.axis, chain.prismatic, chain.coordinate, chain.ratio,
                 chain.offset, chain.own, mass, com, np.zeros((b, 3, 3)), chain.gravity, np.zeros(len(chain.armature)))


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
def frames_of(chain: Chain) -> tuple[Array, Array]:
    """Arrays for the results of ``joint_frames``: ``(b, 3, 3)`` and ``(b, 3)``."""
    return np.empty((len(chain.mass), 3, 3)), np.empty((len(chain.mass), 3))


@jit()
def joint_frames(chain: Chain, q: Array, R: Array, p: Array) -> None:
    """Writes rotation and position of each joint's frame in the one before it to ``R`` and ``p``.

    Args:
        chain: the arm's rigid bodies.
        q: joint positions ``(n,)`` [rad].
        R, p: the frames ``(b, 3, 3)`` and ``(b, 3)`` [m], written to.
    """
    turn = np.empty((3, 3))
    for i in range(len(chain.mass)):
        angle = chain.ratio[i] * q[chain.coordinate[i]] + chain.offset[i]
        x, y, z = chain.axis[i, 0], chain.axis[i, 1], chain.axis[i, 2]
        for r in range(3):
            p[i, r] = chain.position[i, r]
        if chain.prismatic[i] > 0.5:
            for r in range(3):
                for c in range(3):
                    R[i, r, c] = chain.rotation[i, r, c]
                p[i, r] += angle * (chain.rotation[i, r, 0] * x + chain.rotation[i, r, 1] * y
                                   + chain.rotation[i, r, 2] * z)
            continue
        # Rodrigues' formula.
        s, c0 = np.sin(angle), np.cos(angle)
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
    """Places of the joints in the base frame ``(N, b, 3)``, and after them a point of the arm: ``(N, b + 1, 3)`` [m].

    Args:
        chain: kinematics.
        q: joint positions ``(N, n)`` [rad].
        joint: number of the joint that moves the point, from 1; 0 for the base.
        point: in that joint's frame ``(3,)`` [m].
    """
    N, b = len(q), len(chain.mass)
    places = np.empty((N, b + 1, 3))
    R, p = frames_of(chain)
    turn, turned = np.empty((3, 3)), np.empty((3, 3))
    for k in range(N):
        joint_frames(chain, q[k], R, p)
        turn[:] = np.eye(3)
        places[k, b] = point
        for i in range(b):
            for r in range(3):
                places[k, i, r] = turn[r, 0] * p[i, 0] + turn[r, 1] * p[i, 1] + turn[r, 2] * p[i, 2]
                if i > 0:
                    places[k, i, r] += places[k, i - 1, r]
                for c in range(3):
                    turned[r, c] = turn[r, 0] * R[i, 0, c] + turn[r, 1] * R[i, 1, c] + turn[r, 2] * R[i, 2, c]
            turn[:] = turned
            if i == joint - 1:
                for r in range(3):
                    places[k, b, r] = (places[k, i, r] + turn[r, 0] * point[0] + turn[r, 1] * point[1]
                                       + turn[r, 2] * point[2])
    return places


@jit(inline="always")
def _wrenches_on_bodies(chain: Chain, R: Array, p: Array, qd: Array, qdd: Array, gravity: float, force: Array,
                        moment: Array) -> None:
    """Writes the force on each body and the moment about its frame's origin, from the base to the last link."""
    # Scalars instead of vectors, so that the compiler keeps them in registers.
    w0, w1, w2, d0, d1, d2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a0, a1, a2 = -gravity * chain.gravity[0], -gravity * chain.gravity[1], -gravity * chain.gravity[2]
    for i in range(len(force)):
        speed, acceleration = chain.ratio[i] * qd[chain.coordinate[i]], chain.ratio[i] * qdd[chain.coordinate[i]]
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
            a0 += 2.0 * x0 * speed + z0 * acceleration
            a1 += 2.0 * x1 * speed + z1 * acceleration
            a2 += 2.0 * x2 * speed + z2 * acceleration
        else:
            d0 += x0 * speed + z0 * acceleration
            d1 += x1 * speed + z1 * acceleration
            d2 += x2 * speed + z2 * acceleration
            w0 += z0 * speed
            w1 += z1 * speed
            w2 += z2 * speed
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
    for j in range(len(qdd)):
        tau[j] = chain.armature[j] * qdd[j]
    for i in range(len(force) - 1, -1, -1):
        load = force[i] if chain.prismatic[i] > 0.5 else moment[i]
        tau[chain.coordinate[i]] += chain.ratio[i] * (chain.axis[i, 0] * load[0] + chain.axis[i, 1] * load[1]
                                                      + chain.axis[i, 2] * load[2])
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
    """Writes the joint torques at the posture with the frames ``R``, ``p`` to ``tau`` ([G] (5)).

    Args:
        chain: the arm's rigid bodies.
        R, p: from ``joint_frames``.
        qd, qdd: joint velocities and accelerations ``(n,)`` [rad/s, rad/s²].
        gravity: factor on the chain's gravity: 1 for all of (5), 0 for the columns of the mass matrix.
        tau: result ``(n,)`` [N m], written to.
    """
    b = len(chain.mass)
    force, moment = np.empty((b, 3)), np.empty((b, 3))
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
    R, p = frames_of(chain)
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
    R, p = frames_of(chain)
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
    """Writes the mass matrix at the posture with the frames ``R``, ``p`` to ``M``, column by column.

    Args:
        chain: the arm's rigid bodies.
        R, p: from ``joint_frames``.
        M: result ``(n, n)`` [kg m²], written to.
    """
    n = len(chain.armature)
    rest, unit = np.zeros(n), np.zeros(n)
    for j in range(n):
        unit[j] = 1.0
        torque_at(chain, R, p, rest, unit, 0.0, M[j])
        unit[j] = 0.0
