"""A disk that is full: an arm that moves is brought to rest, what was there before stays, and one line says so."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from ideal_robot import row_log
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.ros_export import write_mcap, write_rosbag2
from ideal_robot.whole_file import OutputError, write_text
from scenes.commands import export, new
from scenes.cycle import CycleLog, CycleSettings, play_cycles
from scenes.result import silent
from tests.scenes.test_pinned_findings import Drifting


def test_an_arm_whose_log_finds_no_room_is_brought_to_rest_on_its_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is lost: rows that no file takes stay in memory."""
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(row_log, "KEPT", 512)
    monkeypatch.setattr(os, "pwrite", full)
    task, log = Drifting(sound=1e9, step=1e-4), CycleLog()
    play_cycles(task, Robot.load("kr6"), task, log, CycleSettings(5.0, 0.1, 20.0, 20.0, ""), silent)
    assert log.failure is not None
    assert "stopped on the path" in log.failure
    assert "make room" in log.failure
    commands = np.array(task.commands)
    assert 512 < len(commands) < 1000
    np.testing.assert_array_equal(np.array(log.q_c), commands)
    assert np.ptp(commands[-5:], axis=0).max() < 1e-9
    assert np.all(np.diff(commands, axis=0) > -1e-12)


def test_a_disk_that_becomes_read_only_is_told_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(path: Path, *_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system", str(path))

    monkeypatch.setattr(Path, "replace", read_only)
    monkeypatch.setattr(Path, "unlink", read_only)
    with pytest.raises(OutputError, match="Read-only"):
        write_text(tmp_path / "a.txt", "new")


def test_a_bag_that_finds_no_room_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SQLite has errors of its own; the other formats go through the same words."""
    t = 0.01 * np.arange(200)
    recording = Recording.from_arrays(t, q=np.sin(t)[:, None])

    def full(path: Path, *_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "rename", full)
    monkeypatch.setattr(Path, "replace", full)
    for write, name in ((write_rosbag2, "bag"), (write_mcap, "a.mcap")):
        with pytest.raises(OutputError, match="No space"):
            write(recording, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_new_scene_that_finds_no_room_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("weld.toml").write_text("mine")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("ideal_robot.whole_file.synchronise", full)
    with pytest.raises(OutputError):
        new.command("weld", force=True)
    assert Path("weld.toml").read_text() == "mine"


def test_places_of_an_export_are_tried_before_work_begins(tmp_path: Path) -> None:
    place = tmp_path / "a.mcap"
    place.mkdir()
    with pytest.raises(InputError, match="is a folder"):
        export.command(tmp_path / "absent.csv", mcap=place, csv=tmp_path / "x.csv")
    with pytest.raises(InputError, match="a bag is a new folder"):
        export.command(tmp_path / "absent.csv", rosbag2=place, csv=tmp_path / "x.csv")
