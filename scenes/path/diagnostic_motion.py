"""The motion that a diagnosis of a path's arm is made of."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from scenes.path.cell import PathCell, training_path
from scenes.scene_files.path_scene import JointPath

_BEYOND = 1.05
"""Of a path's range that is covered: a path turns round at its ends, and of places where it has never been the motion
can say nothing of what depends on place."""


def diagnostic_motion(cell: PathCell) -> JointPath:
    """All joints about the path's postures, at full, half and a fifth of the path's speed, one after another."""
    fast = covering(training_path(cell.path, cell.world.t_ipo).q_d, cell.path.q_d, cell.robot)
    # Wider is faster.
    fastest = float(np.max(np.abs(np.diff(fast, axis=0)) / (cell.world.t_ipo * cell.robot.v_max)))
    parts = [_slower(fast, slowness * max(1.0, fastest)) for slowness in (1.0, 2.0, 5.0)]
    q_d = np.concatenate([parts[0], *[_joined(a[-1], b) for a, b in pairwise(parts)]])
    t = cell.world.t_ipo * np.arange(float(len(q_d)))
    counts = np.ones(len(q_d), dtype=bool)
    return JointPath(q_d, np.zeros((len(q_d), 3)), np.asarray(t), counts, cell.path.tool)


def covering(motion: Array, path: Array, robot: Robot) -> Array:
    """A motion whose joints reach to both ends of a path: those that do not are widened and centred on its range.

    Args:
        motion: joint angles ``(M, n)`` [rad].
        path: likewise ``(N, n)``, within the limits.
        robot: whose limits hold.
    """
    low, high = path.min(axis=0), path.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    asked = np.minimum(_BEYOND * half, np.minimum(robot.q_max - middle, middle - robot.q_min))
    least, most = motion.min(axis=0), motion.max(axis=0)
    short = (most < high) | (least > low)
    factor = np.where(short, 2.0 * asked / np.maximum(most - least, 1e-12), 1.0)
    moved = middle + factor * (motion - 0.5 * (least + most))
    return np.asarray(np.where(short, moved, motion))


def _slower(motion: Array, slowness: float) -> Array:
    at = np.arange(0.0, len(motion) - 1, 1.0 / slowness)
    return np.column_stack([np.interp(at, np.arange(len(motion)), q) for q in motion.T])


def _joined(end: Array, part: Array, steps: int = 80) -> Array:
    """A part with a smooth approach to its start in front."""
    s = np.linspace(0.0, 1.0, steps)[:, None]
    return np.concatenate([end + (part[0] - end) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2), part])
