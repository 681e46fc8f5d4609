"""The give of clamp and links, estimated from the wrench and taken away from the motor angles.

[J] assumes that the arm stands while the motors turn. A real clamp gives way, and links bend, so the arm angles move a
little and every gear looks softer than it is. With motor angles and wrenches of several configurations that give can be
estimated beside the stiffnesses, because it couples the joints while a gear does not:

    q_m = q_0 + K⁻¹ τ + J(q_0)⁻¹ C F_e,      C = c_t I_t + c_r I_r + Σ_j c_j J_bj J_bjᵀ

c_t and c_r are translational and rotational compliance of the clamp, c_j is the bending compliance of link j, J_bj maps
its rotations across its joint axis to the flange. All unknowns enter linearly, and none is negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from ideal_robot.arrays import Array
from ideal_robot.elasticity.clamped_signals import ClampedSignals
from ideal_robot.elasticity.stiffness import flange_jacobian, joint_torque
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot


def without_clamp_give(signals: Sequence[ClampedSignals], robot: Robot) -> tuple[ClampedSignals, ...]:
    """The same recordings with the motor angles they would have, did the arm stand as [J] (3) assumes.

    Args:
        signals: two or more recordings in different configurations, all six wrench components measured.
        robot: geometry.

    Raises:
        InputError: not six joints, a wrench component is missing, or too few samples under load.
    """
    n = robot.n
    if n != 6:
        raise InputError("the give of clamp and links is told apart from that of six joints only; leave --clamp out",
                         field="robot", value=f"{robot.name}, {n} joints")
    blocks = [_block(one, robot) for one in signals]
    weight = np.ones(n)
    for _ in range(3):
        W = np.vstack([(rows * weight[None, :, None]).reshape(-1, rows.shape[2]) for rows, _ in blocks])
        Y = np.concatenate([(angles * weight).reshape(-1) for _, angles in blocks])
        scale = np.linalg.norm(W, axis=0)
        chi = nnls(W.T @ W / np.outer(scale, scale), W.T @ Y / scale)[0] / scale
        residual = np.vstack([angles - rows @ chi for rows, angles in blocks])
        # Joints whose angles the model explains worse count less from the second pass on.
        weight = 1 / np.maximum(np.std(residual, axis=0), 1e-12)
    corrected = []
    for one in signals:
        assert one.wrench is not None
        compliance = np.tensordot(chi[n:], compliance_shapes(robot, one.q_0), axes=1)
        arm_motion = np.linalg.solve(flange_jacobian(robot, one.q_0), compliance @ one.wrench.T).T
        known = np.all(np.isfinite(arm_motion), axis=1)
        standing = one.q_m - np.where(known[:, None], arm_motion, 0.0)
        corrected.append(replace(one, q_m=standing, clamped=one.clamped & known))
    return tuple(corrected)


def _block(one: ClampedSignals, robot: Robot) -> tuple[Array, Array]:
    """Regressor ``(N, n, 2 n + 2)`` and motor angles ``(N, n)``, the means taken away from each."""
    if len(one.measured) < 6:
        raise InputError("all six wrench components are needed to tell clamp and gears apart", file=one.source,
                         field="fx fy fz mx my mz")
    tau, use = joint_torque(one, robot, "wrench")
    if np.count_nonzero(use) < 10:
        raise InputError("fewer than 10 samples under load", file=one.source)
    assert one.wrench is not None
    wrench, q_m = one.wrench[use], one.q_m[use]
    jacobian = flange_jacobian(robot, one.q_0)
    shapes = compliance_shapes(robot, one.q_0)
    rows = np.zeros((len(q_m), robot.n, robot.n + len(shapes)))
    rows[:, range(robot.n), range(robot.n)] = tau[use]
    for column, shape in enumerate(shapes):
        rows[:, :, robot.n + column] = np.linalg.solve(jacobian, shape @ wrench.T).T
    return rows - rows.mean(axis=0), q_m - q_m.mean(axis=0)


def compliance_shapes(robot: Robot, q: Array) -> list[Array]:
    """I_t, I_r and J_bj J_bjᵀ of each link in the tool frame, each ``(6, 6)``."""
    data = robot.pinocchio.createData()
    pin.framesForwardKinematics(robot.pinocchio, data, q)
    flange = data.oMf[robot.tool_id]
    shapes = [np.diag([1.0] * 3 + [0.0] * 3), np.diag([0.0] * 3 + [1.0] * 3)]
    for joint in range(1, robot.n + 1):
        axis = np.array(pin.computeJointJacobian(robot.pinocchio, data, q, joint))[:, joint - 1]
        across = np.linalg.svd(axis[None, 3:])[2][1:]
        bending = (flange.inverse() * data.oMi[joint]).action[:, 3:] @ across.T
        shapes.append(bending @ bending.T)
    return shapes
