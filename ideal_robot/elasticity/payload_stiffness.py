"""Stiffness from known payloads hung on the flange, with which [J] compares its clamp (Dumas et al., 2011).

The motors are at rest, the flange deflects, an external device measures the deflection:

    Δx = J K⁻¹ Jᵀ ΔF

linear in the compliances 1/k_j. It needs an expensive tracker, and postures in which every joint is loaded.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array, G
from ideal_robot.elasticity.stiffness import JointStiffness, Tolerances, flange_jacobian, least_squares
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import POSE, Recording

LARGEST_STD_PERCENT = 10.0
"""A joint whose stiffness scatters more than this is not loaded enough to be named."""


def identify_from_payloads(recordings: Sequence[Recording], robot: Robot) -> tuple[JointStiffness, ...]:
    """Stiffness of the joints that the payloads load (never a vertical first joint).

    The recordings have the columns ``q_i``, ``payload`` [kg] and the flange pose. The masses' centre in the tool frame
    stands in the metadata (``payload_lever`` [m]); without it, it is the flange. Raises InputError where a column is
    missing, a posture has one payload only, or no joint is loaded.
    """
    equations = [equation for recording in recordings for equation in _postures(recording, robot)]
    W, Y = np.vstack([rows for rows, _ in equations]), np.concatenate([values for _, values in equations])
    loaded = np.linalg.norm(W, axis=0) > 1e-6 * np.max(np.linalg.norm(W, axis=0))
    if not np.any(loaded):
        raise InputError("no joint is loaded in these postures", field="payload")
    W = W[:, loaded]
    # Positions and rotations are measured with different precision: weighted by their own residuals from pass two on.
    weight = np.ones(6)
    for _ in range(3):
        all_weights = np.tile(weight, len(Y) // 6)
        fit = least_squares(W * all_weights[:, None], Y * all_weights)
        residual = (Y - W @ fit.chi).reshape(-1, 6)
        weight = np.repeat(1 / np.maximum(np.std(residual.reshape(-1, 2, 3), axis=(0, 2)), 1e-9), 3)
    results = []
    for i, joint in enumerate(np.flatnonzero(loaded) + 1):
        if fit.std_percent[i] > LARGEST_STD_PERCENT or fit.chi[i] <= 0:
            continue
        k = 1 / float(fit.chi[i])
        std = float(np.sqrt(fit.robust[i, i]))
        half = 1.96 * k * float(np.hypot(k * std, Tolerances().model))
        results.append(JointStiffness(int(joint), "payload", k, 0.0, float(fit.std_percent[i]), 0.0,
                                      100 * fit.relative_residual, (k - half, k + half), fit.condition,
                                      tuple(recording.source for recording in recordings)))
    return tuple(results)


def _postures(recording: Recording, robot: Robot) -> list[tuple[Array, Array]]:
    for name in (*POSE, "payload"):
        if name not in recording.columns:
            raise InputError("column is missing; payloads need the flange pose and the mass", file=recording.source,
                             field=name)
    lever = np.array(recording.meta.get("payload_lever", [0.0, 0.0, 0.0]), dtype=float)
    q, mass = recording.joints("q"), recording.columns["payload"]
    poses = np.column_stack([recording.columns[name] for name in POSE])
    posture = np.cumsum(np.concatenate([[False], np.max(np.abs(np.diff(q, axis=0)), axis=1) > 1e-3]))
    pairs = []
    for number in range(int(posture[-1]) + 1):
        rows = posture == number
        levels = np.unique(mass[rows])
        if len(levels) < 2:
            raise InputError("a posture needs at least two different payloads", file=recording.source, field="payload",
                             value=float(levels[0]))
        jacobian = flange_jacobian(robot, q[rows][0])
        means = [_mean_pose(poses[rows & (mass == level)]) for level in levels]
        for level, pose in zip(levels[1:], means[1:], strict=True):
            force = means[0].rotation.T @ np.array([0.0, 0.0, -(level - levels[0]) * G])
            wrench = np.concatenate([force, np.cross(lever, force)])
            pairs.append((jacobian * (jacobian.T @ wrench), np.array(pin.log6(means[0].inverse() * pose).vector)))
    return pairs


def _mean_pose(poses: Array) -> pin.SE3:
    quaternion = np.mean(poses[:, 3:] * np.sign(poses[:, 3:] @ poses[0, 3:])[:, None], axis=0)
    return pin.XYZQUATToSE3(np.concatenate([poses[:, :3].mean(axis=0), quaternion / np.linalg.norm(quaternion)]))
