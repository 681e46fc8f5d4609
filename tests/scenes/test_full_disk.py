"""A disk that is full: an arm that moves is brought to rest, what was there before stays, and one line says so."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from ideal_robot import row_log
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.export import write_mcap, write_rosbag2
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import OutputError, write_text
from scenes.cli import ended_by
from scenes.commands.files import export, new
from scenes.models import prepared_model, shipped_model
from scenes.online.cycle import CycleLog, CycleSettings, play_cycles
from scenes.outputs import check_outputs, whole_folder
from scenes.report.video import write_video
from scenes.result import silent
from scenes.rsi.server import RsiRun
from scenes.sweep import SweepFile
from sim.arm.body import load_links, start_physics
from sim.arm.world import World
from sim.bullet import pybullet
from tests import sound
from tests.scenes.report.test_page import _replay
from tests.scenes.test_pinned_findings import Drifting
from tests.sources import files_of_at_most, no_room


def test_an_arm_whose_log_finds_no_room_is_brought_to_rest_on_its_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is lost: rows that no file takes stay in memory."""
    monkeypatch.setattr(row_log, "KEPT", 512)
    monkeypatch.setattr(os, "pwrite", no_room)
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
    monkeypatch.setattr(Path, "rename", no_room)
    monkeypatch.setattr(Path, "replace", no_room)
    for write, name in ((write_rosbag2, "bag"), (write_mcap, "a.mcap")):
        with pytest.raises(OutputError, match="No space"):
            write(recording, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_new_scene_that_finds_no_room_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("weld.toml").write_text("mine")
    monkeypatch.setattr("ideal_robot.whole_file.synchronise", no_room)
    with pytest.raises(OutputError):
        new("weld", force=True)
    assert Path("weld.toml").read_text() == "mine"


def test_places_of_an_export_are_tried_before_work_begins(tmp_path: Path) -> None:
    place = tmp_path / "a.mcap"
    place.mkdir()
    with pytest.raises(InputError, match="is a folder"):
        export(tmp_path / "absent.csv", mcap=place, csv=tmp_path / "x.csv")
    with pytest.raises(InputError, match="a bag is a new folder"):
        export(tmp_path / "absent.csv", rosbag2=place, csv=tmp_path / "x.csv")


# A limit on the size of files stands for a disk that is full: verbs say in one line what and what helps.

HELP = "raise the limit on the size of files"


def _recording(rows: int = 3000) -> Recording:
    rng = np.random.default_rng(1)
    return Recording.from_arrays(np.arange(float(rows)), q=rng.normal(size=(rows, 6)), q_d=rng.normal(size=(rows, 6)),
                                 q_c=rng.normal(size=(rows, 6)), tau=rng.normal(size=(rows, 6)))


def _served(*_: object, **__: object) -> Any:
    """A server of packets whose path has been played."""
    counts = dict.fromkeys(("lost", "repeated", "refused", "ignored", "late"), 0)
    run = RsiRun(_recording(), None, counts, {"median": 1.0, "max": 1.0}, [], 0, 3000, 3000, stamps="even")
    link = SimpleNamespace(axes=SimpleNamespace(known=True), address=("127.0.0.1", 1), counts=SimpleNamespace(cycles=0))
    return nullcontext(SimpleNamespace(link=link, warnings=(), stop=lambda: None, play=lambda **_: run))


@pytest.mark.parametrize("verb", ["detect", "sweep", "rsi", "precorrect"])
def test_a_verb_says_in_one_line_what_and_what_helps(verb: str, program, tmp_path: Path,
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    picture = np.full((200, 300), 255, np.uint8)
    cv2.line(picture, (0, 100), (299, 120), 0, 8)
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    (tmp_path / "p.csv").write_bytes(sound.csv_bytes(sound.joint_path()))
    (tmp_path / "s.toml").write_bytes(sound.PATH)
    words = {"detect": ["a.png", "--out", "o"], "sweep": ["s.toml", "--seeds", "1-6", "--csv", "c.csv"],
             "rsi": ["p.csv", "--robot", "kr6", "--record", "c.csv"],
             "precorrect": ["p.csv", "--model", str(shipped_model("kr6")), "-o", "c.csv", "--out", "o"]}[verb]
    monkeypatch.setattr("scenes.rsi.server.rsi_server", _served)
    # Played in this process, which has loaded the program.
    monkeypatch.setattr("scenes.sweep.work_off", lambda tasks, play, *_: enumerate(map(play, tasks)))
    # Once with room: what is compiled is kept then.
    program(verb, *words, "--json", "j.json")
    for name in ("o/report.html", "j.json", "c.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("previous")
    before = sorted(tmp_path.rglob("*"))
    with files_of_at_most(5000):
        done = program(verb, *words, "--json", "j.json")
    assert done.code == 1
    line = [line for line in done.lines if line.startswith("ideal-robot:")][-1]
    assert HELP in line
    assert ".part" not in line
    assert any(name in line for name in ("o/report.html", "j.json", "c.csv"))
    assert sorted(tmp_path.rglob("*")) == before
    assert {(tmp_path / name).read_text() for name in ("o/report.html", "j.json", "c.csv")} == {"previous"}


def test_a_folder_s_error_names_the_file_in_it_by_its_place(tmp_path: Path) -> None:
    def write() -> None:
        with whole_folder(tmp_path / "run") as new:
            _recording().write(new / "recording.parquet")

    with files_of_at_most(5000), pytest.raises(OutputError) as refused:
        write()
    assert str(refused.value).startswith(f"{tmp_path / 'run' / 'recording.parquet'}: cannot be written (File too large")
    assert not list(tmp_path.iterdir())


def test_an_answer_that_finds_no_room_leaves_the_whole_ones_before_it(tmp_path: Path) -> None:
    file = SweepFile(tmp_path / "l.jsonl", resume=False)

    def fill() -> None:
        for seed in range(1000):
            file.add({"seed": seed}, {"scene": "line", "method": None, "seed": seed, "failure": None})

    with files_of_at_most(2000), pytest.raises(OutputError, match="--resume"):
        fill()
    lines = (tmp_path / "l.jsonl").read_text().splitlines()
    assert [json.loads(line)["job"]["seed"] for line in lines] == list(range(len(lines)))
    assert len(lines) > 5
    assert len(SweepFile(tmp_path / "l.jsonl", resume=True).answers) == len(lines)


@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_a_film_that_finds_no_room_leaves_the_old_one(ending: str, tmp_path: Path) -> None:
    """OpenCV tells nobody."""
    short = dataclasses.replace(_replay(60), t=np.linspace(0.0, 0.5, 60))
    film = tmp_path / f"run{ending}"
    film.write_text("previous")
    with files_of_at_most(6000), pytest.raises(OutputError, match="cannot be written"):
        write_video(short, film, rate=10.0, slow=1.0)
    assert film.read_text() == "previous"
    assert list(tmp_path.iterdir()) == [film]


def test_a_disk_without_room_is_found_before_work_begins(tmp_path: Path) -> None:
    with files_of_at_most(0), pytest.raises(InputError, match="cannot be written") as refused:
        check_outputs({"--out": tmp_path / "o"})
    assert refused.value.field == "--out"


def test_a_cache_folder_that_cannot_be_written_is_told_before_the_arm_moves(tmp_path: Path,
                                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cache").write_text("a file")
    monkeypatch.setenv("IDEAL_ROBOT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("scenes.identification.own_model.identified_model", lambda *_, **__: pytest.fail("moved"))
    with pytest.raises(InputError, match="IDEAL_ROBOT_CACHE"):
        prepared_model(Robot.load("kr6"), World.default("kr6"))


def test_a_recording_s_ending_is_refused_before_the_arm_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    from scenes.commands.devices import RsiOptions, rsi

    monkeypatch.setattr("scenes.rsi.server.rsi_server", lambda *_, **__: pytest.fail("moved"))
    with pytest.raises(InputError, match=r"\.parquet or \.csv"):
        rsi(RsiOptions(path=Path("p.csv"), record=Path("moved.txt")))


def test_a_full_folder_for_temporary_files_is_named_with_what_helps() -> None:
    client = start_physics()
    try:
        with files_of_at_most(0), pytest.raises(OutputError, match="TMPDIR"):
            load_links(Robot.load("kr6").pinocchio, client)
    finally:
        pybullet.disconnect(client)


def test_a_full_disk_that_nobody_foresaw_is_told_with_what_helps(capsys: pytest.CaptureFixture[str]) -> None:
    """E.g. where numba keeps compiled code; the system's error has no name then."""
    assert ended_by(OSError(errno.ENOSPC, "No space left on device")) == 1
    message = capsys.readouterr().err
    assert "NUMBA_CACHE_DIR" in message
    assert "make room" in message


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
def test_a_disk_that_is_full_under_the_output_is_named() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-m", "scenes.cli", "--help"], stdout=full, stderr=subprocess.PIPE,
                              text=True, check=False)
    assert done.returncode == 1
    assert "standard output: cannot be written" in done.stderr
    assert done.stderr.count("\n") == 1
