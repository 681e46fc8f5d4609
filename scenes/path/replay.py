"""The replay of a path: the arm, the desired path, the tool's distance from where it should be at the time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.robots.robot import Robot
from scenes.path.result import PathResult
from scenes.report.replay import Replay


def path_replay(result: PathResult, ghost: PathResult | None = None) -> Replay | None:
    """The replay of a run; None where it is too short for one.

    Args:
        result: the run.
        ghost: another run of the same path, drawn pale.
    """
    path, played = result.path, result.played
    if len(path.t) < 2:
        return None
    robot = Robot.load(result.scene.robot)
    q = played.q_a[: len(path.t)]
    t = path.t[: len(q)]
    # Cycle by cycle: the desired position of a cycle is to be reached at its time stamp.
    tool = np.column_stack([np.interp(t, played.t, column) for column in played.tcp.T])
    counts = path.counts[: len(q)]
    error = np.where(counts, np.linalg.norm(tool - path.x_d[: len(q)], axis=1), np.nan)
    replay = Replay(robot, t, q, tool, path.x_d[: len(q)], 1e3 * error, "distance from the path at the time",
                    curves={"desired path": path.x_d})
    return replay if ghost is None else replace(replay, ghost=ghost.played.q_a[: len(q)])
