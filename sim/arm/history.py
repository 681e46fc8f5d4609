"""The log of the simulated arm, its poses at any time, and the recording made from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import KEPT, RowLog, finished, let_go, new_columns
from ideal_robot.signals.recording import Recording
from sim import SimError
from sim.arm.kernel import LOGGED
from sim.arm.world import World

_ANGLE, _SPEED = LOGGED.index("q_a"), LOGGED.index("qd_a")
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Columns of an external measuring device."""


class History(RowLog):
    """The log of one run, row by row, ``step`` [s] apart: time, then ``kernel.LOGGED`` with ``n`` values each."""

    def __init__(self, n: int, step: float) -> None:
        super().__init__(1 + len(LOGGED) * n)
        self._n, self.step = n, step

    def reserve(self, count: int) -> None:
        """Makes room for ``count`` further rows; raises ``OutputError`` where the disk is full: no real arm moves."""
        super().reserve(count)
        if self.refused is not None:
            raise self.refused

    def columns(self) -> dict[str, Array]:
        """Times ``t (N,)`` [s] and every logged quantity ``(N, n)``; a long run's are read from its file when used."""
        return self.split(self.mapped())

    def split(self, rows: Array) -> dict[str, Array]:
        """Rows ``(m, width)`` as ``t (m,)`` [s] and every logged quantity ``(m, n)``."""
        n = self._n
        return {"t": rows[:, 0], **{name: rows[:, 1 + i * n: 1 + (i + 1) * n] for i, name in enumerate(LOGGED)}}

    def parts(self, every: int = 1) -> Iterator[tuple[int, dict[str, Array]]]:
        """Every ``every``-th row, block by block: number of the block's first row, and the block's ``columns``."""
        for first, rows in self.blocks():
            start = -first % every
            if start < len(rows):
                yield (first + start) // every, self.split(rows[start::every])

    def pose(self, t: float, t_now: float, q_now: Array, qd_now: Array) -> Array:
        """Arm angles ``(n,)`` [rad] at a time, from angles and velocities of the neighbouring rows.

        Raises ``SimError`` where ``t`` lies before the start or after ``t_now``.

        Args:
            t: the time [s].
            t_now: time that has been reached, behind the last row [s].
            q_now: arm angles then ``(n,)`` [rad].
            qd_now: arm velocities then ``(n,)`` [rad/s].
        """
        if not -1.0e-9 <= t <= t_now + 1.0e-9:
            raise SimError(f"the simulated arm knows its pose from 0 to {t_now:.4f} s, not at {t:.4f} s")
        rows, n = self.rows, self._n
        if rows == 0:
            return q_now.copy()
        i = min(int(t / self.step), rows - 1)
        angle, speed = (slice(1 + column * n, 1 + (column + 1) * n) for column in (_ANGLE, _SPEED))
        here = self.row(i)
        t0, q0, v0 = here[0], here[angle], here[speed]
        if i + 1 < rows:
            after = self.row(i + 1)
            t1, q1, v1 = after[0], after[angle], after[speed]
        else:
            t1, q1, v1 = t_now, q_now, qd_now
        h = t1 - t0
        if h <= 0.0:
            return q0.copy()
        # Cubic Hermite spline.
        u = min(max((t - t0) / h, 0.0), 1.0)
        return ((1 + 2 * u) * (1 - u) ** 2 * q0 + u * (1 - u) ** 2 * h * v0
                + u * u * (3 - 2 * u) * q1 + u * u * (u - 1) * h * v1)


PoseAt = Callable[[float, Array], pin.SE3]
"""True pose of the tool frame at a time [s] with its arm angles ``(n,)`` [rad]."""


def recording_of(robot: Robot, world: World, history: History, pose_at: PoseAt | None) -> Recording:
    """The recording that a controller would have logged, every ``world.log_cycle``.

    Args:
        robot: data sheet of the arm.
        world: the true world.
        history: of the run.
        pose_at: pose of the tool at a time, for the columns of an external measuring device; None leaves them out.
    """
    every = max(1, round(world.log_cycle / history.step))
    length, n = -(-history.rows // every), robot.n
    names = ["q_c", "q", "tau", "current", *(["temp"] if world.thermal else []), *([] if pose_at is None else ["qa"])]
    columns = new_columns(["t", *(f"{name}_{i + 1}" for name in names for i in range(n)),
                           *([] if pose_at is None else POSE)], length)
    device = None if pose_at is None else _ExternalDevice(world, pose_at, length, n)
    for first, logged in history.parts(every):
        values: dict[str, Array] = {"q_c": logged["q_c"], "q": logged["q"], "tau": logged["tau"],
                                    "current": logged["tau"] / robot.drive_gain, "temp": logged["temperature"]}
        piece = slice(first, first + len(logged["t"]))
        columns["t"][piece] = logged["t"]
        if device is not None:
            values["qa"], pose = device.measured(logged["t"], logged["q_a"])
            for name, column in zip(POSE, pose.T, strict=True):
                columns[name][piece] = column
        for name in names:
            for i in range(n):
                columns[f"{name}_{i + 1}"][piece] = values[name][:, i]
        let_go(columns["t"])
    meta: dict[str, Any] = {
        "robot": robot.name, "urdf": str(robot.urdf), "urdf_hash": robot.urdf_hash, "cycle_time": world.log_cycle,
        "t_ipo": world.t_ipo, "units": {"t": "s", "q": "rad", "tau": "N m", "current": "A", "temp": "degC", "x": "m"},
        "source": "simulated arm", "correction_delay": world.correction_delay,
    }
    return Recording(finished(columns), meta, "simulated arm")


class _ExternalDevice:
    """A measuring device's view of the arm, piece by piece; its noise is the same however often and in what pieces."""

    def __init__(self, world: World, pose_at: PoseAt, length: int, n: int) -> None:
        self._world, self._pose_at, self._n = world, pose_at, n
        # The order of the draws is fixed: all positions, then rotations, then angles.
        self._position, self._rotation, self._angles = (
            np.random.default_rng([world.individual, length, 104729]) for _ in range(3))
        for rng, before in ((self._rotation, 3 * length), (self._angles, 6 * length)):
            for first in range(0, before, KEPT):
                rng.standard_normal(min(KEPT, before - first))

    def measured(self, t: Array, q_a: Array) -> tuple[Array, Array]:
        """Angles ``(m, n)`` [rad] and poses ``x y z qx qy qz qw (m, 7)`` of the next ``m`` rows.

        Args:
            t: their times ``(m,)`` [s].
            q_a: true arm angles then ``(m, n)`` [rad].
        """
        world, m = self._world, len(q_a)
        poses = np.array([self._pose_at(float(at), q).homogeneous for at, q in zip(t, q_a, strict=True)])
        position = poses[:, :3, 3] + world.external_position_noise * self._position.standard_normal((m, 3))
        turned = Rotation.from_rotvec(world.external_rotation_noise * self._rotation.standard_normal((m, 3)))
        quaternion = (turned * Rotation.from_matrix(poses[:, :3, :3])).as_quat()
        angles = q_a + world.external_rotation_noise * self._angles.standard_normal((m, self._n))
        return angles, np.column_stack([position, quaternion])
