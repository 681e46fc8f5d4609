"""The reference path in joint space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import PATH_SPACING
from planning import OutOfReachError
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath


@dataclass(frozen=True)
class JointPath:
    """The reference in joint space: angles and their two derivatives by arc length at ``s (K,)``, ``(K, n)`` each."""

    s: Array
    q: Array
    dq: Array
    ddq: Array

    @classmethod
    def of(cls, robot: Robot, reference: ReferencePath, home: Array | None = None) -> JointPath:
        """Solves the whole path in the posture nearest to ``home``; ``InputError`` names place, joint and limit.

        Args:
            robot: the arm.
            reference: the reference path.
            home: preferred joint angles ``(n,)`` [rad]; the robot's home posture if None.
        """
        kinematics = InverseKinematics(robot)
        s = np.linspace(0.0, reference.length, max(round(reference.length / PATH_SPACING), 10) + 1)
        poses = reference.poses(s)
        try:
            q = kinematics.path(poses, kinematics.search(poses[0], robot.home if home is None else home))
        except OutOfReachError as error:
            raise InputError(f"the path cannot be reached by {robot.name}: {error}", field="path") from error
        return cls.through(s, q)

    @classmethod
    def through(cls, s: Array, q: Array) -> JointPath:
        """The smooth path through joint angles ``(K, n)`` [rad] at arc lengths ``(K,)`` [m]."""
        spline = CubicSpline(s, q)
        return cls(s, q, spline(s, 1), spline(s, 2))
