"""What it costs when a controller that takes absolute corrections gets none any more: it holds the last command."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot


def holding_share(q_c: Array, robot: Robot) -> float:
    """Acceleration of a command that stands still from one cycle to the next, where it was fastest.

    As a multiple of the arm's limit, the worst joint's: all of the speed goes within one cycle.

    Args:
        q_c: commands of a run ``(N, n)`` [rad].
        robot: cycle and limits.
    """
    if len(q_c) < 2:
        return 0.0
    return float(np.max(np.abs(np.diff(q_c, axis=0)) / robot.t_ipo**2 / robot.a_max))
