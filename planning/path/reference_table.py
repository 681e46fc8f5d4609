"""The reference path at every interpolation cycle of its travel, in Cartesian and in joint space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from planning.path.speed_profile import JointPath, SpeedProfile

Rows = slice | NDArray[np.int_]
"""Which cycles: a slice, or their numbers."""


class ReferenceTable:
    """What of a reference does not change with what sensors show, computed before the travel begins.

    Args:
        kinematics: of the arm.
        reference: the reference path.
        profile: the travel along it.
        rest: cycles that the table goes on at rest behind the end of the travel.
        joint_path: the reference in joint space; the profile's own if None.

    Attributes:
        s: arc length at every cycle ``(K,)`` [m].
        frames: the path's frames there.
        rotations: of the tool in the base frame ``(K, 3, 3)``.
        q: joint angles ``(K, n)`` [rad].
    """

    def __init__(
        self,
        kinematics: InverseKinematics,
        reference: ReferencePath,
        profile: SpeedProfile,
        rest: int,
        joint_path: JointPath | None = None,
    ) -> None:
        T = kinematics.robot.t_ipo
        cycles = int(np.ceil(profile.duration / T)) + rest
        self.s = profile.s(T * np.arange(cycles))
        self.frames = reference.frames(self.s)
        self.rotations = reference.rotation(self.s)
        path = joint_path or profile.joint_path or JointPath.of(kinematics.robot, reference)
        self.q = np.column_stack([np.interp(self.s, path.s, column) for column in path.q.T])
        self.q = kinematics.refine_rows(self.rotations, self.frames.position, self.q, tolerance=1e-12)

    def __len__(self) -> int:
        return len(self.s)

    def displaced(self, rows: Rows, deviation: Array) -> Array:
        r"""Positions :math:`x_r + d_1 n + d_2 u` at some cycles, [L] (6).

        Args:
            rows: the cycles.
            deviation: lateral, and with a second column along the surface normal too ``(m, 1 or 2)`` [m].

        Returns:
            shape ``(m, 3)`` [m].
        """
        positions = self.frames.position[rows] + deviation[:, :1] * self.frames.normal[rows]
        if deviation.shape[1] > 1:
            positions = positions + deviation[:, 1:] * self.frames.up[rows]
        return positions
