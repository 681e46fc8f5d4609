"""Common normals of neighbouring joint axes, as Denavit and Hartenberg use them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot


def common_normals(robot: Robot) -> Array:
    """Common normal of each joint's axis and the next one, in the joint's own frame ``(n, 3)``.

    For parallel axes it points from one to the other; for the last joint towards the TCP.
    """
    n = robot.n
    model, q, prismatic = robot.pinocchio, pin.neutral(robot.pinocchio), robot.prismatic
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    full = pin.computeFrameJacobian(model, data, q, robot.tool_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    # Pinocchio's has one dimension where there is one joint.
    full = np.asarray(full).reshape(6, n)
    axes = [full[:3, j] if prismatic[j] else full[3:, j] for j in range(n)]
    places = [*[data.oMi[j + 1].translation for j in range(n)], data.oMf[robot.tool_id].translation]
    result = np.empty((n, 3))
    for j in range(n):
        z = axes[j] / np.linalg.norm(axes[j])
        across = np.cross(z, axes[j + 1]) if j + 1 < n else np.zeros(3)
        for candidate in (across, places[j + 1] - places[j], *np.eye(3)):
            flat = candidate - (candidate @ z) * z
            if np.linalg.norm(flat) > 1e-3:
                break
        result[j] = data.oMi[j + 1].rotation.T @ (flat / np.linalg.norm(flat))
    return result
