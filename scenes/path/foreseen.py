"""What a changed model makes of a measured play: the identified loop, given the same commands, on the computer.

A change that explains nothing of how the arm left its path cannot bring it back there, and is not tried on the arm.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.measured import Measured
from scenes.path.cell import PathCell
from scenes.path.result import Play


def left_unexplained(cell: PathCell, model: Model, played: Play, measured: Measured) -> float:
    """Root mean square distance between the measured joints and those of a model's loop on the same commands [m].

    At the tool, as an aligned path error.

    Args:
        cell: path, arm and how commands reach it.
        model: whose loop is played.
        played: what the arm did.
        measured: motor angles where nothing else is measured, else arm angles.

    Raises:
        IdealRobotError: the loop of that model cannot be played.
    """
    motion = simulate(loop_model(model, cell.robot, delay=cell.delay), played.q_c)
    recording = played.recording
    angles = recording.joints("q" if measured == "motor" else "qa")
    counts = cell.path.counts[: len(motion.t)]
    t = motion.t[: len(counts)][counts]
    seen = np.column_stack([np.interp(t, recording.t, column) for column in angles.T])
    expected = (motion.q_m if measured == "motor" else motion.q_a)[: len(counts)][counts]
    at = _tool(cell.robot, expected)
    apart = _tool(cell.robot, seen) - at
    # As an aligned path error: without a constant difference and a constant delay.
    apart, speed = apart - apart.mean(axis=0), np.gradient(at, axis=0)
    apart -= speed * np.sum(apart * speed) / max(np.sum(speed**2), 1e-300)
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))


def _tool(robot: Robot, q: Array) -> Array:
    pose = robot.fk()
    return np.array([pose(row).translation for row in q])
