"""A sweep goes on whatever happens to one run or one process, leaves nothing behind, and can be gone on with."""

from __future__ import annotations

import ctypes
import faulthandler
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from scenes import workers
from scenes.commands.common import numbers, whole_numbers
from scenes.regression.comparison import bounds_of, compared
from scenes.regression.results import CASE, Results, RunSet, read_results
from scenes.scene_file import load_scene
from scenes.scene_files.scene import Scene
from scenes.sweep import Job, SweepFile, jobs, play, sweep
from scenes.workers import LostError, work_off
from tests.sources import ROOT, free_port

WORK = jobs(["line", "straight"], seeds=[1, 2])


def answer(job: Job) -> dict[str, Any]:
    return {"scene": job.scene, "method": job.method, "seed": job.seed, "failure": None}


def _killed_once(folder: str) -> str:
    """Kills its process the first time it is called for a folder."""
    mark = Path(folder) / "begun"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def _always_killed(task: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_lost_process_is_replaced_and_its_task_done_by_another(tmp_path: Path) -> None:
    folders = [str(tmp_path / str(i)) for i in range(4)]
    for folder in folders:
        Path(folder).mkdir()
    assert dict(work_off(folders, _killed_once, 2)) == dict.fromkeys(range(4), "done")


def _own_number(task: int) -> int:
    return os.getpid()


@pytest.mark.parametrize("limit", [1e7, 1e20])
def test_a_limit_beyond_what_the_system_counts_is_one(limit: float) -> None:
    assert dict(work_off([1, 2], abs, 1, limit)) == {0: 1, 1: 2}


def test_a_process_is_replaced_after_its_share_of_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "TASKS", 2)
    numbers_of = dict(work_off(list(range(5)), _own_number, 1))
    assert [len({numbers_of[i] for i in pair}) for pair in ((0, 1), (2, 3), (0, 2, 4))] == [1, 1, 3]


def test_a_task_that_ends_every_process_is_an_answer_among_the_others() -> None:
    ((index, lost),) = work_off(["x"], _always_killed, 2)
    assert index == 0
    assert isinstance(lost, LostError)
    assert "-9" in str(lost)
    (row,) = sweep(WORK[:1], processes=1, function=_always_killed)  # type: ignore[arg-type]
    assert row["scene"] == "line"
    assert "lost" in row["failure"]


def _poisoned_in_its_way(way: str) -> str:
    if way == "hangs":
        time.sleep(600.0)
    if way == "crashes":
        faulthandler.disable()
        ctypes.string_at(0)
    if way == "takes all memory":
        blocks = []
        while True:
            blocks.append(np.empty(2**27))
    return way


def test_a_task_that_hangs_crashes_or_takes_all_memory_costs_only_itself() -> None:
    tasks = ["a", "hangs", "crashes", "takes all memory", "b"]
    done = dict(work_off(tasks, _poisoned_in_its_way, 2, limit=3.0))
    assert (done[0], done[4]) == ("a", "b")
    assert [str(done[i]).partition("2 times ")[2] for i in (1, 2, 3)] == [
        "(did not end within 3 s)", "(exit code -11)", "(no memory)"]


def test_a_scene_that_cannot_be_played_is_a_row_with_its_reason() -> None:
    row = play(Job("line", None, 50.0, None))
    assert row["scene"] == "line"
    assert "speed" in row["failure"]
    row = play(Job("iso9283_3", None, 5.0, None))
    # Without its method and world it is no case of the baseline, and a broken program passes its check.
    assert [row[name] for name in CASE] == ["iso9283_3", "kr15", 1, "bench", 5.0, "ideal"]
    assert "too short for this speed" in row["failure"]
    row = play(Job("line", "magic", None, None))
    assert "method" in row["failure"]


def test_a_method_that_none_of_the_scenes_has_is_refused_before_anything_is_played() -> None:
    with pytest.raises(InputError, match="expected one of") as refused:
        sweep(jobs(["line", "iso9283_1"], methods=["ideal", "magic"]), function=_always_killed)  # type: ignore[arg-type]
    assert refused.value.value == "magic"
    # What one of them has is played: the others say that they do not have it.
    rows = sweep(jobs(["line", "iso9283_1"], methods=["sensor_path"]), processes=1, function=answer)
    assert len(rows) == 2


def test_two_files_with_scenes_of_one_name_are_refused(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "p.toml").write_text(Path(load_scene("straight").source).read_text())
    paths = [str(tmp_path / place) for place in ("a/p.toml", "a/../a/p.toml", "b/p.toml")]
    assert len(sweep(jobs(paths[:2]), processes=1, function=answer)) == 2
    with pytest.raises(InputError, match=r"two scenes of the name 'p': .*a/p.toml and .*b/p.toml; give one another"):
        sweep(jobs(paths), processes=1, function=answer)


def test_a_delay_that_became_a_lead_is_no_progress() -> None:
    before, after = (Results.of([{"scene": "line", "seed": seed, "path_error_mm": {"delay_ms": delay}}
                                 for seed in range(3)]) for delay in (0.1, -40.0))
    assert compared(before, after, figures=["path_error_mm.delay_ms"]).verdict == "worse"
    assert not bounds_of(after, [{"path_error_mm.delay_ms": 1.0}] * 3)[0].kept


def test_an_ended_sweep_goes_on_where_it_was(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    sweep(WORK[:3], function=answer, file=SweepFile(path, resume=False))
    with path.open("a") as file:
        file.write('{"job": {"scene": "str')  # killed while writing
    with pytest.raises(InputError, match="--resume"):
        SweepFile(path, resume=False)
    played: list[int] = []
    rows = sweep(WORK, function=answer, file=SweepFile(path, resume=True), done=lambda count, _: played.append(count))
    assert played == [4]
    assert rows == [answer(job) for job in WORK]
    assert len([json.loads(line) for line in path.read_text().splitlines()]) == 4


def test_a_run_is_played_again_where_a_file_that_its_scene_names_is_another_one(tmp_path: Path) -> None:
    kr6 = Robot.load("kr6").urdf
    drawn, arm = tmp_path / "wave.svg", tmp_path / "arm.urdf"
    drawn.write_text("M 0 0 L 300 0")
    arm.write_text(kr6.read_text())
    (tmp_path / "arm.toml").write_text(kr6.with_suffix(".toml").read_text())
    scene = load_scene("line").beside(tmp_path)
    line = scene.line.model_dump() | {"formula": None, "length": None, "points": None, "svg": "wave.svg"}
    work = jobs([scene.changed(line=line, robot=robot) for robot in ("kr6", str(arm))])
    played: list[int] = []

    def swept() -> int:
        played.clear()
        sweep(work, function=_scene_answer, file=SweepFile(tmp_path / "runs.jsonl", resume=True),
              done=lambda count, _: played.append(count))
        return len(played)

    assert (swept(), swept()) == (2, 0)
    arm.write_text(kr6.read_text() + "\n")
    assert swept() == 1
    drawn.write_text("M 0 0 L 300 10")
    assert swept() == 2


def _scene_answer(job: Job) -> dict[str, Any]:
    assert isinstance(job.scene, Scene)
    return {**answer(job), "scene": job.scene.name}


def test_a_file_that_is_none_of_a_sweep_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    good = {"scene": "line", "method": None, "seed": 1, "failure": None}
    of_no_table = ({"scene": []}, {"seed": {}}, {"failure": 3}, {"speed_m_s": "x"}, {"control_error_mm": [1]},
                   {"control_error_mm": {"mean": 10**400}})
    for text in ("3\n", "{}\n", "[" * 100_000 + "\n", '{"job": 1}\n', "\0\n",
                 *(json.dumps({"job": 1, "answer": good | wrong}) + "\n" for wrong in of_no_table)):
        path.write_text(text)
        with pytest.raises(InputError, match="not of a sweep"):
            SweepFile(path, resume=True)


SLEEPING = """
import signal, sys, time
from pathlib import Path
from scenes.workers import work_off
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background of a shell
def rest(task):
    Path(sys.argv[1], str(task)).touch()
    while True:
        time.sleep(0.01)
for _ in work_off([1, 2], rest, 2):
    pass
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_its_parent(how: signal.Signals, tmp_path: Path) -> None:
    parent = subprocess.Popen([sys.executable, "-c", SLEEPING, str(tmp_path)], stderr=subprocess.DEVNULL)
    while len(list(tmp_path.iterdir())) < 2:
        time.sleep(0.01)
    children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
    assert len(children) == 2
    parent.send_signal(how)
    parent.wait(timeout=20)
    for _ in range(1000):
        if not any(Path(f"/proc/{child}").exists() for child in children):
            return
        time.sleep(0.02)
    pytest.fail("a worker is left")


@pytest.mark.parametrize("text", ["nan", "inf", "1,nan", "x", "1e400", "--"])
def test_speeds_that_are_no_numbers_are_refused(text: str) -> None:
    with pytest.raises(InputError):
        numbers(text, "--speeds")


@pytest.mark.parametrize("text", ["nan", "inf", "1.5", "-3", "5-2", "1-99999999999", "9" * 30, "1-nan", "x"])
def test_seeds_that_are_no_whole_numbers_are_refused(text: str) -> None:
    with pytest.raises(InputError) as refused:
        whole_numbers(text, "--seeds")
    assert refused.value.field == "--seeds"
    assert whole_numbers("1-3, 7", "--seeds") == [1, 2, 3, 7]


def _no_memory(task: object) -> None:
    raise MemoryError


@pytest.mark.parametrize("function", [_always_killed, _no_memory])
def test_what_was_not_played_is_not_believed_by_the_next_sweep(function: Any, tmp_path: Path) -> None:
    lines = tmp_path / "lines.jsonl"
    rows = sweep(WORK[:2], processes=2, function=function, file=SweepFile(lines, resume=True))
    assert all("not_played" in row and row["failure"].startswith("not played: its process was lost") for row in rows)
    assert not lines.exists()
    rows = sweep(WORK[:2], processes=1, function=answer, file=SweepFile(lines, resume=True))
    assert [row["failure"] for row in rows] == [None, None]
    assert len(SweepFile(lines, resume=True).answers) == 2


def test_a_cluster_without_workers_is_not_waited_for_for_ever(monkeypatch, tmp_path: Path) -> None:
    distributed = pytest.importorskip("dask.distributed")
    monkeypatch.setattr(workers, "PATIENCE", 1.0)
    monkeypatch.setattr(workers, "_ANSWERS", 0.2)
    lines = tmp_path / "lines.jsonl"
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as nobody:
        rows = sweep(WORK, dask=nobody.scheduler_address, function=answer, file=SweepFile(lines, resume=True))
    assert [row["not_played"] for row in rows] == ["the cluster was without a worker for 1 s"] * 4
    assert not lines.exists()


def _waits(job: Job) -> dict[str, Any]:
    time.sleep(0.0 if job.seed == 1 else 60.0)
    return answer(job)


def cluster(port: int, *more: str) -> list[subprocess.Popen[bytes]]:
    """A scheduler and its worker, each a process."""
    own = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    dask = [sys.executable, "-m", "dask"]
    return [subprocess.Popen([*dask, *words, "--no-dashboard"], stderr=subprocess.DEVNULL, env=own)
            for words in (["scheduler", "--host", "127.0.0.1", "--port", str(port)],
                          ["worker", f"tcp://127.0.0.1:{port}", "--nthreads", "1", *more])]


def swept_until_the_scheduler_dies(folder: Path) -> tuple[list[dict[str, Any]], Path]:
    """Three runs on a cluster whose scheduler is killed after the first: their rows, and the file of lines."""
    lines, port = folder / "lines.jsonl", free_port()
    started = cluster(port, "--no-nanny")
    try:
        return sweep(jobs(["line"], seeds=[1, 2, 3]), dask=f"tcp://127.0.0.1:{port}", function=_waits,
                     file=SweepFile(lines, resume=True), done=lambda count, _: started[0].kill()), lines
    finally:
        for process in started:
            process.kill()


@pytest.mark.slow
def test_what_a_dead_scheduler_has_lost_is_played_by_the_next_sweep(tmp_path: Path,
                                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("dask.distributed")
    monkeypatch.setattr(workers, "PATIENCE", 8.0)
    rows, lines = swept_until_the_scheduler_dies(tmp_path)
    assert rows[0]["failure"] is None
    assert ["not_played" in row for row in rows] == [False, True, True]
    assert len(SweepFile(lines, resume=True).answers) == 1


@pytest.mark.slow
def test_dask_goes_on_when_a_worker_is_killed(tmp_path: Path) -> None:
    distributed = pytest.importorskip("dask.distributed")
    folders = [tmp_path / str(i) for i in range(4)]
    for folder in folders:
        folder.mkdir()
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as workers:
        work = [Job("line", folder, None, None) for folder in folders]
        rows = sweep(work, dask=workers.scheduler_address, function=_killed_once_job)
    assert [row["failure"] for row in rows] == [None] * 4


def _killed_once_job(job: Job) -> dict[str, Any]:
    """Kills its worker the first time it is called for the folder that stands in place of the method."""
    return {"scene": job.scene, "failure": None if _killed_once(str(job.method)) == "done" else "?"}


# A Parquet data set that grows while the sweep runs; a cluster that loses its scheduler.

def test_a_data_set_grows_can_be_queried_and_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scenes.regression.results.PART", 2)
    folder, counts = tmp_path / "runs", []

    def look(count: int, answer: dict[str, Any]) -> None:
        counts.append(sum(len(pd.read_parquet(path)) for path in folder.rglob("*.parquet")))

    rows = sweep(WORK[:3], processes=1, function=measured, file=RunSet(folder, resume=False), done=look)
    assert counts == [0, 2, 2]
    assert read_results(folder).runs["control_error_mm.mean"].tolist() == [1 / 3, 2 / 3, 1 / 3]
    with pytest.raises(InputError, match="--resume"):
        RunSet(folder, resume=False)
    again = sweep(WORK, processes=1, function=_always_killed_but_last, file=RunSet(folder, resume=True))  # type: ignore[arg-type]
    assert again[:3] == rows
    assert len(RunSet(folder, resume=True).answers) == 4


def measured(job: Job) -> dict[str, Any]:
    return {**answer(job), "control_error_mm": {"mean": (job.seed or 0) / 3}}


def _always_killed_but_last(job: Job) -> dict[str, Any]:
    return measured(job) if (job.scene, job.seed) == ("straight", 2) else _always_killed(job)  # type: ignore[return-value]


def test_what_a_killed_sweep_left_between_tail_and_part_is_there_once(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    first = RunSet(folder, resume=False)
    for seed in (1, 2):
        first.add({"seed": seed}, measured(Job("line", None, None, seed)))
    tail = (folder / "open.jsonl").read_bytes()
    first.close()
    (folder / "open.jsonl").write_bytes(tail)
    second = RunSet(folder, resume=True)
    assert len(second.answers) == 2
    second.close()
    assert len(read_results(folder).runs) == 2
    (folder / "scene=line" / "part-0.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="part-0"):
        RunSet(folder, resume=True)


@pytest.mark.slow
def test_a_scheduler_that_comes_back_gets_what_is_left_and_a_poisoned_task_costs_no_other() -> None:
    pytest.importorskip("dask.distributed")
    port = free_port()
    started = cluster(port)

    def restarted(count: int, answer: dict[str, Any]) -> None:
        if count == 20:
            started[0].kill()
            started[1].terminate()
            started.extend(cluster(port))

    try:
        rows = sweep(jobs(["line"], seeds=range(40)), dask=f"tcp://127.0.0.1:{port}", function=poisoned, done=restarted,
                     limit=5.0)
    finally:
        for process in started:
            process.terminate()
            process.wait(20)
    assert [row["seed"] for row in rows if "not_played" in row] == [30, 35]
    assert [row["control_error_mm"]["mean"] for row in rows if "not_played" not in row] == [
        seed / 3 for seed in range(40) if seed not in (30, 35)]


def poisoned(job: Job) -> dict[str, Any]:
    if job.seed == 30:
        os._exit(1)
    if job.seed == 35:
        time.sleep(600.0)
    time.sleep(0.05)
    return measured(job)
