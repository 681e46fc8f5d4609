"""The regressions of measured arm angles and of TCP positions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.regression import Regression, noise_floor
from ideal_robot.effects import ARM_POSITION, TCP_POSITION, Frames
from ideal_robot.effects.loads import AngleLaw
from ideal_robot.robots.joints import joint_motions, own_joints
from ideal_robot.robots.robot import Robot, common_normals
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import resampled


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
        regression = build(recording, robot, torque, stiffness)
        if regression is not None:
            yield regression


def arm_angle_regression(recording: Recording, robot: Robot, torque: Regression,
                         stiffness: Array | None) -> Regression | None:
    """Arm angle minus motor angle of each joint, and minus the gears' known deflection; see ``position_regressions``.

    Only a constant difference is part of the model. Joints without an encoder on the arm's side are absent.
    """
    mask = recording.having("qa")
    if not mask.any():
        return None
    motor = resampled(recording.t, recording.joints("q"), torque.filtered.t)
    bend = arm_angles(recording, torque, stiffness) - motor - _deflection(torque, stiffness)
    y = torque.filtered.decimate(np.where(mask, bend, 0.0))
    without = {j + 1: "has no angle measured on the arm's side" for j in range(robot.n) if not mask[j]}
    return _measured(torque, y, mask, channels=tuple(f"qa_{j + 1}" for j in range(robot.n)), units=robot.units("rad"),
                     W=np.tile(np.eye(robot.n), (len(y), 1, 1)), undecided={**torque.undecided, **without},
                     domain=ARM_POSITION)


def tool_regression(recording: Recording, robot: Robot, torque: Regression,
                    stiffness: Array | None) -> Regression | None:
    """Measured TCP minus that of the nominal kinematics at the arm angles; see ``position_regressions``.

    Where arm angles are not measured they are the motor angles with the gears' known deflection. An axis that was not
    measured is absent. The place of the measuring device (a small rotation and a shift) is fitted, too.
    """
    measured = measured_axes(recording)
    if not measured.any():
        return None
    q = arm_angles(recording, torque, stiffness)
    frames = frames_along(robot, q)
    xyz = np.array(frames.tool)
    for k in np.flatnonzero(measured):
        xyz[:, k] = resampled(recording.t, recording.columns["xyz"[k]][:, None], torque.filtered.t)[:, 0]
    p = frames.tool - frames.tool.mean(axis=0)
    W = np.zeros((len(p), 3, 6))
    W[:, :, :3] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        W[:, :, 3 + i] = np.cross(axis, p)
    # With a measured arm angle the gear does not contribute to the residual.
    load = np.where(recording.having("qa"), 0.0, torque.signals.load)
    return _measured(torque, torque.filtered.decimate(xyz - frames.tool), measured, channels=("x", "y", "z"),
                     units=("m",) * 3, W=torque.filtered.decimate(W), domain=TCP_POSITION,
                     signals=replace(torque.signals, q=q, load=load, frames=frames))


def _measured(torque: Regression, y: Array, measured: np.ndarray, **own: Any) -> Regression:
    """The regression of ``y (N, c)`` along the same motion; channels that are not ``measured (c,)`` are absent."""
    return replace(torque, y=y, measured=y - y.mean(axis=0), use=np.tile(measured, (len(y), 1)),
                   noise_floor=noise_floor(y), absent=frozenset(np.flatnonzero(~measured).tolist()), **own)


def measured_axes(recording: Recording) -> np.ndarray:
    """Which of ``x y z`` the recording has without gaps ``(3,)``."""
    return np.array([axis in recording.columns and bool(np.all(np.isfinite(recording.columns[axis])))
                     for axis in "xyz"])


def arm_angles(recording: Recording, torque: Regression, stiffness: Array | None) -> Array:
    """Arm angles ``(N, n)`` at the undecimated instants, measured or from gear deflection.

    See ``position_regressions``.
    """
    angles = torque.signals.q + _deflection(torque, stiffness)
    for j in np.flatnonzero(recording.having("qa")):
        angles[:, j] = resampled(recording.t, recording.columns[f"qa_{j + 1}"][:, None], torque.filtered.t)[:, 0]
    return angles


def _deflection(torque: Regression, stiffness: Array | None) -> Array:
    """Arm minus motor angle by gears of known stiffness ``(N, n)``, [J] (2)."""
    load = torque.signals.load
    return np.zeros_like(load) if stiffness is None else np.asarray(-load / stiffness)


def punctual(recording: Recording, delays: Sequence[tuple[int, float]]) -> Recording:
    """The recording with the delays of arm angles removed.

    A recording cannot be early: if arm angles seem early, the motors' are late. Each delay has its joint (from 1; 0 for
    all) and the delay of its arm angle [s].
    """
    columns, t = dict(recording.columns), recording.t
    for joint, delay in delays:
        for name in columns.keys() & {f"qa_{j}" for j in ([joint] if joint else range(1, recording.n + 1))}:
            columns[name] = np.interp(t + max(delay, 0.0), t, columns[name])
    return replace(recording, columns=columns)


def with_loose_weights(made: Regression, effects: Sequence[Candidate]) -> Regression:
    """The regression of arm angles with columns for springs that torques cannot distinguish from weight.

    Torques do not show whether a term like gravity belongs to a spring or to masses, nor on which side of the gear a
    spring acts. The gear torque is therefore known except for the columns of such ``effects``.
    """
    loose = [made.columns_of(choice.effect, choice.joint, choice.theta) for choice in effects
             if isinstance(choice.effect, AngleLaw) and made.use[:, choice.joint - 1].any()
             and choice.effect.like_the_model(made.signals, choice.joint) is not None]
    return replace(made, W=np.concatenate([made.W, *loose], axis=2)) if loose else made


def frames_along(robot: Robot, q: Array) -> Frames:
    """Joint frames, their axes and the TCP along a motion ``(N, n)``."""
    x, position, tip, full = (np.empty((len(q), *shape)) for shape in ((robot.n, 3), (robot.n, 3), (3,), (6, robot.n)))
    normals = common_normals(robot)
    axis, motions, own = np.empty_like(x), joint_motions(robot.pinocchio), own_joints(robot.pinocchio)
    for k, (data, jacobian) in enumerate(_postures(robot, q)):
        tip[k], full[k] = data.oMf[robot.tool_id].translation, jacobian
        for j, (joint, along) in enumerate(zip(own, motions.axis[motions.own], strict=True)):
            placement = data.oMi[joint]
            position[k, j], x[k, j] = placement.translation, placement.rotation @ normals[j]
            axis[k, j] = placement.rotation @ along
    return Frames(axis, x, position, tip, full[:, :3].copy())


def tool_motion(robot: Robot, q: Array, qd: Array) -> tuple[Array, Array, Array]:
    """Rotation ``(N, 3, 3)``, place ``(N, 3)`` and twist ``(N, 6)`` of the tool in the base frame.

    Args:
        robot: the arm.
        q, qd: positions and velocities ``(N, n)`` [rad, rad/s].
    """
    rotation, place, twist = np.empty((len(q), 3, 3)), np.empty((len(q), 3)), np.empty((len(q), 6))
    for k, (data, jacobian) in enumerate(_postures(robot, q)):
        pose = data.oMf[robot.tool_id]
        rotation[k], place[k], twist[k] = pose.rotation, pose.translation, jacobian @ qd[k]
    return rotation, place, twist


def _postures(robot: Robot, q: Array) -> Iterator[tuple[pin.Data, Array]]:
    """Yields Pinocchio's data and the tool's Jacobian ``(6, n)`` for each row of positions."""
    model, data = robot.pinocchio, robot.pinocchio.createData()
    for row in q:
        full = pin.computeFrameJacobian(model, data, row, robot.tool_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        # Pinocchio's has one dimension where there is one joint.
        yield data, np.asarray(full).reshape(6, robot.n)
