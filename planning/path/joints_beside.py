"""Effects of wrong joint places and axes on what a camera on the arm sees.

The tool of such an arm stands at E(q) P(q), P being its pose by the description and E a small motion of the base frame
that depends on the posture: to first order the sum of the twists of its joints' places and turns, each on the link
before it. A point seen from one posture and reached in another is displaced by the difference of both.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.joints import own_joints
from ideal_robot.robots.robot import Robot
from planning.path.joint_path import JointPath


class JointsBeside:
    """How errors of the joints' places displace seen points of a line against where the tool reaches them.

    A camera on an arm that follows sees a point from a distance ``ahead`` before the tool is there. The tool reaches
    the line where camera and posture are right *together*, so a mean change of E over that distance acts as an error of
    the camera; only the rest can be seen.

    Args:
        robot: the arm.
        path: joint angles by which it follows.
        at: arc length at which the camera is linearised [m].
        ahead: how far ahead of the tool it looks [m].
    """

    def __init__(self, robot: Robot, path: JointPath, at: float, ahead: float = 0.0) -> None:
        self._robot, self._path, self._data = robot, path, robot.pinocchio.createData()
        seen = self._followed(at - ahead)
        twists = self._twists(seen) - self._twists(self._followed(at))
        self._of_camera = self._pose(seen).inverse().toActionMatrix() @ twists

    def carried(self, q: Array, s: float) -> Array:
        """Displacements of the TCP [m, rad] in the base frame that show in a picture, per error of each joint.

        Args:
            q: joint angles at which the picture was taken ``(n,)`` [rad].
            s: arc length of the points in the picture [m].

        Returns:
            ``(6, 6 n)``: rows the TCP's place and turn, columns place [m] and turn [rad] of each joint.
        """
        pose = self._pose(q)
        twists = self._twists(q) - self._twists(self._followed(s)) - pose.toActionMatrix() @ self._of_camera
        # Moves the twist from the base's origin to the TCP.
        twists[:3] -= pin.skew(pose.translation) @ twists[3:]
        return twists

    def _followed(self, s: float) -> Array:
        return np.array([np.interp(s, self._path.s, column) for column in self._path.q.T])

    def _pose(self, q: Array) -> pin.SE3:
        pin.framesForwardKinematics(self._robot.pinocchio, self._data, q)
        return self._data.oMf[self._robot.tool_id].copy()

    def _twists(self, q: Array) -> Array:
        """Twists of the base frame by the joints' places and turns on the links before them ``(6, 6 n)``."""
        model, data = self._robot.pinocchio, self._data
        pin.forwardKinematics(model, data, q)
        return np.hstack([(data.oMi[model.parents[j]] * model.jointPlacements[j]).toActionMatrix()
                          for j in own_joints(model)])
