"""Coupled joints of a serial arm: which joints move on their own, and which follow another one.

A palletizer's rods keep its wrist level, a belt moves the second stage of a telescope with the first: a URDF writes
``<mimic joint="j2" multiplier="-1" offset="0.3"/>``. Such a joint carries a body and has no coordinate: the angles of
all joints are q' = G q + b with one element in each row of G, torques of the coordinates Gᵀ τ'. Pinocchio's joints
(``JointModelMimic``) are the reference of what is compiled (``ideal_robot.dynamics.newton_euler.Chain``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array


class JointMotions(NamedTuple):
    """Motion of each of ``b`` joints by the ``n`` coordinates, in the order of the chain.

    Attributes:
        coordinate: number of the coordinate that moves each joint, from 0 ``(b,)``.
        ratio, offset: its angle is ratio times the coordinate plus offset ``(b,)`` [-, rad or m]; 1 and 0 of joints
            that move on their own.
        axis: in its own frame ``(b, 3)``.
        prismatic: whether it slides ``(b,)``.
        own: whether it moves on its own ``(b,)``.
    """

    coordinate: NDArray[np.int64]
    ratio: Array
    offset: Array
    axis: Array
    prismatic: NDArray[np.bool_]
    own: NDArray[np.bool_]

    def angles(self, q: Array) -> Array:
        """Angles of all joints ``(…, b)`` from coordinates ``(…, n)`` [rad or m]."""
        return np.asarray(q[..., self.coordinate] * self.ratio + self.offset)

    def rates(self, qd: Array) -> Array:
        """Velocities of all joints ``(…, b)`` from those of the coordinates ``(…, n)``; also for accelerations."""
        return np.asarray(qd[..., self.coordinate] * self.ratio)

    def torques(self, tau: Array) -> Array:
        """Torques of the coordinates ``(n,)`` equivalent to torques of all joints ``(b,)`` [N m or N]."""
        return np.bincount(self.coordinate, self.ratio * tau, int(self.own.sum())).astype(float)


def joint_motions(model: pin.Model) -> JointMotions:
    """The couplings of a Pinocchio model whose joints have one degree of freedom each."""
    b = model.njoints - 1
    coordinate, own = np.zeros(b, dtype=np.int64), np.ones(b, dtype=bool)
    ratio, offset, axis, prismatic = np.ones(b), np.zeros(b), np.zeros((b, 3)), np.zeros(b, dtype=bool)
    zero = pin.neutral(model)
    for i, joint in enumerate(list(model.joints)[1:]):
        coordinate[i], own[i] = joint.idx_v, joint.nv > 0
        data = joint.createData()
        joint.calc(data, zero)
        motion = np.asarray(data.S).reshape(6)
        if not own[i]:
            follower = joint.extract()
            ratio[i], offset[i] = follower.scaling, follower.offset
            motion = motion / ratio[i]
        prismatic[i] = np.linalg.norm(motion[:3]) > 0.5
        axis[i] = motion[:3] if prismatic[i] else motion[3:]
    return JointMotions(coordinate, ratio, offset, axis, prismatic, own)


def own_joints(model: pin.Model) -> list[int]:
    """Pinocchio's indices of the joints that move on their own, in the order of the coordinates ``(n,)``."""
    return [i for i in range(1, model.njoints) if model.joints[i].nv > 0]


def without_followers(model: pin.Model) -> pin.Model:
    """The same bodies with every joint independent: the model of q' ``(b,)``."""
    free, motions = pin.Model(), joint_motions(model)
    for i, (axis, slides) in enumerate(zip(motions.axis, motions.prismatic, strict=True), start=1):
        kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
        joint = free.addJoint(model.parents[i], kind(axis), model.jointPlacements[i], model.names[i])
        free.appendBodyToJoint(joint, model.inertias[i], pin.SE3.Identity())
    for frame in list(model.frames)[1:]:
        free.addFrame(pin.Frame(frame.name, frame.parentJoint, frame.parentFrame, frame.placement, frame.type), False)
    free.gravity = model.gravity
    return free


def mass_matrix(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Mass matrix of the coordinates ``(n, n)`` [kg m²], armature on its diagonal.

    Pinocchio's ``crba``; with coupled joints it adds to data of the last call (version 4.1), so new data are created.

    Args:
        model, data: of the arm, and its data, which are written to where no joint follows another one.
        q: coordinates ``(n,)`` [rad or m].
    """
    follows = model.nv < model.njoints - 1
    return np.asarray(pin.crba(model, model.createData() if follows else data, q))
