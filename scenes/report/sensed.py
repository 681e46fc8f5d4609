"""What an arm's sensors felt and saw, in the base frame, from the columns of a recording."""

from __future__ import annotations

from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.file_array import let_go
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.thinned import step

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
    columns = [recording.columns[f"line_{axis}_{middle}"] for axis in "xyz"]
    rows = np.flatnonzero(np.logical_and.reduce([np.isfinite(column) for column in columns]))
    rows = rows[:: step(len(rows))]
    points = np.column_stack([column[rows] for column in columns])
    q = recording.joints("qa" if recording.has("qa") else "q", rows)
    let_go(*columns)
    pose = arm.fk()
    return np.array([pose(q_k).act(point) for q_k, point in zip(q, points, strict=True)]).reshape(-1, 3)


def sensed_force(arm: Robot, recording: Recording, rows: Any = slice(None)) -> Array | None:
    """Force of the environment on the tool ``(N, 3)`` [N]; None where no sensor measured.

    The tool's own weight and the sensor's bias are taken away where the recording says what calibration found of them.

    Args:
        arm: the arm.
        recording: with ``fx fy fz`` in the tool frame.
        rows: of the recording, as NumPy takes them; all by default.
    """
    if not all(name in recording.columns for name in ("fx", "fy", "fz")):
        return None
    felt = np.column_stack([recording.columns[name][rows] for name in ("fx", "fy", "fz")])
    q = recording.joints("qa" if recording.has("qa") else "q", rows)
    tool = recording.meta.get("tool", {})
    tool = tool if isinstance(tool, dict) else {}
    bias = np.asarray(tool.get("bias", np.zeros(6)), dtype=float)[:3]
    weight = float(tool.get("mass", 0.0)) * _GRAVITY
    pose = arm.fk()
    return np.array([pose(row).rotation @ force - weight for row, force in zip(q, felt - bias, strict=True)])
