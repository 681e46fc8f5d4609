"""How time and memory grow: following a line and pressing on a surface, sweeps, identification of long recordings.

    python benchmarks/long_runs.py                                    # short ones, in minutes
    python benchmarks/long_runs.py --line 60,3600 --force 60,3600 --runs 10,1000 --record 600,14400

Every length is played in a process of its own, forked from one that has loaded the program; recording, replay and
page are written as ``ideal-robot run --out`` writes them. The table gives processor time, and by how much the resident
memory grew at most, pages of files that are mapped included. Below it stand the slopes from each length to the next:
where they are the same, time and memory are linear. How far a length has come is told on the error output. An hour of
line costs about 20 minutes of processor time, of force about 15, and 2 GB of the folder for temporary files
(``TMPDIR``).
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


import ideal_robot as ir  # noqa: E402
from benchmarks import bench_identify  # noqa: E402
from ideal_robot.robots.robot import Robot  # noqa: E402
from ideal_robot.row_log import ColumnStore  # noqa: E402
from ideal_robot.signals.recording import Recording  # noqa: E402
from scenes import load_scene, run_scene  # noqa: E402
from scenes.sweep import (  # noqa: E402
    SweepFile,
    jobs,
    sweep,
)

LINE, FORCE = 1.2, 0.8
"""Lengths of the paths [m]; a longer play goes slower."""
PAUSE = 0.5
"""Time in which the logger is stopped and the arm goes back to where its minute begins [s]."""


def apart(job: Callable[[], object]) -> tuple[float, float]:
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
    before = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return usage.ru_utime + usage.ru_stime, (1024.0 * usage.ru_maxrss - before) / 1e6


def table(kind: str, unit: str, lengths: list[float], job: Callable[[float], object]) -> None:
    """Rows of one kind of work, and the slopes."""
    found = []
    for length in lengths:
        seconds, megabytes = apart(lambda length=length: job(length))  # type: ignore[misc]
        found.append((length, seconds, megabytes))
        print(f"{kind:34s} {length:8g} {unit:8s} {seconds:9.1f} s {megabytes:9.0f} MB", flush=True)
    for (a, t0, m0), (b, t1, m1) in itertools.pairwise(found):
        print(f"{'':34s} {a:g} to {b:g}: {1e3 * (t1 - t0) / (b - a):.1f} ms and {1e3 * (m1 - m0) / (b - a):.0f} kB "
              f"a {unit}", flush=True)


class Told:
    """Says on the error output how far a run has come, every tenth."""

    def __init__(self) -> None:
        self._next = 0.1

    def __call__(self, fraction: float, text: str = "") -> None:
        if fraction >= self._next:
            print(f"    {100.0 * fraction:3.0f} % {text}", file=sys.stderr, flush=True)
            self._next = fraction + 0.1


def played(scene: str, seconds: float, length: float) -> None:
    """Plays a scene so slowly that its path takes as long, and writes what a run writes.

    Args:
        scene: its name.
        seconds: wanted [s].
        length: of its path [m].
    """
    with tempfile.TemporaryDirectory() as folder:
        run_scene(load_scene(scene), speed=length / seconds, max_duration=2.0 * seconds, out=Path(folder) / "out",
                  progress=Told())


def follow_line(seconds: float) -> None:
    """Follows a straight line for so long."""
    played("straight", seconds, LINE)


def press(seconds: float) -> None:
    """Presses along the wavy surface for so long."""
    played("force_wave", seconds, FORCE)


def many(count: float) -> None:
    """A sweep of short runs in one process."""
    with tempfile.TemporaryDirectory() as folder:
        scene = load_scene("straight").changed(line={"points": [[0.0, 0.0], [0.4, 0.0]]},
                                               calibration={"by_moving": False})
        sweep(jobs([scene], seeds=range(1, round(count) + 1)), processes=1,
              file=SweepFile(Path(folder) / "l.jsonl", resume=False))


def write_recording(seconds: float, place: Path) -> None:
    """A minute of the simulated KR 15 as often as it takes, with pauses between, in one file."""
    minute = bench_identify.recording(1, 60.0)
    rows, times = len(minute.t), max(1, round(seconds / 60.0))
    every = float(minute.t[1]) * rows + PAUSE
    store = ColumnStore(list(minute.columns), rows * times)
    for k in range(times):
        for name, values in minute.columns.items():
            store.fill(name, k * rows, values + (k * every if name == "t" else 0.0))
        store.release()
    Recording(store.finished(), minute.meta, "minutes").write(place)


def read_and_identify(place: Path) -> None:
    """What ``ideal-robot identify`` does with a file, the page apart."""
    ir.identify(Recording.read(place), Robot.load("kr15"), cascade=False)


def main() -> None:
    """Plays the lengths and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default, text in (("line", "20,60", "following a line [s]"), ("force", "20,60", "pressing [s]"),
                                ("runs", "3,6", "runs of a sweep"),
                                ("record", "120,240", "recordings at 500 Hz [s]")):
        parser.add_argument(f"--{name}", default=default, help=f"{text}, separated by commas; empty: none")
    options = parser.parse_args()
    lengths = {name: [float(piece) for piece in getattr(options, name).split(",") if piece]
               for name in ("line", "force", "runs", "record")}
    table("following a line", "s", lengths["line"], follow_line)
    table("20 N on a wavy surface", "s", lengths["force"], press)
    table("sweep", "run", lengths["runs"], many)
    with tempfile.TemporaryDirectory() as folder:
        places = {seconds: Path(folder) / f"{seconds:g}.parquet" for seconds in lengths["record"]}
        for seconds, place in places.items():
            apart(lambda seconds=seconds, place=place: write_recording(seconds, place))  # type: ignore[misc]
        table("identify, 6 joints, 500 Hz", "s", lengths["record"], lambda seconds: read_and_identify(places[seconds]))


if __name__ == "__main__":
    main()
