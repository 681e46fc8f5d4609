"""The regressions of measured arm angles and TCP positions."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.regression import Regression, noise_floor
from ideal_robot.diagnosis.statistics.problem import Candidate
from ideal_robot.effects import ARM_POSITION, TCP_POSITION, Frames
from ideal_robot.effects.loads import AngleLaw
from ideal_robot.robots.robot import Robot, common_normals
from ideal_robot.signals.preprocess import resampled
from ideal_robot.signals.recording import Recording


def arm_angle_regression(recording: Recording, robot: Robot, torque: Regression,
                   stiffness: Array | None) -> Regression | None:
    """Arm angle minus motor angle of each joint, and minus the gears' known deflection.

    Only a constant difference is taken for granted. Joints without an encoder on the arm's side are absent.

    Args:
        recording: with ``qa_i`` of some joints, else the result is None.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    there = recording.having("qa")
    if not there.any():
        return None
    n = robot.n
    motor = resampled(recording.t, recording.joints("q"), torque.filtered.t)
    bend = arm_angles(recording, torque, stiffness) - motor - deflection(torque, stiffness)
    y = torque.filtered.decimate(np.where(there, bend, 0.0))
    W = np.tile(np.eye(n), (len(y), 1, 1))
    names = tuple(f"qa_{j + 1}" for j in range(n))
    without = {j + 1: "has no angle measured on the arm's side" for j in range(n) if not there[j]}
    return dataclasses.replace(torque, channels=names, units=robot.units("rad"), y=y, measured=y - y.mean(axis=0),
                               W=W, use=np.tile(there, (len(y), 1)), noise_floor=noise_floor(y),
                               undecided={**torque.undecided, **without}, domain=ARM_POSITION,
                               absent=frozenset(int(j) for j in np.flatnonzero(~there)))


def arm_angles(recording: Recording, torque: Regression, stiffness: Array | None) -> Array:
    """Arm angles at the undecimated instants ``(N, n)``: measured, or the motors' with the gears' known deflection.

    Args:
        recording: with ``qa_i`` of some joints.
        torque: the regression of its torques, for signals and instants.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    angles = torque.signals.q + deflection(torque, stiffness)
    for j in np.flatnonzero(recording.having("qa")):
        angles[:, j] = resampled(recording.t, recording.columns[f"qa_{j + 1}"][:, None], torque.filtered.t)[:, 0]
    return angles


def punctual(recording: Recording, delays: Sequence[tuple[int, float]]) -> Recording:
    """The recording with arm angles as they were when it was recorded.

    Nothing is recorded before it happens: where arm angles seem early, it is the motors' that are late.

    Args:
        recording: with ``qa_i`` of some joints.
        delays: joints (from 1; 0 for all) and by how much their arm angles are late [s].
    """
    columns, t = dict(recording.columns), recording.t
    for joint, delay in delays:
        for name in columns.keys() & {f"qa_{j}" for j in ([joint] if joint else range(1, recording.n + 1))}:
            columns[name] = np.interp(t + max(delay, 0.0), t, columns[name])
    return dataclasses.replace(recording, columns=columns)


def deflection(torque: Regression, stiffness: Array | None) -> Array:
    """Arm minus motor angle by gears of known stiffness ``(N, n)``, [J] (2)."""
    if stiffness is None:
        return np.zeros_like(torque.signals.q)
    return np.asarray(-torque.signals.load / stiffness)


def with_loose_weights(made: Regression, effects: Sequence[Candidate]) -> Regression:
    """The regression with what springs bend their gears by, where torques do not tell them from the arm's weight.

    A term of the form of gravity goes to the spring or to the masses as it falls out, and whether a spring pulls on
    the motor's or on the arm's side of its gear no torque says: what the gear carries is known but for its columns.

    Args:
        made: of the arm angles.
        effects: of the motor torques.
    """
    loose = [made.columns_of(one.effect, one.joint, one.theta) for one in effects
             if one.joint not in made.undecided and isinstance(one.effect, AngleLaw)
             and one.effect.like_the_model(made.signals, one.joint) is not None]
    if not loose:
        return made
    return dataclasses.replace(made, W=np.concatenate([made.W, *loose], axis=2))


def frames_along(robot: Robot, q: Array) -> Frames:
    """Joint frames, their axes and the TCP along a motion ``(N, n)``."""
    model, data, tool = robot.pinocchio, robot.pinocchio.createData(), robot.tool_id
    N, n = q.shape
    axis, x, position, tip = (np.empty((N, n, 3)), np.empty((N, n, 3)), np.empty((N, n, 3)), np.empty((N, 3)))
    prismatic = robot.prismatic
    normals = common_normals(robot)
    jacobian = np.empty((N, 3, n))
    for k in range(N):
        pin.framesForwardKinematics(model, data, q[k])
        tip[k] = data.oMf[tool].translation
        full = _jacobian(robot, data, q[k])
        jacobian[k] = full[:3]
        for j in range(n):
            placement = data.oMi[j + 1]
            position[k, j] = placement.translation
            axis[k, j] = full[3:, j] if not prismatic[j] else full[:3, j]
            x[k, j] = placement.rotation @ normals[j]
    return Frames(axis, x, position, tip, jacobian)


def tool_motion(robot: Robot, q: Array, qd: Array) -> tuple[Array, Array, Array]:
    """Rotation ``(N, 3, 3)``, place ``(N, 3)`` and twist ``(N, 6)`` of the tool in the base frame.

    Args:
        robot: the arm.
        q: positions ``(N, n)`` [rad].
        qd: velocities ``(N, n)`` [rad/s].
    """
    data, N = robot.pinocchio.createData(), len(q)
    rotation, place, twist = np.empty((N, 3, 3)), np.empty((N, 3)), np.empty((N, 6))
    for k in range(N):
        twist[k] = _jacobian(robot, data, q[k]) @ qd[k]
        pose = pin.updateFramePlacement(robot.pinocchio, data, robot.tool_id)
        rotation[k], place[k] = pose.rotation, pose.translation
    return rotation, place, twist


def _jacobian(robot: Robot, data: pin.Data, q: Array) -> Array:
    """Jacobian of the tool's place ``(6, n)``; Pinocchio's has one dimension where there is one joint."""
    full = pin.computeFrameJacobian(robot.pinocchio, data, q, robot.tool_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return np.asarray(full).reshape(6, robot.n)


def tool_regression(recording: Recording, robot: Robot, torque: Regression,
                   stiffness: Array | None) -> Regression | None:
    """Measured TCP minus that of the nominal kinematics at the arm angles; None where it was not measured.

    Where arm angles are not measured they are the motor angles with the gears' known deflection. An axis that was not
    measured is absent. Where the measuring device stands (a small rotation and a shift) is fitted beside it.

    Args:
        recording: with some of ``x y z``, else the result is None.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    there = measured_axes(recording)
    if not there.any():
        return None
    grid = torque.filtered.t
    q = arm_angles(recording, torque, stiffness)
    frames = frames_along(robot, q)
    xyz = np.array(frames.tool)
    for k in np.flatnonzero(there):
        xyz[:, k] = resampled(recording.t, recording.columns["xyz"[k]][:, None], grid)[:, 0]
    y = torque.filtered.decimate(xyz - frames.tool)
    p = frames.tool - frames.tool.mean(axis=0)
    W = np.zeros((len(grid), 3, 6))
    W[:, :, :3] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        W[:, :, 3 + i] = np.cross(axis, p)
    # With a measured arm angle the gear has no part in what is left.
    load = np.where(recording.having("qa"), 0.0, torque.signals.load)
    signals = dataclasses.replace(torque.signals, q=q, load=load, frames=frames)
    return dataclasses.replace(
        torque, channels=("x", "y", "z"), units=("m",) * 3, y=y, measured=y - y.mean(axis=0),
        W=torque.filtered.decimate(W), use=np.tile(there, (len(y), 1)), signals=signals, domain=TCP_POSITION,
        noise_floor=noise_floor(y), absent=frozenset(int(i) for i in np.flatnonzero(~there)))


def position_regressions(recording: Recording, robot: Robot, torque: Regression,
                         stiffness: Array | None) -> Iterator[Regression]:
    """The regressions of the arm angles and of the TCP, as far as they were measured.

    Args:
        recording: with ``qa_i`` or ``x y z`` of some joints and axes, else there are none.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    for build in (arm_angle_regression, tool_regression):
        made = build(recording, robot, torque, stiffness)
        if made is not None:
            yield made


def measured_axes(recording: Recording) -> np.ndarray:
    """Which of ``x y z`` the recording has without gaps ``(3,)``."""
    return np.array([axis in recording.columns and bool(np.all(np.isfinite(recording.columns[axis])))
                     for axis in "xyz"])
