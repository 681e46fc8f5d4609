"""Regressions behind the gear: measured arm angles against motor angles, measured TCP against kinematics."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin

from ideal_robot.diagnosis.experiment import Experiment
from ideal_robot.effects.base import Frames
from ideal_robot.identification.preprocess import resampled
from ideal_robot.interface import Array
from ideal_robot.recording import Recording
from ideal_robot.robot import Robot


def arm_experiment(recording: Recording, robot: Robot, torque: Experiment,
                   stiffness: Array | None) -> Experiment | None:
    """Arm angle minus motor angle of each joint, and minus the gears' known deflection.

    Only a constant difference is taken for granted.

    Args:
        recording: with ``qa_i``, else the result is None.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    if not recording.has("qa"):
        return None
    grid = torque.filtered.t
    qa, q = (resampled(recording.t, recording.joints(key), grid) for key in ("qa", "q"))
    n = robot.n
    y = torque.decimate(qa - q - _deflection(torque, stiffness))
    W = np.zeros((len(y), n, n))
    W[:, np.arange(n), np.arange(n)] = 1.0
    names = tuple(f"qa_{j + 1}" for j in range(n))
    units = tuple("m" if unit == "N" else "rad" for unit in torque.units)
    return dataclasses.replace(torque, channels=names, units=units, y=y, measured=y - y.mean(axis=0),
                               W=W, use=np.ones(y.shape, dtype=bool), quiet=_noise(qa - q, torque), head="qa")


def tcp_experiment(recording: Recording, robot: Robot, torque: Experiment,
                   stiffness: Array | None) -> Experiment | None:
    """Measured TCP minus that of the nominal kinematics at the arm angles.

    Where arm angles are not measured they are the motor angles with the gears' known deflection.

    Taken for granted: where the measuring device stands (a small rotation and a shift).
    """
    if not all(axis in recording.columns for axis in "xyz"):
        return None
    measured = np.column_stack([recording.columns[axis] for axis in "xyz"])
    if not np.all(np.isfinite(measured)):
        return None
    grid = torque.filtered.t
    xyz = resampled(recording.t, measured, grid)
    behind = recording.has("qa")
    q = (resampled(recording.t, recording.joints("qa"), grid) if behind
         else torque.signals.q + _deflection(torque, stiffness))
    frames = frames_along(robot, q)
    y = torque.decimate(xyz - frames.tool)
    p = frames.tool - frames.tool.mean(axis=0)
    W = np.zeros((len(grid), 3, 6))
    W[:, :, :3] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        W[:, :, 3 + i] = np.cross(axis, p)
    # With measured arm angles the gears have no part in what is left.
    load = np.zeros_like(q) if behind else torque.signals.load
    signals = dataclasses.replace(torque.signals, q=q, load=load, frames=frames)
    return dataclasses.replace(torque, channels=("x", "y", "z"), units=("m",) * 3, y=y,
                               measured=y - y.mean(axis=0), W=torque.decimate(W),
                               use=np.ones(y.shape, dtype=bool), quiet=_noise(xyz, torque), signals=signals, head="tcp")


def frames_along(robot: Robot, q: Array) -> Frames:
    """Joint frames, their axes and the TCP along a motion ``(N, n)``."""
    model, data, tool = robot.model, robot.model.createData(), robot.tool_id
    N, n = q.shape
    axis, x, position, tip = (np.empty((N, n, 3)), np.empty((N, n, 3)), np.empty((N, n, 3)), np.empty((N, 3)))
    prismatic = np.array([model.joints[j + 1].shortname().startswith("JointModelP") for j in range(n)])
    jacobian = np.empty((N, 3, n))
    for k in range(N):
        pin.framesForwardKinematics(model, data, q[k])
        tip[k] = data.oMf[tool].translation
        full = pin.computeFrameJacobian(model, data, q[k], tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        jacobian[k] = full[:3]
        for j in range(n):
            placement = data.oMi[j + 1]
            position[k, j] = placement.translation
            axis[k, j] = full[3:, j] if not prismatic[j] else full[:3, j]
            x[k, j] = placement.rotation[:, 0] if abs(placement.rotation[:, 0] @ axis[k, j]) < 0.9 \
                else placement.rotation[:, 1]
    return Frames(axis, x, position, tip, jacobian)


def _deflection(torque: Experiment, stiffness: Array | None) -> Array:
    """Arm minus motor angle by gears of known stiffness ``(N, n)``, [J] (2)."""
    if stiffness is None:
        return np.zeros_like(torque.signals.q)
    return np.asarray(-torque.signals.load / stiffness)


def _noise(values: Array, torque: Experiment) -> Array:
    """Noise in the band that is looked at, from third differences."""
    factor = torque.filtered.factor
    return np.asarray(np.std(np.diff(values, 3, axis=0), axis=0) / np.sqrt(20.0 * factor))
