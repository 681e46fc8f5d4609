"""Where an arm may go while it moves on its own: above the floor and off its base column."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.postures import spread_postures
from ideal_robot.robots.robot import Robot


@dataclass(frozen=True)
class Workspace:
    """Where the tool and the links may go, in the base frame.

    Attributes:
        z_min: lowest height of the tool and of every joint above the first two [m].
        r_min: smallest distance of the tool from the base axis while it is lower than ``z_free`` [m].
        z_free: height above which the base column is no obstacle [m].
        beyond: extra length beyond the tool frame that must also keep clear [m].
    """

    z_min: float = 0.15
    r_min: float = 0.35
    z_free: float = 1.2
    beyond: float = 0.0

    @classmethod
    def of(cls, robot: Robot) -> Workspace:
        """For arms that reach a metre or further the default, for smaller ones in proportion to their reach.

        The floor is never so high that the tool or a joint could not rise above it by half of the height it can reach:
        a turntable has its tool on the floor.
        """
        data = robot.pinocchio.createData()
        spans, heights = [], []
        for q in spread_postures(robot.q_min, robot.q_max):
            tip, joints = _points(robot, data, q, 0.0)
            spans.append(float(np.hypot(tip[0], tip[1])))
            heights.append([tip[2], *joints])
        small = min(1.0, max(spans))
        highest = float(np.min(np.max(heights, axis=0)))
        # An axis that slides stands on no column that its tool could hit.
        column = 0.0 if robot.prismatic[0] else small * cls.r_min
        return cls(min(small * cls.z_min, highest - 0.5 * abs(highest)), column, small * cls.z_free)

    def widened(self, robot: Robot, q: Array) -> Workspace:
        """The workspace, wider where the arm has been already: what was recorded touched nothing.

        Args:
            robot: the arm.
            q: recorded postures ``(N, n)`` [rad].
        """
        data, low, near = robot.pinocchio.createData(), self.z_min, self.r_min
        for posture in q[:: max(1, len(q) // 400)]:
            tip, heights = _points(robot, data, posture, self.beyond)
            low = min(low, float(tip[2]), *heights)
            if tip[2] < self.z_free:
                near = min(near, float(np.hypot(tip[0], tip[1])))
        return replace(self, z_min=low, r_min=near)


def clear_of_obstacles(robot: Robot, q: Array, workspace: Workspace) -> bool:
    """Whether the arm keeps off floor and base column in all postures ``(N, n)``.

    Args:
        robot: the arm.
        q: postures ``(N, n)`` [rad].
        workspace: floor and base column.
    """
    data, w = robot.pinocchio.createData(), workspace
    for q_k in q:
        tip, heights = _points(robot, data, q_k, w.beyond)
        if min([tip[2], *heights]) < w.z_min or (tip[2] < w.z_free and np.hypot(tip[0], tip[1]) < w.r_min):
            return False
    return True


def _points(robot: Robot, data: pin.Data, q: Array, beyond: float) -> tuple[Array, list[float]]:
    """Where the tool is at ``q (n,)``, ``beyond`` its frame ``(3,)`` [m], and how high the joints above the second."""
    pin.framesForwardKinematics(robot.pinocchio, data, q)
    tip = data.oMf[robot.tool_id].act(np.array([0.0, 0.0, beyond]))
    return tip, [float(data.oMi[i].translation[2]) for i in range(3, robot.pinocchio.njoints)]
