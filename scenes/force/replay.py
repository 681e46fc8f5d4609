"""The replay of a force scene: the arm, the path of the tool, how far the force is from the wanted one."""

from __future__ import annotations

import numpy as np

from ideal_robot.file_array import let_go
from ideal_robot.robots.robot import Robot
from planning.force.contact import Phase
from scenes.force.cell import scene_curves
from scenes.force.result import ForceResult
from scenes.report.replay import Replay
from scenes.report.sensed import sensed_force
from scenes.thinned import step


def force_replay(result: ForceResult) -> Replay | None:
    """The replay of a run; None where it is too short for one.

    Args:
        result: the run.
    """
    recording = result.recording
    if len(recording.t) < 2:
        return None
    robot = Robot.load(result.scene.robot)
    rows = slice(None, None, step(len(recording.t)))
    t, q = recording.t[rows], recording.joints("qa", rows)
    pose = robot.fk()
    tool = np.array([pose(row).translation for row in q])
    travel = [t for t, phase in zip(result.log.t, result.log.phase, strict=False) if phase == Phase.TRAVEL.value]
    force = np.interp(t, result.history["t"], result.history["normal"])
    let_go(result.history["t"], result.history["normal"])
    error = np.full(len(t), np.nan)
    if travel:
        counts = (t >= travel[0]) & (t <= travel[-1])
        error[counts] = np.abs(force - result.scene.force)[counts]
    # There is no place where the tool had to be: the force decides, so nothing is drawn enlarged.
    return Replay(robot, t, q, tool, tool, error, "difference from the wanted force", "N",
                  curves=scene_curves(result.scene), enlarged=1.0, force=sensed_force(robot, recording, rows))
