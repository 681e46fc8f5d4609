"""Joint torques of a force at the tool."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import WRENCH, Recording
from ideal_robot.signals.sampling import resampled


def torques_of_tool_force(robot: Robot, q: Array) -> Array:
    """Joint torques of a force of 1 N on the tool along each axis of its frame ``(N, 3, n)`` [N m; N if prismatic].

    Args:
        robot: the arm.
        q: joint positions ``(N, n)`` [rad or m].
    """
    model, data, result = robot.pinocchio, robot.pinocchio.createData(), np.empty((len(q), 3, robot.n))
    for k, row in enumerate(q):
        full = pin.computeFrameJacobian(model, data, row, robot.tool_id, pin.ReferenceFrame.LOCAL)
        # Pinocchio's has one dimension where there is one joint.
        result[k] = np.asarray(full).reshape(6, robot.n)[:3]
    return result


def felt_at_tool(recording: Recording, t: Array) -> Array | None:
    """Force on the tool by a force sensor at given instants ``(N, 3)`` [N]; None without a sensor.

    Args:
        recording: with ``fx``, ``fy``, ``fz``, or without.
        t: instants ``(N,)`` [s].
    """
    names = WRENCH[:3]
    if not all(name in recording.columns and np.all(np.isfinite(recording.columns[name])) for name in names):
        return None
    return resampled(recording.t, np.column_stack([recording.columns[name] for name in names]), t)
