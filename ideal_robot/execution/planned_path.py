"""Reads joint paths of planners: columns of a table or recording, or ROS's JointTrajectory in JSON or a bag."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly, make_interp_spline

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_text
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.bag import SUFFIXES
from ideal_robot.signals.recording import Recording
from ideal_robot.tolerances import LONGEST_PATH, ROUNDING, SAME_POINT

FEW = 6
"""Points below which a path is led through them from rest to rest: fewer tell nothing of speed and acceleration."""
_TYPE = "trajectory_msgs/msg/JointTrajectory"
_WITHIN = ("moveit_msgs/msg/RobotTrajectory", "moveit_msgs/msg/DisplayTrajectory",
           "control_msgs/action/FollowJointTrajectory_Goal")


@dataclass(frozen=True)
class GivenPath:
    """A joint path as it was read.

    Attributes:
        t: times of the points ``(N,)`` [s].
        q_d: positions ``(N, n)`` [rad, or m where a joint slides].
        column: name of the positions in the path's source, for messages.
        warnings: samples that were dropped or reordered.
        commands: commands along it in the file ``(N, n)`` [rad], where they differ from its positions; else None.
    """

    t: Array
    q_d: Array
    column: str
    warnings: tuple[str, ...] = ()
    commands: Array | None = None


def read_path(path: Path, robot: Robot) -> GivenPath:
    """The joint path in a file for an arm: a JointTrajectory, or columns of a recording.

    From a recording ``q_d`` is used, else ``q``, else ``q_c``: commands alone, as of a planned motion, are a path too.
    A JointTrajectory's points are joined as ROS's controller does: by cubics where they have velocities, by quintics
    where they have accelerations, too.

    Args:
        path: JSON with a JointTrajectory anywhere in it, a bag or MCAP that holds one, or any recording.
        robot: the robot whose joints these are.

    Raises:
        InputError: no path in the file, columns or joints are missing, or there are more than the arm has, points that
            do not fit together.
    """
    if path.suffix == ".json":
        first, count = _found(_parsed(path), path)
        return _one_of(count, "first", _trajectory(first, robot, path), path)
    if path.is_dir() or path.suffix in SUFFIXES:
        last, count = _in_bag(path)
        if last is not None:
            return _one_of(count, "last", _trajectory(last, robot, path), path)
    return _columns(path, robot)


def _one_of(count: int, which: str, given: GivenPath, path: Path) -> GivenPath:
    """A path that says of how many trajectories in its file it is one."""
    if count == 1:
        return given
    text = f"trajectories: {path.name} holds {count} JointTrajectory; the {which} is taken, the others are left out"
    return replace(given, warnings=(text, *given.warnings))


def _columns(path: Path, robot: Robot) -> GivenPath:
    recording = Recording.read(path)
    columns = {prefix: [f"{prefix}_{i + 1}" for i in range(robot.n)] for prefix in ("q_d", "q", "q_c")}
    for prefix, names in columns.items():
        if all(name in recording.columns for name in names):
            if f"{prefix}_{robot.n + 1}" in recording.columns:
                raise InputError(f"the path has more joints than {robot.name} ({robot.n})", file=path,
                                 field=f"{prefix}_{robot.n + 1}")
            values = {key: np.column_stack([recording.columns[name] for name in columns[key]])
                      for key in {prefix, "q_c"} if all(name in recording.columns for name in columns[key])}
            return GivenPath(recording.t, values[prefix], prefix, commands=values.get("q_c"))
    begun = next((names for names in columns.values() if any(name in recording.columns for name in names)),
                 columns["q_d"])
    missing = next(name for name in begun if name not in recording.columns)
    raise InputError(f"column is missing; q_d_1 to q_d_{robot.n} (or q_1 to q_{robot.n}, or q_c_1 to q_c_{robot.n}) "
                     "are needed", file=path, field=missing)


# JointTrajectory, as JSON and as a message.

def _parsed(path: Path) -> Any:
    try:
        return json.loads(read_text(path, "a JSON file"))
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"not readable as JSON ({error})", file=path) from error


def _found(value: Any, path: Path) -> tuple[Mapping[str, Any], int]:
    """The first table with ``joint_names`` and ``points``, at any depth, and how many there are."""
    found: list[Mapping[str, Any]] = []
    waiting, index = [value], 0
    while index < len(waiting):
        entry = waiting[index]
        index += 1
        if isinstance(entry, dict):
            if "points" in entry and "joint_names" in entry:
                found.append(entry)
            else:
                waiting.extend(entry.values())
        elif isinstance(entry, list):
            waiting.extend(entry)
    if found:
        return found[0], len(found)
    raise InputError("holds no JointTrajectory: a table with joint_names and points is needed", file=path,
                     field="joint_names")


def _in_bag(path: Path) -> tuple[Mapping[str, Any] | None, int]:
    """The last JointTrajectory of a bag as a table, None where it holds none, and how many there are."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            wanted = [one for one in reader.connections if one.msgtype == _TYPE or one.msgtype in _WITHIN]
            last, count = None, 0
            for connection, _, raw in reader.messages(connections=wanted) if wanted else ():
                for message in _trajectories(reader.deserialize(raw, connection.msgtype)):
                    last, count = message, count + 1
    except InputError:
        raise
    except Exception as error:  # the library raises whatever a broken bag leads to
        raise InputError(f"not a readable bag ({str(error)[:200]})", file=path) from error
    if last is None:
        return None, 0
    points = [{"positions": list(point.positions), "velocities": list(point.velocities),
               "accelerations": list(point.accelerations),
               "time_from_start": {"sec": point.time_from_start.sec, "nanosec": point.time_from_start.nanosec}}
              for point in last.points]
    return {"joint_names": list(last.joint_names), "points": points}, count


def _trajectories(message: Any) -> Iterator[Any]:
    """Joint trajectories in a message, the whole of a planner's answer in order."""
    if hasattr(message, "points") and hasattr(message, "joint_names"):
        yield message
    for name in ("joint_trajectory", "trajectory"):
        inner = getattr(message, name, None)
        for entry in inner if isinstance(inner, list) else [inner]:
            if entry is not None:
                yield from _trajectories(entry)


def _trajectory(message: Mapping[str, Any], robot: Robot, path: Path) -> GivenPath:
    """A JointTrajectory's points: at the arm's cycle where they have velocities, else as they are."""
    names, points = message["joint_names"], message["points"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError("expected a list of names", file=path, field="joint_names")
    if not isinstance(points, list) or not points:
        raise InputError("expected a list of points", file=path, field="points")
    order, warnings = _order(names, robot, path)
    t = np.array([_seconds(point, path, k) for k, point in enumerate(points)])
    q, speed, acceleration = (_values(points, key, len(names), order, path)
                              for key in ("positions", "velocities", "accelerations"))
    if q is None:
        raise InputError("a path needs positions", file=path, field="points.positions")
    if speed is None:
        return GivenPath(t, q, "positions", warnings)
    t, rows, said = distinct(t, q, str(path), "positions")
    if len(t) < 2 or t[-1] - t[0] > LONGEST_PATH:
        raise InputError(f"expected two points or more within {LONGEST_PATH:g} s", file=path, field="time_from_start",
                         value=float(t[-1] - t[0]))
    known = [values[rows] for values in (q, speed, acceleration) if values is not None]
    joined = BPoly.from_derivatives(t, np.stack(known, axis=1))
    grid = instants_of(t, robot.t_ipo)
    # A resampled path needs at least some samples, however short it is.
    grid = grid if len(grid) >= FEW else np.linspace(t[0], t[-1], FEW)
    return GivenPath(grid, np.asarray(joined(grid)), "positions", (*warnings, *said))


def instants_of(t: Array, t_ipo: float) -> Array:
    """Instants of the cycles ``(K,)`` [s] in which a path is executed.

    The last cycle is the one in which the path's end is reached, wherever in it that lies.

    Args:
        t: of the path's points ``(N,)`` [s].
        t_ipo: cycle [s].
    """
    return np.asarray(np.minimum(np.arange(t[0], t[-1] + t_ipo - ROUNDING, t_ipo), t[-1]))


def _order(names: Sequence[str], robot: Robot, path: Path) -> tuple[list[int], tuple[str, ...]]:
    """Places of the arm's joints among the named ones, in its order, and a warning about the others."""
    own = list(robot.joint_names)
    if all(name in names for name in own):
        others = [name for name in names if name not in own]
        said = (f"joints left out that are not the arm's: {', '.join(others)}",) if others else ()
        return [names.index(name) for name in own], said
    # The names may have a common prefix of the arm in its cell, as with two arms.
    ends = [[i for i, name in enumerate(names) if name.endswith(joint)] for joint in own]
    if all(len(found) == 1 for found in ends):
        return [found[0] for found in ends], ()
    if len(names) == robot.n:
        return list(range(robot.n)), (f"the joints are called {', '.join(names)}, those of {robot.name} "
                                      f"{', '.join(own)}: they are taken in this order",)
    raise InputError(f"the joints of {robot.name} are {', '.join(own)}", file=path, field="joint_names",
                     value=", ".join(names)[:200])


def _seconds(point: Any, path: Path, k: int) -> float:
    """Time of a point from the start [s]: a number, or seconds and nanoseconds as ROS 1 and 2 call them."""
    written = point.get("time_from_start") if isinstance(point, dict) else None
    try:
        if isinstance(written, dict):
            seconds = written.get("sec", written.get("secs", 0))
            return float(str(seconds)) + 1e-9 * float(str(written.get("nanosec", written.get("nsecs", 0))))
        return float(str(written))
    except (TypeError, ValueError) as error:
        raise InputError("expected seconds, or a table with sec and nanosec", file=path,
                         field=f"points.{k}.time_from_start", value=str(written)[:40]) from error


def _values(points: Sequence[Any], key: str, count: int, order: Sequence[int], path: Path) -> Array | None:
    """One quantity of all points in the arm's order ``(N, n)``; None where no point has it."""
    rows = [point.get(key) or [] for point in points]
    if not any(len(row) for row in rows):
        return None
    for k, row in enumerate(rows):
        if len(row) != count or not all(isinstance(value, int | float) for value in row):
            raise InputError(f"expected {count} numbers, one for each of joint_names", file=path,
                             field=f"points.{k}.{key}", value=str(row)[:40])
    return np.array(rows, dtype=float)[:, list(order)]


# Duplicate points, and paths with few points.

def distinct(t: Array, q: Array, file: str | None, column: str
             ) -> tuple[Array, NDArray[np.int_], tuple[str, ...]]:
    """Times ``(M,)`` [s] and rows ``(M,)`` of a path's points without duplicates, and warnings of the dropped ones.

    Args:
        t, q: times ``(N,)`` [s] and positions ``(N, n)`` [rad or m].
        file, column: source of the points, and the name of their positions, for messages.

    Raises:
        InputError: times that fall, two positions at one time; names the sample.
    """
    steps = np.diff(t)
    if (steps < 0.0).any():
        k = int(np.argmax(steps < 0.0))
        raise InputError(f"times have to increase: sample {k + 2} is at {t[k + 1]:.9g} s, the one before it at "
                         f"{t[k]:.9g} s", file=file, field="t", value=float(t[k + 1]))
    twice = np.flatnonzero(steps == 0.0)
    for k in twice.tolist():
        off = np.abs(q[k + 1] - q[k])
        if off.max() > SAME_POINT:
            joint = int(np.argmax(off)) + 1
            raise InputError(f"samples {k + 1} and {k + 2} are both at t = {t[k]:.9g} s, and {column}_{joint} is at "
                             f"{q[k, joint - 1]:.6g} and {q[k + 1, joint - 1]:.6g}: give each its own time", file=file,
                             field="t", value=float(t[k]))
    rows = np.delete(np.arange(len(t)), twice + 1)
    if not len(twice):
        return t, rows, ()
    return t[rows], rows, (f"doubled: {len(twice)} point{'s' * (len(twice) > 1)} of the path given twice, first at t = "
                           f"{t[twice[0]]:.6g} s: left out",)


def through_few(t: Array, q: Array, grid: Array) -> Array:
    """The quintic spline from rest to rest through few points, at times ``(M,)``: positions ``(M, n)``.

    Args:
        t, q: times ``(N,)`` [s] and positions ``(N, n)`` of the points, two or more.
        grid: instants of the result ``(M,)`` [s].
    """
    still = [(1, np.zeros(q.shape[1])), (2, np.zeros(q.shape[1]))]
    return np.asarray(make_interp_spline(t, q, k=5, bc_type=(still, still))(grid))
