"""Runs a task on the simulated arm, and makes the recording that a controller would have logged."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import finished, let_go, new_columns
from ideal_robot.signals.recording import WRENCH, Recording
from scenes.online.cycle import CycleSettings, play_cycles
from scenes.online.log import TaskLog, point_columns
from scenes.online.task import Task
from scenes.result import Progress
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from sim.arm.arm import SimulatedArm
from sim.equipped_arm import Carried, EquippedArm


def done(task: Task, arm: SimulatedArm, carried: Sequence[Carried], limits: Robot, settings: CycleSettings,
         progress: Progress) -> float:
    """Runs a task; returns the elapsed time [s].

    Args:
        task: its devices connected.
        arm: at rest at the task's start.
        carried: sensors that measure while the arm moves.
        limits: limits of the commands.
        settings: how it ends.
        progress: called with the fraction done.
    """
    started = time.perf_counter()
    play_cycles(EquippedArm(arm, carried), limits, task, task.log, settings, progress)
    return time.perf_counter() - started


def recorded(arm: SimulatedArm, scene: LineScene | ForceScene, method: str, log: TaskLog, external: bool,
             meta: dict[str, Any], points: int = 0) -> Recording:
    """The arm's recording with columns of sensor data and desired positions, and why the arm stopped.

    ``q_d_i`` desired arm angles. For each camera field, in the row at its time stamp and NaN elsewhere: ``cam_t`` [s]
    and the line points in the tool frame ``line_x_i line_y_i line_z_i`` [m] (points that were left out are NaN). Of a
    force sensor the measured wrench and the normal force ``f_normal``.

    Args:
        arm: the arm that has moved.
        scene: the scene.
        method: key of how.
        log: the log of the run.
        external: whether a device measured where the tool was.
        meta: more for the recording's metadata.
        points: line points of a field.
    """
    recording = arm.recording(external=external)
    rows, t, q_d, felt = recording.t, np.asarray(log.t), np.asarray(log.q_d), np.asarray(log.samples)
    desired = [f"q_d_{i + 1}" for i in range(q_d.shape[1])]
    columns = new_columns([*desired, *(point_columns(points) if points else ()), *(("f_normal",) if len(felt) else ()),
                           *(WRENCH if len(log.wrenches) else ())], len(rows))
    for name, angle in zip(desired, q_d.T, strict=True):
        columns[name][:] = np.interp(rows, t, angle)
        let_go(columns[name])
    for name, values in log.point_columns(rows, points) if points else ():
        columns[name][:] = values
        let_go(columns[name])
    if len(felt):
        order = np.argsort(felt[:, 0])
        columns["f_normal"][:] = np.interp(rows, felt[order, 0], felt[order, 1])
    if len(log.wrenches):
        instants = log.wrenches.column(0)
        for i, name in enumerate(WRENCH, start=1):
            columns[name][:] = np.interp(rows, instants, log.wrenches.column(i))
            let_go(columns[name])
    meta = {**recording.meta, **meta, "scene": scene.name, "method": method, "speed": scene.speed, "seed": scene.seed,
            "stopped_because": log.failure}
    return replace(recording, columns={**recording.columns, **finished(columns)}, meta=meta)
