"""Paths as planners give them: points twice, few points, ROS's JointTrajectory in JSON and in a bag."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.execution.planned_path import read_path
from ideal_robot.execution.precorrect import path_at_cycles
from ideal_robot.robots.robot import Robot

ROBOT = Robot.load("kr6")
NAMES = list(ROBOT.pinocchio.names)[1:]
SWING = np.array([0.3, -0.2, 0.25, 0.4, -0.3, 0.5])


def path(t: np.ndarray) -> np.ndarray:
    """From rest to rest within two seconds ``(N, 6)`` [rad]."""
    u = np.clip(t / 2.0, 0.0, 1.0)
    return np.asarray(ROBOT.home + (10 * u**3 - 15 * u**4 + 6 * u**5)[:, None] * SWING)


def speed(t: np.ndarray) -> np.ndarray:
    u = np.clip(t / 2.0, 0.0, 1.0)
    return np.asarray((30 * u**2 - 60 * u**3 + 30 * u**4)[:, None] * SWING / 2.0)


def acceleration(t: np.ndarray) -> np.ndarray:
    u = np.clip(t / 2.0, 0.0, 1.0)
    return np.asarray((60 * u - 180 * u**2 + 120 * u**3)[:, None] * SWING / 4.0)


T = np.linspace(0.0, 2.0, 21)


@pytest.mark.parametrize("places", [[0], [7], [19], [3, 4, 12]])
def test_a_point_given_twice_is_left_out_and_said(places: list[int]) -> None:
    rows = np.sort(np.concatenate([np.arange(len(T)), places]))
    _, q, warnings = path_at_cycles(T[rows], path(T)[rows], ROBOT, rest=0.0)
    wanted = path_at_cycles(T, path(T), ROBOT, rest=0.0)[1]
    np.testing.assert_array_equal(q, wanted)
    assert [text for text in warnings if f"{len(places)} point" in text and f"t = {T[places[0]]:.6g} s" in text]


@pytest.mark.parametrize("place", [0, 9, 19])
def test_two_positions_at_one_time_and_falling_times_name_the_sample(place: int) -> None:
    doubled, falling = T.copy(), T.copy()
    doubled[place + 1] = doubled[place]
    falling[place + 1] = falling[place] - 0.01
    # In the middle of the motion, where neighbours are no two copies of one point.
    q = path(np.linspace(0.1, 1.9, 21))
    for times, says in ((doubled, f"samples {place + 1} and {place + 2} are both"),
                        (falling, f"sample {place + 2} is")):
        with pytest.raises(InputError, match=says):
            path_at_cycles(times, q, ROBOT, rest=0.0)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_few_points_are_joined_from_rest_to_rest(count: int) -> None:
    t = np.linspace(0.0, 2.0, count)
    times, q, warnings = path_at_cycles(t, path(t), ROBOT, rest=0.0)
    inside = times <= 2.0
    np.testing.assert_allclose(q[inside], path(times[inside]), atol=1e-6 if count == 2 else 0.02)
    assert np.abs(np.diff(q, axis=0)[0]).max() < 1e-4
    assert any(f"{count} points" in text for text in warnings)


def trajectory(names: list[str], order: list[int], *, ros: int = 2, count: int = 6, derivatives: int = 2
               ) -> dict[str, Any]:
    t = np.linspace(0.0, 2.0, count)
    values = dict(zip(("positions", "velocities", "accelerations"), (path(t), speed(t), acceleration(t)), strict=True))
    kept = list(values)[: 1 + derivatives]
    sec, nano = ("sec", "nanosec") if ros == 2 else ("secs", "nsecs")
    points = [{**{key: values[key][k][order].tolist() for key in kept},
               "time_from_start": {sec: int(t[k]), nano: round(1e9 * (t[k] - int(t[k])))}} for k in range(count)]
    return {"joint_names": names, "points": points}


@pytest.mark.parametrize("seed", range(4))
def test_a_trajectory_in_json_is_the_path_whatever_the_order_of_its_joints(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    order = rng.permutation(6).tolist()
    prefix = ["", "left_"][seed % 2]
    message = trajectory([prefix + NAMES[i] for i in order], order, ros=1 + seed % 2)
    file = tmp_path / "plan.json"
    file.write_text(json.dumps([{"joint_trajectory": message}] if seed > 1 else message))
    given = read_path(file, ROBOT)
    np.testing.assert_allclose(given.q_d, path(given.t), atol=2e-5)
    assert given.t[-1] == pytest.approx(2.0)
    path_at_cycles(given.t, given.q_d, ROBOT, rest=0.1)


def test_joints_that_are_not_the_arms_are_left_out_and_missing_ones_refused(tmp_path: Path) -> None:
    message = trajectory(NAMES, list(range(6)), derivatives=0)
    for point in message["points"]:
        point["positions"].append(0.01)
    file = tmp_path / "plan.json"
    file.write_text(json.dumps({**message, "joint_names": [*NAMES, "finger"]}))
    given = read_path(file, ROBOT)
    np.testing.assert_allclose(given.q_d, path(given.t), atol=1e-12)
    assert "finger" in " ".join(given.warnings)
    few = {"joint_names": NAMES[:5], "points": [{"positions": [0.0] * 5, "time_from_start": 0.0}]}
    for text, says in ((json.dumps(few), "joints of kr6"), ("{", "not readable as JSON"), ("[1]", "no JointTrajectory"),
                       (json.dumps({**message, "points": [{"positions": [1.0]}]}), "time_from_start")):
        file.write_text(text)
        with pytest.raises(InputError, match=says):
            read_path(file, ROBOT)


def test_of_several_trajectories_the_first_is_taken_and_they_are_counted(tmp_path: Path) -> None:
    messages = [trajectory(NAMES, list(range(6)), count=count) for count in (6, 9, 7)]
    (tmp_path / "plan.json").write_text(json.dumps({"plans": messages}))
    given = read_path(tmp_path / "plan.json", ROBOT)
    np.testing.assert_allclose(given.q_d, path(given.t), atol=2e-5)
    assert any(text.startswith("trajectories: ") and " 3 " in text for text in given.warnings)


@pytest.mark.parametrize("times", [1, 2])
def test_a_trajectory_in_a_bag_is_the_path(times: int, tmp_path: Path) -> None:
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    message = trajectory(NAMES, list(range(6)))
    points = [kinds["trajectory_msgs/msg/JointTrajectoryPoint"](
        positions=np.array(point["positions"]), velocities=np.array(point["velocities"]),
        accelerations=np.array(point["accelerations"]), effort=np.array([]),
        time_from_start=kinds["builtin_interfaces/msg/Duration"](**point["time_from_start"]))
        for point in message["points"]]
    stamp = kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    made = kinds["trajectory_msgs/msg/JointTrajectory"](header=header, joint_names=NAMES, points=points)
    with Writer(tmp_path / "bag", version=9) as writer:
        connection = writer.add_connection("/plan", made.__msgtype__, typestore=store)
        for k in range(times):
            writer.write(connection, 1 + k, store.serialize_cdr(made, made.__msgtype__))
    given = read_path(tmp_path / "bag", ROBOT)
    np.testing.assert_allclose(given.q_d, path(given.t), atol=2e-5)
    assert any("trajectories: " in text for text in given.warnings) == (times > 1)
