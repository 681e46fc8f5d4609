"""What an arm's sensors felt and saw, in the base frame, from the columns of a recording."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

_GRAVITY = np.array([0.0, 0.0, -9.81])


def sensed_line(arm: Robot, recording: Recording) -> Array:
    """The middle line point of every camera field ``(K, 3)`` [m]; none where no camera measured.

    Args:
        arm: the arm.
        recording: with ``line_x_i line_y_i line_z_i`` in the tool frame.
    """
    count = sum(name.startswith("line_x_") for name in recording.columns)
    if count == 0:
        return np.empty((0, 3))
    middle = (count + 1) // 2
    points = np.column_stack([recording.columns[f"line_{axis}_{middle}"] for axis in "xyz"])
    q = recording.joints("qa" if recording.has("qa") else "q")
    pose = arm.fk()
    return np.array([pose(q[k]).act(points[k]) for k in np.flatnonzero(np.isfinite(points).all(axis=1))]).reshape(-1, 3)


def sensed_force(arm: Robot, recording: Recording, rows: Array | None = None) -> Array | None:
    """Force of the environment on the tool ``(N, 3)`` [N]; None where no sensor measured.

    The tool's own weight and the sensor's bias are taken away where the recording says what calibration found of them.

    Args:
        arm: the arm.
        recording: with ``fx fy fz`` in the tool frame.
        rows: of the recording; all if None.
    """
    if not all(name in recording.columns for name in ("fx", "fy", "fz")):
        return None
    at = np.arange(len(recording.t)) if rows is None else rows
    felt = np.column_stack([recording.columns[name] for name in ("fx", "fy", "fz")])[at]
    q = recording.joints("qa" if recording.has("qa") else "q")[at]
    tool = recording.meta.get("tool", {})
    tool = tool if isinstance(tool, dict) else {}
    bias = np.asarray(tool.get("bias", np.zeros(6)), dtype=float)[:3]
    weight = float(tool.get("mass", 0.0)) * _GRAVITY
    pose = arm.fk()
    return np.array([pose(row).rotation @ force - weight for row, force in zip(q, felt - bias, strict=True)])
