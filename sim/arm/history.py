"""From the log of the simulated arm to poses at any time and to recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording
from sim.arm.kernel import LOGGED, N_LOG
from sim.arm.world import STEP
from sim.simulation_error import SimError

if TYPE_CHECKING:
    from sim.arm.arm import SimulatedArm


_ANGLE, _SPEED = LOGGED.index("q_a"), LOGGED.index("qd_a")


def hermite_pose(arm: SimulatedArm, t: float) -> Array:
    """Arm angles ``(n,)`` at time ``t`` [s], from angles and velocities of the neighbouring samples.

    Raises:
        SimError: ``t`` lies before the start or after now.
    """
    if not -1.0e-9 <= t <= arm.t + 1.0e-9:
        raise SimError(f"the simulated arm knows its pose from 0 to {arm.t:.4f} s, not at {t:.4f} s")
    log, rows, n = arm._log, arm._rows, arm.robot.n
    if rows == 0:
        return arm._q_a.copy()
    step = int(arm._counts[N_LOG]) * STEP
    i = min(int(t / step), rows - 1)
    angle, speed = (slice(1 + column * n, 1 + (column + 1) * n) for column in (_ANGLE, _SPEED))
    t0, q0, v0 = log[i, 0], log[i, angle], log[i, speed]
    if i + 1 < rows:
        t1, q1, v1 = log[i + 1, 0], log[i + 1, angle], log[i + 1, speed]
    else:
        t1, q1, v1 = arm.t, arm._q_a, arm._qd_a
    h = t1 - t0
    if h <= 0.0:
        return q0.copy()
    u = min(max((t - t0) / h, 0.0), 1.0)
    return ((1 + 2 * u) * (1 - u) ** 2 * q0 + u * (1 - u) ** 2 * h * v0
            + u * u * (3 - 2 * u) * q1 + u * u * (u - 1) * h * v1)


def recording_of(arm: SimulatedArm, external: bool) -> Recording:
    """The recording of an arm, see ``SimulatedArm.recording``."""
    world, robot = arm.world, arm.robot
    history = arm.history()
    every = max(1, round(world.log_cycle / (int(arm._counts[N_LOG]) * STEP)))
    t = history["t"][::every]
    columns: dict[str, Array] = {"q_c": history["q_c"][::every], "q": history["q"][::every],
                                 "tau": history["tau"][::every],
                                 "current": history["tau"][::every] / robot.drive_gain}
    if world.thermal:
        columns["temp"] = history["temperature"][::every]
    if external:
        columns.update(_external(arm, history["q_a"][::every]))
    meta: dict[str, Any] = {
        "robot": robot.name, "urdf": str(robot.urdf), "urdf_hash": robot.urdf_hash, "cycle_time": world.log_cycle,
        "t_ipo": world.t_ipo, "units": {"t": "s", "q": "rad", "tau": "N m", "current": "A", "temp": "degC", "x": "m"},
        "source": "simulated arm", "correction_delay": world.correction_delay,
    }
    return Recording.from_arrays(t, meta=meta, source="simulated arm", **columns)


def _external(arm: SimulatedArm, q_a: Array) -> dict[str, Array]:
    """An external device's view of the arm; its noise is the same whenever the same recording is asked for."""
    world = arm.world
    rng = np.random.default_rng([world.individual, len(q_a), 104729])
    poses = [arm.tcp_of(q) for q in q_a]
    position = np.array([pose.translation for pose in poses])
    rotation = Rotation.from_matrix(np.array([pose.rotation for pose in poses]))
    position = position + world.external_position_noise * rng.standard_normal(position.shape)
    rotation = Rotation.from_rotvec(world.external_rotation_noise * rng.standard_normal(position.shape)) * rotation
    quaternion = rotation.as_quat()
    angles = q_a + world.external_rotation_noise * rng.standard_normal(q_a.shape)
    return {"qa": angles, **dict(zip("xyz", position.T, strict=True)),
            **dict(zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True))}
