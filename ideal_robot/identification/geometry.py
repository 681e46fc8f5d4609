"""Estimates the places of an arm's joints from measured tool poses, relative to its drawings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.joints import own_joints
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import POSE, Recording

_POSTURES = 400
"""Postures of a recording that count: neighbouring samples show the same."""
_PASSES = 3
"""The device may stand turned by much; what is left of its turn squares with each pass."""


def has_geometry(recording: Recording) -> bool:
    """Whether a recording has tool poses together with arm angles, as gear deflection exceeds geometric errors."""
    return recording.has("qa") and all(name in recording.columns for name in POSE)


def measured_geometry(recordings: Sequence[Recording], robot: Robot, usual: tuple[float, float]) -> Array:
    """Shifts [m] and rotations [rad] of the joints' places, in their parents' frames ``(n, 6)``.

        Δx = R_p (d + w × r),  Δφ = R_p w     r: from the joint to the tool, R_p: of the joint's parent

    Least squares of first order, as kinematic calibration is done. Errors that no pose distinguishes, as of parallel
    axes or of a joint and its tool, are divided by their prior ``usual``. The device's place is unknown, so the first
    joint's place is not determined.

    Args:
        recordings, robot: with arm angles and poses, see ``has_geometry``; the arm as its data sheet has it.
        usual: standard deviations of shifts [m] and turns [rad] in arms of the class.
    """
    width = np.concatenate([np.full(6, np.inf), np.tile(np.repeat(usual, 3), robot.n)])
    qa, pose = (np.concatenate(parts) for parts in zip(*map(_postures, recordings), strict=True))
    measured = [pin.XYZQUATToSE3(row) for row in pose]
    device, noise = measured[0] * robot.fk()(qa[0]).inverse(), np.array(usual)
    for _ in range(_PASSES):
        W, y = _equations(qa, [device.inverse() * frame for frame in measured], robot)
        scale = 1.0 / np.repeat(noise, 3)
        A = np.concatenate([(W * scale[:, None]).reshape(-1, W.shape[2]), np.diag(1.0 / width)])
        solution = np.linalg.lstsq(A, np.concatenate([(y * scale).ravel(), np.zeros(len(width))]), rcond=None)[0]
        noise = np.sqrt(np.mean(((y - W @ solution) ** 2).reshape(-1, 2, 3), axis=(0, 2)))
        device = device * pin.SE3(pin.exp3(solution[3:6]), solution[:3])
    return np.asarray(solution[6:].reshape(robot.n, 6))


def _postures(recording: Recording) -> tuple[Array, Array]:
    """Arm angles ``(m, n)`` [rad] and poses ``(m, 7)`` of postures spread over the recording."""
    some = np.unique(np.linspace(0, len(recording.t) - 1, _POSTURES).astype(int))
    return recording.joints("qa", some), np.column_stack([recording.columns[name][some] for name in POSE])


def _equations(qa: Array, measured: Sequence[pin.SE3], robot: Robot) -> tuple[Array, Array]:
    """What device and joints change of the poses ``(m, 6, 6 + 6 n)``, and what the drawings are off by ``(m, 6)``."""
    model, data = robot.pinocchio, robot.pinocchio.createData()
    W, y = np.zeros((len(qa), 6, 6 + 6 * robot.n)), np.zeros((len(qa), 6))
    for i, (q, pose) in enumerate(zip(qa, measured, strict=True)):
        pin.framesForwardKinematics(model, data, q)
        tool = data.oMf[robot.tool_id]
        y[i] = np.concatenate([pose.translation - tool.translation, pin.log3(pose.rotation @ tool.rotation.T)])
        frames = [(np.eye(3), np.zeros(3)), *((data.oMi[model.parents[j]].rotation, data.oMi[j].translation)
                                              for j in own_joints(model))]
        for k, (R, place) in enumerate(frames):
            W[i, :3, 6 * k : 6 * k + 3] = W[i, 3:, 6 * k + 3 : 6 * k + 6] = R
            W[i, :3, 6 * k + 3 : 6 * k + 6] = -pin.skew(tool.translation - place) @ R
    return W, y
