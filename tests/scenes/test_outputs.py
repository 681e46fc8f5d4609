"""Results are there whole or not at all, whatever ends the program; places that cannot be written are told first."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import OutputError, whole_file, whole_files, write_text
from scenes.outputs import check_outputs, folders_held, whole_folder
from scenes.report.page import write_json
from tests import sound
from tests.sources import files_of_at_most, no_room

WRITER = """
import sys
from pathlib import Path
from ideal_robot.whole_file import whole_file
from scenes.outputs import whole_folder
folder = Path(sys.argv[1])
print("ready", flush=True)
for turn in range(100_000):
    with whole_folder(folder / "run") as new:
        for name in ("a", "b", "c"):
            (new / name).write_text(f"{turn}\\n" * 2000)
    with whole_file(folder / "single") as partial:
        partial.write_text(f"{turn}\\n" * 2000)
"""


def _visible(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


@pytest.mark.parametrize("after", np.random.default_rng(5).uniform(0.0, 0.08, 6))
def test_a_killed_writer_leaves_one_generation_of_whole_files(after: float, tmp_path: Path) -> None:
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    writer.stdout.readline()
    while not (tmp_path / "single").exists():
        time.sleep(0.001)
    (tmp_path / "run" / "kept").write_text("of the user")
    time.sleep(after)
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    single = (tmp_path / "single").read_text().splitlines()
    assert len(single) == 2000
    assert len(set(single)) == 1
    lines = [line for name in ("a", "b", "c") for line in (tmp_path / "run" / name).read_text().splitlines()]
    assert len(lines) == 6000
    assert len(set(lines)) == 1
    assert _visible(tmp_path) == ["run", "single"]


def test_other_files_of_the_folder_stay_and_the_own_ones_change_together(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "a").write_text("old")
    with whole_folder(folder) as new:
        (new / "a").write_text("new")
        assert (folder / "a").read_text() == "old"
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"notes.txt": "mine", "a": "new"}
    assert _visible(tmp_path) == ["run"]
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("kind", ["working folder", "with folders", "link"])
def test_folders_that_must_stay_take_the_files_one_by_one(kind: str, tmp_path: Path,
                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    if kind == "working folder":
        monkeypatch.chdir(folder)
        folder = Path(".")
    if kind == "with folders":
        (folder / "sub").mkdir()
    if kind == "link":
        (tmp_path / "link").symlink_to(folder)
        folder = tmp_path / "link"
    identity = folder.stat().st_ino
    with whole_folder(folder) as new:
        (new / "a").write_text("new")
    assert (folder / "a").read_text() == "new"
    assert folder.stat().st_ino == identity
    assert not [path for path in tmp_path.rglob(".*") if path.name != "."]


def test_an_error_or_an_interrupt_leaves_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "one").write_text("old")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "a").write_text("old")

    def files(error: type[BaseException]) -> None:
        with whole_files(tmp_path / "one", None, tmp_path / "two") as (one, none, two):
            assert none is None
            one.write_text("new")
            two.write_text("new")
            raise error

    def folder(error: type[BaseException]) -> None:
        with whole_folder(tmp_path / "run") as new:
            (new / "a").write_text("new")
            raise error

    for write in (files, folder):
        for error in (ValueError, KeyboardInterrupt):
            with pytest.raises(error):
                write(error)
    assert (tmp_path / "one").read_text() == "old"
    assert (tmp_path / "run" / "a").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one", "run"]


def test_a_full_disk_keeps_the_previous_result_and_says_so_in_one_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    recording = Recording.from_arrays(np.arange(5000.0), q=rng.normal(size=(5000, 6)))
    previous = dict.fromkeys(("a.parquet", "a.csv", "a.json"), "previous")

    def write_figures(path: Path) -> None:
        write_json(path, {"x": rng.normal(size=5000)})

    for name in previous:
        (tmp_path / name).write_text("previous")
    for name, write in zip(previous, (recording.write, recording.write, write_figures), strict=True):
        with files_of_at_most(4096), pytest.raises(OutputError, match=r"cannot be written [^\n]*$"):
            write(tmp_path / name)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == previous


def test_two_runs_into_one_folder_do_not_mix(tmp_path: Path) -> None:
    failures: list[BaseException] = []

    def write(word: str) -> None:
        try:
            for _ in range(30):
                with whole_folder(tmp_path / "run") as new:
                    for name in "abc":
                        (new / name).write_text(word)
        except BaseException as error:
            failures.append(error)

    runs = [threading.Thread(target=write, args=(word,)) for word in ("one", "two", "three")]
    for thread in runs:
        thread.start()
    while any(thread.is_alive() for thread in runs):
        try:
            descriptor = os.open(tmp_path / "run", os.O_RDONLY)
        except FileNotFoundError:
            continue
        try:
            words = {_read(name, descriptor) for name in os.listdir(descriptor)}
        except FileNotFoundError:
            continue  # the generation that was opened has just been removed
        finally:
            os.close(descriptor)
        assert len(words) <= 1
    assert not failures
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def _read(name: str, folder: int) -> bytes:
    file = os.open(name, os.O_RDONLY, dir_fd=folder)
    try:
        return os.read(file, 10)
    finally:
        os.close(file)


def test_places_that_cannot_be_written_are_told_by_option_and_nothing_is_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for places, option in (
        ({"json": tmp_path / "folder"}, "--json"), ({"json": tmp_path / "file" / "a.json"}, "--json"),
        ({"folders": {"--out": tmp_path / "file"}}, "--out"), ({"json": Path("/proc/none/a.json")}, "--json"),
        ({"json": Path("/dev/null")}, "--json"), ({"export_urdf": Path("/dev/full/a")}, "--export-urdf"),
        ({"json": tmp_path / ("x" * 300)}, "--json"),
        ({"folders": {"--out": tmp_path / ("x" * 300)}}, "--out"), ({"json": tmp_path / "a\0b"}, "--json"),
        ({"json": tmp_path / "same", "csv": tmp_path / "folder" / ".." / "same"}, "--csv"),
    ):
        with pytest.raises(InputError) as refused:
            check_outputs(**places)
        assert refused.value.field == option
    check_outputs({"--out": tmp_path / "new" / "deep"}, json=tmp_path / "other" / "a.json", csv=None)
    assert _visible(tmp_path) == ["file", "folder"]


def test_a_file_that_is_written_anew_keeps_its_rights_and_a_new_one_has_the_usual_ones(tmp_path: Path) -> None:
    usual, private, new = (tmp_path / name for name in ("usual", "private", "new"))
    for path in (usual, private):
        path.touch()
    private.chmod(0o600)
    for path in (usual, private, new):
        write_text(path, "x")
    assert [path.stat().st_mode & 0o777 for path in (private, new)] == [0o600, usual.stat().st_mode & 0o777]


def test_a_device_or_pipe_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(OutputError, match="pipe"), whole_file(pipe) as partial:
        partial.write_text("x")
    assert pipe.is_fifo()


def test_a_folder_that_vanishes_while_writing_is_an_error_of_one_line(tmp_path: Path) -> None:
    def write() -> None:
        with whole_file(tmp_path / "gone" / "a") as partial:
            partial.parent.rmdir()
            partial.write_text("x")

    with pytest.raises(OutputError, match="cannot be written"):
        write()


def test_what_killed_runs_left_is_removed_after_a_day(tmp_path: Path) -> None:
    old, young = tmp_path / ".a.json.0123.part", tmp_path / ".a.json.4567.part"
    for path in (old, young):
        path.mkdir()
        (path / "a.json").write_text("")
    os.utime(old, (0, 0))
    write_text(tmp_path / "a.json", "{}")
    assert sorted(path.name for path in tmp_path.iterdir()) == [young.name, "a.json"]


@pytest.mark.parametrize("failing", [False, True])
def test_a_folder_waits_for_the_file_that_is_written_after_it(failing: bool, tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "run"
    with suppress(KeyError), folders_held():
        with whole_folder(folder) as new:
            (new / "a").write_text("new")
        assert not folder.exists()
        if failing:
            raise KeyError
    assert folder.exists() != failing
    assert _visible(tmp_path) == ([] if failing else ["deep"])


def test_folders_that_were_made_for_a_result_go_with_it(tmp_path: Path) -> None:
    for write in (whole_file, whole_folder):
        with suppress(KeyError), write(tmp_path / "kept" / "models" / "m"):
            raise KeyError
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["a\udcffb", "a\udcffb/c"])
def test_a_name_that_is_no_text_is_refused_before_work_begins(place: str, tmp_path: Path) -> None:
    for folders, file in (({"--out": tmp_path / place}, None), ({}, tmp_path / place)):
        with pytest.raises(InputError, match="cannot be written"):
            check_outputs(folders, json=file)


@pytest.mark.parametrize("verb", ["run", "compare", "plan-identification",
                                  pytest.param("close-loop", marks=pytest.mark.slow)])
def test_figures_that_find_no_room_leave_the_previous_folder(verb: str, program, tmp_path: Path,
                                                             monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the file of figures, which is written last, the folder knew nothing: it was the new one already."""
    sound.arm(tmp_path)
    (tmp_path / "path.toml").write_bytes(sound.PATH)
    (tmp_path / "clamped.toml").write_bytes(sound.CLAMPED)
    (tmp_path / "close.toml").write_bytes(sound.CLOSE_CLAMPED)
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "report.html").write_text("previous")
    words = {"run": ["path.toml"], "compare": ["clamped.toml"], "close-loop": ["close.toml"],
             "plan-identification": ["--urdf", "arm.urdf", "--period", "2", "--z-min", "-5"]}[verb]
    before = sorted(tmp_path.rglob("*"))

    def full(path: Path, content: dict[str, Any]) -> None:
        if path.name != "report.json":
            raise OutputError("j.json: cannot be written (No space left on device)")

    monkeypatch.setattr("scenes.report.page.write_json", full)
    assert program(verb, *words, "--out", "o", "--json", "j.json").code == 1
    # The model of a round that was done stays, as it does where a closing is interrupted.
    assert sorted({*tmp_path.rglob("*")} - {tmp_path / "o" / "extended_model.json"}) == before
    assert (tmp_path / "o" / "report.html").read_text() == "previous"


@pytest.mark.parametrize("verb", ["identify", "run"])
def test_a_verb_whose_disk_is_full_keeps_the_previous_result_and_says_so_in_one_line(
        verb: str, program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sound.arm(tmp_path)
    (tmp_path / "r.csv").write_bytes(sound.csv_bytes(sound.motion(tmp_path)))
    (tmp_path / "s.toml").write_bytes(sound.PATH)
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "report.html").write_text("previous")
    (tmp_path / "j.json").write_text("previous")
    before = sorted(path.name for path in tmp_path.rglob("*"))
    words = {"identify": ["identify", "r.csv", "--urdf", "arm.urdf", "--friction", "viscous_coulomb"],
             "run": ["run", "s.toml"]}[verb]

    for module in ("ideal_robot.whole_file", "scenes.outputs"):
        monkeypatch.setattr(f"{module}.synchronise", no_room)
    done = program(*words, "--out", "o", "--json", "j.json")
    assert done.code == 1
    (message,) = [line for line in done.lines if line.startswith("ideal-robot:")]
    assert "No space left on device" in message
    assert (tmp_path / "o" / "report.html").read_text() == (tmp_path / "j.json").read_text() == "previous"
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


def test_a_folder_called_like_a_home_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with whole_file("~/a.parquet") as partial:
        pd.DataFrame({"a": [1]}).to_parquet(partial)
    assert (tmp_path / "~" / "a.parquet").is_file()
