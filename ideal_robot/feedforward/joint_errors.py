"""Joint errors from errors of the end effector, measured in all or only some degrees of freedom.

[G] 4.2.1 transforms deviations of the end-effector by the Jacobian. [L] 3.3 describes a device that measures 2 of 6 and
estimates all joints from them. Both are one least-squares problem per sample with a prior: joints err by about
``prior`` each, the device by ``noise``,

    δq = W Jᵀ (J W Jᵀ + R)⁻¹ δx ,   W = diag(prior²) + c cᵀ , R = noise² I

where c is an error common to all joints: a lag, with an error of each joint in proportion to its speed. With complete
accurate measurements this is the Jacobian's inverse, otherwise the likeliest joint errors.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot

AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Degrees of freedom: displacements and small rotations along and about the axes of the base frame."""


def joint_errors(robot: Robot, q_d: Array, error: Array, *, axes: tuple[str, ...] = AXES, prior: Array | float = 1e-3,
                 common: Array | None = None, noise: Array | float = 2e-5) -> Array:
    """Joint errors ``(N, n)`` [rad] of TCP errors; raises InputError for an unknown axis, or shapes that do not fit.

    Args:
        robot: kinematics.
        q_d: desired joint positions, about which is linearised ``(N, n)`` [rad].
        error, axes: desired minus measured ``(N, m)`` [m, rad], along these of ``AXES``.
        prior: expected size of joint errors, for all or per sample and joint, broadcast to ``(N, n)`` [rad].
        common: errors that all joints make together, of the size that is expected ``(N, n)`` [rad]; None for none.
        noise: standard deviation of the device, for all or per axis ``(m,)`` [m, rad].
    """
    unknown = [axis for axis in axes if axis not in AXES]
    if unknown or error.shape != (len(q_d), len(axes)):
        raise InputError(f"expected errors (N, {len(axes)}) along some of {', '.join(AXES)}", field="axes",
                         value=unknown or error.shape)
    rows = [AXES.index(axis) for axis in axes]
    weights = np.broadcast_to(np.asarray(prior, dtype=float), q_d.shape) ** 2
    R = np.diag(np.broadcast_to(np.asarray(noise, dtype=float), (len(axes),)) ** 2)
    data, tool = robot.pinocchio.createData(), robot.tool_id
    out = np.empty_like(q_d)
    for k, q in enumerate(q_d):
        J = pin.computeFrameJacobian(robot.pinocchio, data, q, tool, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)[rows]
        WJ = weights[k][:, None] * J.T
        if common is not None:
            WJ = WJ + np.outer(common[k], J @ common[k])
        out[k] = WJ @ np.linalg.solve(J @ WJ + R, error[k])
    return out


def pose_errors(desired: list[pin.SE3], measured: list[pin.SE3]) -> Array:
    """Pose errors ``(N, 6)`` along ``AXES``: displacement and rotation vector, desired minus measured, base frame."""
    return np.array([
        np.concatenate([a.translation - b.translation, pin.log3(a.rotation @ b.rotation.T)])
        for a, b in zip(desired, measured, strict=True)])
