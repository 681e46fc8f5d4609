"""What a recording shows when it is played: from the replay that was written beside it, or from its columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import SHIPPED, Robot
from ideal_robot.signals.recording import Recording
from scenes.report.replay import Replay, rises
from scenes.report.replay_file import read_replay, replay_beside
from scenes.report.sensed import sensed_force, sensed_line

MOST = 3000
"""Samples that are shown of a recording; longer ones are thinned out."""


def open_recording(path: Path, robot: str | None) -> tuple[Robot, Recording]:
    """The recording and the arm it is of.

    Raises:
        InputError: the file does not say its robot and none is given, or their joint counts differ.
    """
    recording = Recording.read(path)
    name = robot or recording.meta.get("robot")
    # A recording may name an arm that ships with the program; files are opened only where the user says so.
    if name is None or (robot is None and name not in SHIPPED):
        raise InputError("the recording does not say its robot; give --robot", file=path)
    arm = Robot.load(name)
    if arm.n != recording.n:
        raise InputError(f"the recording has {recording.n} joints, {arm.name} has {arm.n}", file=path)
    if len(recording.t) < 2 or not rises(recording.t):
        raise InputError("times that rise are needed to show a motion, at least two; give t in seconds, sorted",
                         file=path, field="t")
    return arm, recording


def recorded_replay(path: Path, arm: Robot, recording: Recording) -> Replay:
    """What to show of a recording.

    Args:
        path: of the recording; a replay of the same run beside it is taken.
        arm: the arm it is of.
        recording: what the file holds.
    """
    beside = replay_beside(path)
    if beside.is_file():
        replay = read_replay(beside, arm, recording)
        if replay is not None:
            return replay
    return replay_of_columns(arm, recording)


def replay_of_columns(arm: Robot, recording: Recording) -> Replay:
    """Arm, trace of the tool, and its distance from where it was wanted, from the columns alone.

    Wanted is ``q_d_i`` if there is one, else ``q_c_i``; without either there is no error. The arm is at ``qa_i`` if
    measured, else at ``q_i``. Line points that a camera measured are drawn as a curve.

    Args:
        arm: the arm.
        recording: at least two samples.

    Raises:
        InputError: positions are missing everywhere.
    """
    rows = np.unique(np.linspace(0, len(recording.t) - 1, MOST).astype(int))
    q = recording.joints("qa" if recording.has("qa") else "q", rows)
    # A gap in the positions is no posture that can be drawn.
    measured = np.isfinite(q).all(axis=1)
    rows, q = rows[measured], q[measured]
    if len(rows) < 2:
        raise InputError("no two samples have all positions", file=recording.source, field="q_1")
    tool = _places(arm, q)
    name = next((one for one in ("q_d", "q_c") if recording.has(one)), None)
    wanted = tool if name is None else _places(arm, recording.joints(name, rows))
    error = np.full(len(rows), np.nan) if name is None else 1e3 * np.linalg.norm(tool - wanted, axis=1)
    sensed = sensed_line(arm, recording)
    curves = {"commanded" if name == "q_c" else "desired": wanted} if name is not None else {}
    if len(sensed) > 1:
        curves["line as sensed"] = sensed
    words = "distance from the desired position" if name == "q_d" else "distance from the commanded position"
    return Replay(arm, recording.t[rows], q, tool, wanted, error, words, curves=curves,
                  force=sensed_force(arm, recording, rows))


def _places(arm: Robot, q: Array) -> Array:
    pose = arm.fk()
    return np.array([pose(row).translation for row in np.ascontiguousarray(q)])
