"""Joint frames and the TCP along a motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.effects import Frames
from ideal_robot.robots.common_normals import common_normals
from ideal_robot.robots.robot import Robot


def frames_along(robot: Robot, q: Array) -> Frames:
    """Joint frames, their axes and the TCP along a motion ``(N, n)``."""
    model, data, tool = robot.pinocchio, robot.pinocchio.createData(), robot.tool_id
    N, n = q.shape
    axis, x, position, tip = (np.empty((N, n, 3)), np.empty((N, n, 3)), np.empty((N, n, 3)), np.empty((N, 3)))
    prismatic = robot.prismatic
    normals = common_normals(robot)
    jacobian = np.empty((N, 3, n))
    for k in range(N):
        pin.framesForwardKinematics(model, data, q[k])
        tip[k] = data.oMf[tool].translation
        full = _jacobian(robot, data, q[k])
        jacobian[k] = full[:3]
        for j in range(n):
            placement = data.oMi[j + 1]
            position[k, j] = placement.translation
            axis[k, j] = full[3:, j] if not prismatic[j] else full[:3, j]
            x[k, j] = placement.rotation @ normals[j]
    return Frames(axis, x, position, tip, jacobian)


def _jacobian(robot: Robot, data: pin.Data, q: Array) -> Array:
    """Jacobian of the tool's place ``(6, n)``; Pinocchio's has one dimension where there is one joint."""
    full = pin.computeFrameJacobian(robot.pinocchio, data, q, robot.tool_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return np.asarray(full).reshape(6, robot.n)
