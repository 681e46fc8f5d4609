"""What the simulated arm went through: its log, poses at any time of it, and the recording of it."""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Callable
from typing import IO, Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from sim.arm.kernel import LOGGED
from sim.arm.world import World
from sim.simulation_error import SimError

KEPT = 32768
"""Rows kept in memory at most, about a minute; a power of two times the first ones."""
_ANGLE, _SPEED = LOGGED.index("q_a"), LOGGED.index("qd_a")


class History:
    """The log of one run, row by row; of long runs the rows before the last minute are in a file without a name.

    Args:
        n: number of joints.
        step: time between two rows [s].

    Attributes:
        rows: how many rows are filled; whoever fills ``next_row`` counts it.
    """

    def __init__(self, n: int, step: float) -> None:
        self._n, self.step = n, step
        self._log = np.zeros((2048, 1 + len(LOGGED) * n))
        self._file: IO[bytes] | None = None
        self._stored = np.zeros((0, self._log.shape[1]))
        self._first = 0
        self.rows = 0

    @property
    def next_row(self) -> Array:
        """The row that is filled next: time, then ``kernel.LOGGED`` with ``n`` values each."""
        return self._log[self.rows - self._first]

    @property
    def kept(self) -> int:
        """Rows there is memory for."""
        return len(self._log)

    def reserve(self, count: int) -> None:
        """Makes room for ``count`` further rows."""
        if self.rows - self._first + count <= len(self._log):
            return
        if len(self._log) < KEPT:
            self._log = np.concatenate([self._log, np.zeros_like(self._log)])
        else:
            self._store()

    def columns(self) -> dict[str, Array]:
        """``t (N,)`` [s] and every logged quantity ``(N, n)``; of a long run they are read from its file when used."""
        n = self._n
        if self._first:
            self._store()
        log = self._stored if self._first else self._log[: self.rows].copy()
        return {"t": log[:, 0], **{name: log[:, 1 + i * n: 1 + (i + 1) * n] for i, name in enumerate(LOGGED)}}

    def _store(self) -> None:
        """Brings the rows in memory to the file; what was handed out before stays valid."""
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 (open as long as the history is)
            weakref.finalize(self, self._file.close)
        self._file.seek(0, os.SEEK_END)
        self._file.write(self._log[: self.rows - self._first].tobytes())
        self._file.flush()
        self._first = self.rows
        self._stored = np.asarray(np.memmap(self._file, dtype=float, mode="r", shape=(self.rows, self._log.shape[1])))

    def _row(self, i: int) -> Array:
        return self._stored[i] if i < self._first else self._log[i - self._first]

    def pose(self, t: float, t_now: float, q_now: Array, qd_now: Array) -> Array:
        """Arm angles ``(n,)`` [rad] at a time, from angles and velocities of the neighbouring rows.

        Args:
            t: the time asked for [s].
            t_now: time that has been reached, behind the last row [s].
            q_now: arm angles then ``(n,)`` [rad].
            qd_now: arm velocities then ``(n,)`` [rad/s].

        Raises:
            SimError: ``t`` lies before the start or after ``t_now``.
        """
        if not -1.0e-9 <= t <= t_now + 1.0e-9:
            raise SimError(f"the simulated arm knows its pose from 0 to {t_now:.4f} s, not at {t:.4f} s")
        rows, n = self.rows, self._n
        if rows == 0:
            return q_now.copy()
        i = min(int(t / self.step), rows - 1)
        angle, speed = (slice(1 + column * n, 1 + (column + 1) * n) for column in (_ANGLE, _SPEED))
        here = self._row(i)
        t0, q0, v0 = here[0], here[angle], here[speed]
        if i + 1 < rows:
            after = self._row(i + 1)
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


def recording_of(robot: Robot, world: World, history: History, tcp_of: Callable[[Array], pin.SE3] | None) -> Recording:
    """What a controller would have logged, every ``world.log_cycle``.

    Args:
        robot: data sheet of the arm.
        world: the true world.
        history: of the run.
        tcp_of: true pose of the tool frame at arm angles ``(n,)`` [rad], for the columns of an external measuring
            device; None leaves them out.
    """
    logged = history.columns()
    every = max(1, round(world.log_cycle / history.step))
    columns: dict[str, Array] = {"q_c": logged["q_c"][::every], "q": logged["q"][::every],
                                 "tau": logged["tau"][::every],
                                 "current": logged["tau"][::every] / robot.drive_gain}
    if world.thermal:
        columns["temp"] = logged["temperature"][::every]
    if tcp_of is not None:
        columns.update(_external(world, tcp_of, logged["q_a"][::every]))
    meta: dict[str, Any] = {
        "robot": robot.name, "urdf": str(robot.urdf), "urdf_hash": robot.urdf_hash, "cycle_time": world.log_cycle,
        "t_ipo": world.t_ipo, "units": {"t": "s", "q": "rad", "tau": "N m", "current": "A", "temp": "degC", "x": "m"},
        "source": "simulated arm", "correction_delay": world.correction_delay,
    }
    return Recording.from_arrays(logged["t"][::every], meta=meta, source="simulated arm", **columns)


def _external(world: World, tcp_of: Callable[[Array], pin.SE3], q_a: Array) -> dict[str, Array]:
    """An external device's view of the arm; its noise is the same whenever the same recording is asked for."""
    rng = np.random.default_rng([world.individual, len(q_a), 104729])
    poses = [tcp_of(q) for q in q_a]
    position = np.array([pose.translation for pose in poses])
    rotation = Rotation.from_matrix(np.array([pose.rotation for pose in poses]))
    position = position + world.external_position_noise * rng.standard_normal(position.shape)
    rotation = Rotation.from_rotvec(world.external_rotation_noise * rng.standard_normal(position.shape)) * rotation
    quaternion = rotation.as_quat()
    angles = q_a + world.external_rotation_noise * rng.standard_normal(q_a.shape)
    return {"qa": angles, **dict(zip("xyz", position.T, strict=True)),
            **dict(zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True))}
