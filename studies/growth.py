"""How time and memory grow with length: following, pressing, sweeps, identification, diagnosis."""

from __future__ import annotations

import itertools
import os
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

from ideal_robot.diagnosis import diagnose
from ideal_robot.identification.whole_model import identify_model
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import ColumnStore
from ideal_robot.signals.recording import Recording
from scenes import load_scene, run_scene
from scenes.sweep import SweepFile, jobs, sweep
from studies.report import head, resident, row
from studies.speed import kr15_recording

LENGTHS = {"straight": 1.2, "force_wave": 0.8}
"""Lengths of the scenes' paths [m]; a longer play goes slower."""
PAUSE = 0.5
"""Time in which the logger is stopped and the arm goes back to where its minute begins [s]."""


def growth(line: str = "20,60", force: str = "20,60", runs: str = "3,6", record: str = "120,240",
           diagnosis: str = "120,240") -> None:
    """Processor time and memory over lengths: an hour of line, of pressing, a thousand runs, hours of recording.

    Lengths are separated by commas, an empty text leaves a kind out: seconds, of --runs numbers of runs of a sweep.
    Every length is played in a process of its own, forked from one that has loaded the program, and writes what
    `ideal-robot run --out` writes. The memory is by how much the resident one grew at most, pages of mapped files
    included. Where the slopes below the table are the same, time and memory are linear. An hour of line costs about 20
    minutes of processor time, of force about 15, and 2 GB of the folder for temporary files (TMPDIR).
    """
    head("", "processor time", "memory beyond the program's")
    slopes: list[str] = []
    for kind, unit, lengths, job in (("following a line", "s", line, lambda s: _played("straight", s)),
                                     ("20 N on a wavy surface", "s", force, lambda s: _played("force_wave", s)),
                                     ("sweep", "runs", runs, _sweep)):
        slopes += _rows(kind, unit, lengths, job)
    with tempfile.TemporaryDirectory() as folder:
        places = {length: Path(folder) / f"{length:g}.parquet" for length in _numbers(f"{record},{diagnosis}")}
        for length, place in places.items():
            _apart(lambda length=length, place=place: _write_recording(length, place))  # type: ignore[misc]
        kr15 = Robot.load("kr15")
        slopes += _rows("reading and identifying", "s", record,
                        lambda s: identify_model(Recording.read(places[s]), kr15, cascade=False))
        slopes += _rows("reading and diagnosing", "s", diagnosis, lambda s: diagnose(Recording.read(places[s]), kr15))
    print("\n" + "\n".join(slopes))


def _numbers(text: str) -> list[float]:
    return list(dict.fromkeys(float(piece) for piece in text.split(",") if piece))


def _rows(kind: str, unit: str, lengths: str, job: Callable[[float], object]) -> list[str]:
    """Prints a row for each length; gives the slopes from one to the next."""
    found = []
    for length in _numbers(lengths):
        seconds, megabytes = _apart(lambda length=length: job(length))  # type: ignore[misc]
        found.append((length, seconds, megabytes))
        row(f"{kind}, {length:g} {unit}", f"{seconds:.1f} s", f"{megabytes:.0f} MB")
    return [f"{kind}, {a:g} to {b:g} {unit}: {(t1 - t0) / (b - a):.2f} s and {1e3 * (m1 - m0) / (b - a):.0f} kB for one"
            for (a, t0, m0), (b, t1, m1) in itertools.pairwise(found)]


def _apart(job: Callable[[], object]) -> tuple[float, float]:
    """Processor time [s] and growth of the largest resident memory [MB] of a job in a process of its own."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            job()
            code = 0
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(code)
    _, status, usage = os.wait4(child, 0)
    if status:
        return float("nan"), float("nan")
    return usage.ru_utime + usage.ru_stime, 1.024e-3 * usage.ru_maxrss - 1.048576 * resident()


class _Told:
    """Says on the error output how far a run has come, every tenth."""

    def __init__(self) -> None:
        self._next = 0.1

    def __call__(self, fraction: float, text: str = "") -> None:
        if fraction >= self._next:
            print(f"    {100.0 * fraction:3.0f} % {text}", file=sys.stderr, flush=True)
            self._next = fraction + 0.1


def _played(scene: str, seconds: float) -> None:
    """Plays a scene so slowly that its path takes as long, and writes what a run writes."""
    with tempfile.TemporaryDirectory() as folder:
        run_scene(load_scene(scene), speed=LENGTHS[scene] / seconds, max_duration=2.0 * seconds,
                  out=Path(folder) / "out", progress=_Told())


def _sweep(count: float) -> None:
    """Short runs in one process."""
    scene = load_scene("straight").changed(line={"points": [[0.0, 0.0], [0.4, 0.0]]}, calibration={"by_moving": False})
    with tempfile.TemporaryDirectory() as folder:
        sweep(jobs([scene], seeds=range(1, round(count) + 1)), processes=1,
              file=SweepFile(Path(folder) / "l.jsonl", resume=False))


def _write_recording(seconds: float, place: Path) -> None:
    """A minute of the simulated KR 15 as often as it takes, with pauses between, in one file."""
    minute = kr15_recording(1, 60.0)
    rows, times = len(minute.t), max(1, round(seconds / 60.0))
    every = float(minute.t[1]) * rows + PAUSE
    store = ColumnStore(list(minute.columns), rows * times)
    for k in range(times):
        for name, values in minute.columns.items():
            store.fill(name, k * rows, values + (k * every if name == "t" else 0.0))
        store.release()
    Recording(store.finished(), minute.meta, "minutes").write(place)
