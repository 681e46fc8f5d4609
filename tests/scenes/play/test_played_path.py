"""``ideal-robot play``: a path on an arm behind its maker's interface, from a file to a recording."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.execution.precorrect import precorrect
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.arms import shipped_model
from scenes.played_path import PlaySettings, planned_path, played_path
from scenes.scene_files.scene import SceneError
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rtde_controller import RtdeController
from tests.sim.devices.controllers import PATIENCE, controlled, serving
from tests.sources import free_port

ROBOT = Robot.load("kr6")
T = ROBOT.t_ipo


def motion(cycles: int = 100) -> Array:
    """Every joint once out and back."""
    phase = np.pi * np.arange(cycles) / (cycles - 1)
    return np.asarray(ROBOT.home + np.sin(phase)[:, None] ** 4 * np.array([0.3, -0.2, 0.25, 0.4, -0.3, 0.5]))


def written(file: Path, **columns: Array) -> Path:
    first = next(iter(columns.values()))
    pd.DataFrame({"t": T * np.arange(len(first)), **{f"{name}_{i + 1}": values[:, i] for name, values in columns.items()
                                                      for i in range(values.shape[1])}}).to_csv(file, index=False)
    return file


@contextmanager
def rtde_arm(start: Array = ROBOT.home) -> Iterator[str]:
    """A simulated KR 6 behind RTDE; yields its address."""
    with (SimulatedArm(ROBOT, World.default("kr6"), np.random.default_rng(1), q0=start) as arm,
          serving(RtdeController(arm, timeout=PATIENCE)) as controller):
        yield "rtde://{}:{}".format(*controller.address)


def test_an_arm_is_led_to_the_start_and_the_commands_are_recorded_as_sent(tmp_path: Path) -> None:
    away = ROBOT.home + np.array([0.2, 0.1, -0.1, 0.2, 0.1, 0.0])
    with rtde_arm(away) as address:
        settings = PlaySettings(address, "kr6", rest=0.1)
        planned = planned_path(written(tmp_path / "path.csv", q_c=motion(), q_d=motion() + 1e-3), settings)
        done = played_path(planned, settings)
    assert done.failure is None
    recording = done.run.recording
    np.testing.assert_allclose(recording.joints("q_c"), planned.commands, atol=1e-12)
    np.testing.assert_allclose(recording.joints("q_d"), planned.desired, atol=1e-12)
    np.testing.assert_allclose(recording.joints("q_d") - recording.joints("q_c"), 1e-3, atol=1e-12)
    np.testing.assert_allclose(np.diff(recording.t), T, atol=1e-9)
    assert recording.has("current")
    # By the time the path begins the arm has come to its start, from 0.2 rad away.
    np.testing.assert_allclose(recording.joints("q")[0], ROBOT.home, atol=2e-3)


def test_comparing_plays_the_path_first_as_it_is(tmp_path: Path) -> None:
    model = Model.load(shipped_model("kr6"))
    corrected = precorrect(T * np.arange(100), motion(), model, ROBOT, delay=1, rest=0.3).recording
    corrected.write(tmp_path / "corrected.parquet")
    with rtde_arm() as address:
        settings = PlaySettings(address, rest=0.1, compare=True)
        done = played_path(planned_path(tmp_path / "corrected.parquet", settings), settings)
    assert done.failure is None
    assert done.before is not None
    np.testing.assert_array_equal(done.before.recording.joints("q_c"), done.before.recording.joints("q_d"))
    # What the arm reports are motor angles; precorrection leads the arm's.
    assert np.sqrt(np.mean(done.run.errors_mrad() ** 2)) < 0.3 * np.sqrt(np.mean(done.before.errors_mrad() ** 2))
    columns, rows = done.table()
    assert columns == ["error", "before", "after"]
    assert rows[-1][0].startswith("tool")
    assert rows[-2][2] < 0.3 * rows[-2][1]


def test_a_plain_path_has_nothing_to_compare(tmp_path: Path) -> None:
    settings = PlaySettings("rtde://127.0.0.1:1", "kr6", compare=True)
    planned = planned_path(written(tmp_path / "path.csv", q_d=motion()), settings)
    with pytest.raises(InputError, match="nothing to compare"):
        played_path(planned, settings)


@pytest.mark.slow
def test_a_plain_path_is_watched_by_the_loop_that_a_given_model_knows(tmp_path: Path) -> None:
    path, shipped = written(tmp_path / "path.csv", q_d=motion()), shipped_model("kr6")
    plain, watched = (planned_path(path, PlaySettings("rtde://127.0.0.1", "kr6", model=model))
                      for model in (None, shipped))
    assert plain.response is None
    assert watched.response is not None
    np.testing.assert_allclose(watched.response.sum(axis=0), 1.0, atol=0.05)
    np.testing.assert_array_equal(plain.commands, watched.commands)
    other = replace(Model.load(shipped), controller=None, command=None).save(tmp_path / "no_loop.json")
    assert planned_path(path, PlaySettings("rtde://127.0.0.1", "kr6", model=other)).response is None
    with pytest.raises(InputError, match="identified for this arm"):
        planned_path(path, PlaySettings("rtde://127.0.0.1", "kr6", model=shipped_model("kr15")))


def test_the_same_path_behind_rsi(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    settings = PlaySettings(f"rsi://127.0.0.1:{port}", "kr6", rest=0.1, patience=PATIENCE)
    planned = planned_path(written(tmp_path / "path.csv", q=motion()), settings)
    away = ROBOT.home + 0.1
    with (SimulatedArm(ROBOT, World.default("kr6"), np.random.default_rng(1), q0=away) as arm,
          controlled(arm, port)):
        done = played_path(planned, settings)
    assert done.failure is None
    assert done.run.recording.meta["corrections"] == "absolute"
    np.testing.assert_allclose(done.run.recording.joints("q_c")[-1], ROBOT.home, atol=1e-9)
    np.testing.assert_allclose(done.run.recording.joints("q")[-1], ROBOT.home, atol=2e-3)


def test_an_arm_that_would_touch_its_base_on_the_way_is_not_moved(tmp_path: Path) -> None:
    down = np.array([0.0, -1.0, 1.9, 0.0, 0.6, 0.0])
    with rtde_arm(down + np.array([1.5, 0, 0, 0, 0, 0])) as address:
        path = np.tile(np.array([0.0, 0.6, 0.9, 0.0, 0.0, 0.0]), (30, 1))
        settings = PlaySettings(address, "kr6", rest=0.1)
        with pytest.raises(SceneError, match="touches"):
            played_path(planned_path(written(tmp_path / "path.csv", q_d=path), settings), settings)


@pytest.mark.parametrize(("address", "says"), [
    ("usb:0", "expected an address"), ("rtde://", "with a host"), ("rtsp://a", "interfaces are"),
    ("rtd://127.0.0.1", "did you mean 'rtde'"), ("rtde://127.0.0.1?rate=5", "no options"),
    ("rtde://127.0.0.1:99999", "expected an address"), ("rtde://127.0.0.1:0", "expected an address")])
def test_an_address_that_cannot_be(tmp_path: Path, address: str, says: str) -> None:
    settings = PlaySettings(address, "kr6", patience=0.1)
    with pytest.raises(InputError, match=says):
        played_path(planned_path(written(tmp_path / "path.csv", q_d=motion()), settings), settings)


def test_the_verb_writes_the_recording(program, tmp_path: Path) -> None:
    path = written(tmp_path / "path.csv", q_d=motion(60))
    with rtde_arm() as address:
        done = program("play", str(path), "--arm", address, "--robot", "kr6", "-o", str(tmp_path / "moved.parquet"),
                       "--json", str(tmp_path / "moved.json"), "--rest", "0.1")
    assert done.code == 0, done.err
    assert "next: ideal-robot identify" in done.out
    assert Recording.read(tmp_path / "moved.parquet").meta["source"] == "play"
