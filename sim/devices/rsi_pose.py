"""Corrections of the tool's pose in a KUKA controller: POSCORR behind an ETHERNET object.

Written from what is commonly known of POSCORR and of KUKA's angles, not from a manual's text, and without the code of
the client's side. That rotations of increments multiply is assumed. A pose is X, Y, Z [mm] and A, B, C [deg], turns
about Z, then the new Y, then the new X, of the tool in the base. Corrections are added in the reference system, from
where RSI began or to those in force, and the controller finds the axes for the pose.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot

_DAMPING = 1e-9
_STEPS = 30
_CLOSE = 1e-9  # [m, rad]


class PoseMotion:
    """Poses and corrections of one controller.

    Args:
        robot: the robot whose geometry the controller knows.
        tool: of the program, on the flange: X, Y, Z [mm], A, B, C [deg].
        base: of the program, in the frame of the arm's foot, alike.
        in_tool: whether corrections are given in the tool frame; otherwise in the base frame.
    """

    def __init__(self, robot: Robot, tool: Array | None = None, base: Array | None = None, in_tool: bool = False
                 ) -> None:
        self._model, self._tip = robot.pinocchio, robot.tool_id
        self._data = self._model.createData()
        self._tool = matrix(np.zeros(6) if tool is None else tool)
        self._base = matrix(np.zeros(6) if base is None else base)
        self.in_tool = in_tool

    def pose(self, q: Array) -> Array:
        """Pose of the tool in the base ``(4, 4)`` at joint angles ``q (n,)`` [rad]."""
        pin.framesForwardKinematics(self._model, self._data, q)
        tip = self._data.oMf[self._tip].homogeneous
        return np.asarray(np.linalg.inv(self._base) @ tip @ self._tool)

    def corrected(self, pose: Array, correction: Array) -> Array:
        """The pose ``(4, 4)`` with a correction ``(6,)`` [mm, deg] added."""
        change = matrix(correction)
        if self.in_tool:
            return np.asarray(pose @ change)
        result = pose.copy()
        result[:3, :3] = change[:3, :3] @ pose[:3, :3]
        result[:3, 3] += change[:3, 3]
        return result

    def joints(self, pose: Array, near: Array) -> Array:
        """Joint angles ``(n,)`` [rad] of a pose, in the configuration of ``near (n,)``.

        Raises ValueError where there are none.
        """
        q = near.copy()
        for _ in range(_STEPS):
            at = self.pose(q)
            turn = at[:3, :3].T @ pose[:3, :3]
            angle = np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))
            axis = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            axis *= 1.0 if angle < 1e-6 else angle / np.sin(angle)
            error = np.concatenate([pose[:3, 3] - at[:3, 3], at[:3, :3] @ axis])
            if np.abs(error).max() < _CLOSE:
                return q
            J = np.column_stack([self._moves(q, at, i) for i in range(len(q))])
            q = q + J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(6), error)
        raise ValueError("no posture for the pose")

    def _moves(self, q: Array, at: Array, joint: int, small: float = 1e-6) -> Array:
        """How the pose changes with one joint ``(6,)``: place and turn in the base."""
        there = self.pose(q + small * np.eye(len(q))[joint])
        turn = there[:3, :3] @ at[:3, :3].T
        return np.concatenate([there[:3, 3] - at[:3, 3], 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])]) / small


def matrix(numbers: Array) -> Array:
    """The frame ``(4, 4)`` [m] of X, Y, Z [mm], A, B, C [deg]."""
    x, y, z, *turns = np.asarray(numbers, dtype=float)
    (ca, cb, cc), (sa, sb, sc) = np.cos(np.radians(turns)), np.sin(np.radians(turns))
    frame = np.eye(4)
    frame[:3, :3] = [[ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
                     [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
                     [-sb, cb * sc, cb * cc]]
    frame[:3, 3] = 1e-3 * np.array([x, y, z])
    return frame


def numbers(frame: Array) -> Array:
    """X, Y, Z [mm], A, B, C [deg] of a frame ``(4, 4)`` [m]."""
    R = frame[:3, :3]
    turns = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])), np.arctan2(R[2, 1], R[2, 2])
    return np.concatenate([1e3 * frame[:3, 3], np.degrees(turns)])
