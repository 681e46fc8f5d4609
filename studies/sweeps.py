"""Sweeps whose workers, scheduler and client are killed, and what a task costs on a cluster."""

from __future__ import annotations

import heapq
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import typer

from ideal_robot.arrays import Array
from scenes import workers as crew
from scenes.arms import shipped_model
from scenes.regression.results import RunSet, read_results
from scenes.scene_file import library
from scenes.sweep import Job, jobs, play, sweep
from studies.report import head, resident, row, used

CLIENT = """
import sys
from pathlib import Path
from scenes.regression.results import RunSet
from scenes.sweep import jobs, sweep
from studies.sweeps import quick
sweep(jobs(["line"], seeds=range(int(sys.argv[1]))), dask=sys.argv[2], function=quick,
      file=RunSet(Path(sys.argv[3]), resume=True))
"""


def quick(job: Job) -> dict[str, Any]:
    """A stand-in of a run: 20 ms of a first-order lag driven by noise of the job's seed; its error is exact."""
    rng, state, total, start = np.random.default_rng(job.seed), 0.0, 0.0, time.perf_counter()
    for value in rng.standard_normal(2000):
        state += 0.1 * (float(value) - state)
        total += state * state
    time.sleep(max(0.0, 0.02 - (time.perf_counter() - start)))
    return {"scene": "line", "method": None, "seed": job.seed, "failure": None,
            "control_error_mm": {"mean": total / 2000}}


def sweep_kills(count: int = 10_000, kills: int = 100, every: float = 3.0, workers: int = 2, seed: int = 0) -> None:
    """Quick runs on Dask: workers killed all the time, the scheduler once, the client once; nothing lost or twice.

    Every --every seconds a worker is killed (-9) and another one begun, --kills times at most; after a third of them
    the scheduler, after two thirds the client, which goes on with its data set. Each worker has a folder of its own.
    The answers are compared with those of the same runs in this process, bit by bit. Exit code 1 where they differ.
    """
    rng, killed, begun = np.random.default_rng(seed), 0, time.monotonic()
    with tempfile.TemporaryDirectory(prefix="sweep-kills-") as name, cluster(Path(name), workers) as (address, parts):
        folder = Path(name) / "runs"
        words = [sys.executable, "-c", CLIENT, str(count), address, str(folder)]
        client = subprocess.Popen(words)
        while client.poll() is None:
            with suppress(subprocess.TimeoutExpired):
                client.wait(every)
                break
            if killed < kills:
                killed += 1
                place = int(rng.integers(1, workers + 1))
                places = [place] if killed != kills // 3 else list(range(workers + 1))
                for process in places:
                    _replace(parts, process, Path(name), address)
            if killed == 2 * kills // 3 and client.poll() is None:
                client.send_signal(signal.SIGKILL)
                client.wait()
                client = subprocess.Popen(words)
        lasted = time.monotonic() - begun
        answers = RunSet(folder, resume=True).answers
        twice = len(read_results(folder).runs) - len(answers)
        expected = {number: quick(job) for number, job in enumerate(jobs(["line"], seeds=range(count)))}
    by_seed = {int(answer["seed"]): answer for answer in answers.values()}
    missing = [number for number in range(count) if number not in by_seed]
    different = [number for number, answer in by_seed.items() if json.loads(json.dumps(expected[number])) != answer]
    head("runs", "kills of workers", "of the scheduler", "of the client", "lasted", "kept", "missing", "twice",
         "different")
    row(count, killed, int(killed >= kills // 3), int(killed >= 2 * kills // 3), f"{lasted:.0f} s", len(answers),
        len(missing), twice, len(different))
    raise typer.Exit(bool(missing or different or len(answers) != count))


def sweep_efficiency(count: int = 500, workers: str = "1,2,4") -> None:
    """Quick runs of 20 ms on Dask: time over the ideal one, overhead of a run, memory of client and workers.

    Memory is looked at after a tenth of the runs and at the end.
    """
    head("workers", "runs of 20 ms", "lasted", "efficiency", "overhead of a run", "client, a tenth → all",
         "largest worker, a tenth → all")
    for number in map(int, workers.split(",")):
        with tempfile.TemporaryDirectory(prefix="sweep-") as name, cluster(Path(name), number) as (address, parts):
            sweep(jobs(["line"], seeds=range(20 * number)), dask=address, function=quick)
            memory: list[tuple[float, float]] = []

            def look(done: int, answer: dict[str, Any], memory: list[tuple[float, float]] = memory,
                     pids: tuple[int, ...] = tuple(part.pid for part in parts[1:])) -> None:
                if done in (count // 10, count):
                    memory.append((resident(), max(map(resident, pids))))

            begun = time.monotonic()
            sweep(jobs(["line"], seeds=range(count)), dask=address, function=quick, done=look)
            lasted = time.monotonic() - begun
        row(number, count, f"{lasted:.1f} s", f"{0.02 * count / number / lasted:.2f}",
            f"{1e3 * (lasted * number / count - 0.02):.1f} ms", *(f"{first:.0f} → {last:.0f} MiB" for first, last
                                                                 in zip(*memory, strict=True)))


def _nothing(job: Job) -> dict[str, Any]:
    return {"scene": "line", "method": None, "seed": job.seed, "failure": None}


def sweep_plan(runs: int = 100_000, cores: str = "1,10,100,300,1000", repeats: int = 3, seed: int = 0) -> None:
    """A plan for many cores: recorded times of runs, replayed with the time that the client spends on a batch.

    Recorded here: --repeats runs of a path, a line and a force scene; what a batch costs the client: 500 batches of one
    run that does nothing, on two workers. Replayed: --runs runs drawn of these times, in batches as a sweep
    makes them; the client hands over one batch after another, a worker that has none waits.
    """
    recorded = [used(partial(play, Job(name, None, None, number)), time.perf_counter)
                for name in ("iso9283_1", "straight", "force_wave") for number in range(1, repeats + 1)]
    with mock.patch.object(crew, "batch_lasts", return_value=0.0), \
            tempfile.TemporaryDirectory(prefix="sweep-") as name, cluster(Path(name), 2) as (address, _):
        spent = used(lambda: sweep(jobs(["line"], seeds=range(500)), dask=address, function=_nothing),
                     time.monotonic) / 500
    seconds = np.random.default_rng(seed).choice(recorded, runs)
    head("cores", "runs", "mean of a run", "of a batch", "client, a batch", "would last", "efficiency")
    for number in map(int, cores.split(",")):
        per_batch = max(1, round(crew.batch_lasts(number) / float(np.mean(recorded))))
        batches = np.add.reduceat(seconds, np.arange(0, runs, per_batch))
        lasted = _replayed(batches, number, spent)
        row(number, runs, f"{np.mean(recorded):.2f} s", per_batch, f"{1e3 * spent:.1f} ms", f"{lasted / 3600:.2f} h",
            f"{float(seconds.sum()) / number / lasted:.2f}")


def _replayed(batches: Array, cores: int, spent: float) -> float:
    """How long batches last on so many cores [s], where the client spends a time on each, one after the other."""
    free, client = [0.0] * cores, 0.0
    for seconds in batches.tolist():
        client = max(client, heapq.heappop(free)) + spent
        heapq.heappush(free, client + seconds)
    return max(free)


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers as processes; yields the address and the processes, the scheduler first."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    parts = [_begun(folder, place, address) for place in range(workers + 1)]
    try:
        time.sleep(5.0)
        yield address, parts
    finally:
        for part in parts:
            part.kill()
            part.wait()


def _begun(folder: Path, place: int, address: str) -> subprocess.Popen[bytes]:
    """The scheduler (place 0) or a worker, in a folder of its own."""
    own = folder / f"place-{place}"
    own.mkdir(exist_ok=True)
    words = (["scheduler", "--host", "127.0.0.1", "--port", address.rpartition(":")[2], "--no-dashboard"] if place == 0
             else ["worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"])
    return subprocess.Popen([sys.executable, "-m", "dask", *words], cwd=own, stderr=subprocess.DEVNULL,
                            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])})


def _replace(parts: list[subprocess.Popen[bytes]], place: int, folder: Path, address: str) -> None:
    parts[place].kill()
    parts[place].wait()
    parts[place] = _begun(folder, place, address)


# The nightly check put to the test: does it call an unchanged program the same, and a changed one by its name?

PATHS = ("iso9283_2", "iso9283_3", "vertical_circle")
"""Shipped scenes that the adaptive layer is tried on: it needs some seconds to learn."""
SCENES = {
    "short": """kind = "line"
title = "A short line, displaced by chance"
robot = "kr6"
speed = 0.7
[calibration]
by_moving = false
[surface]
origin = [0.98, -0.6, 0.35]
heading_deg = 90.0
[line]
points = [[0.4, 0.0], [0.8, 0.0]]
""",
    "triangle": """kind = "path"
title = "A small triangle"
robot = "kr15"
speed = 0.3
[path]
shape = "triangle"
size_mm = 80.0
centre = [1.05, 0.0, 0.95]
tilt_deg = 45.0
""",
    "ring": """kind = "path"
title = "A small circle"
robot = "manutec_r15"
speed = 0.3
[path]
shape = "circle"
size_mm = 100.0
centre = [0.8, 0.0, 0.75]
tilt_deg = 90.0
heading_deg = 45.0
""",
}
"""Scenes of half a second of motion, so that two hundred runs take a minute."""
SUITE = """title = "two hundred runs"
[[case]]
scenes = ["triangle.toml", "ring.toml"]
speeds = [0.3, 0.4]
seeds = "1-16"
methods = ["ideal", "precorrected-printed", "none"]
[[case]]
scenes = ["short.toml"]
world = "bench"
seeds = "1-8"
"""
LAYER = """title = "{method}"
baseline = "layer.json"
[[case]]
scenes = SCENES
seeds = "1-6"
methods = ["{method}"]
""".replace("SCENES", str([f"{name}.toml" for name in PATHS]))


def check_suite(repetitions: int = 20, spoilt: float = 10.0) -> None:
    """A suite of 200 runs: called the same when nothing changed, worse with a spoilt model, better when adapting.

    Every check is a process of its own that plays all of its runs anew; none is kept. The unchanged program is checked
    --repetitions times, with one process, two, and two workers of Dask in turns. Then all coefficients of the model's
    friction are --spoilt percent too large, and then the adaptive layer is on. Exit code 1 where a verdict is wrong.
    """
    with tempfile.TemporaryDirectory(prefix="check-suite-") as name:
        folder = Path(name)
        _write(folder)
        (folder / "cluster").mkdir()
        right = [_checked(folder, "suite", ["--update-baseline", "--processes", "2"], "baseline", "")]
        with cluster(folder / "cluster", 2) as (address, _):
            workers = {"1 process": ["--processes", "1"], "2 processes": ["--processes", "2"],
                       "2 workers of Dask": ["--dask", address]}
            for number in range(repetitions):
                where = list(workers)[number % len(workers)]
                right.append(_checked(folder, "suite", workers[where], f"unchanged, {where}", "same"))
        _checked(folder, "ideal", ["--update-baseline"], "baseline of ideal", "")
        right.append(_checked(folder, "adapted", [], "adaptive layer on", "better"))
        _spoil(folder, 1.0 + spoilt / 100.0)
        right.append(_checked(folder, "suite", [], f"friction {spoilt:g} % too large", "worse"))
    raise typer.Exit(not all(right))


def _write(folder: Path) -> None:
    for path in PATHS:
        shutil.copy(library() / f"{path}.toml", folder / f"{path}.toml")
    for name, text in SCENES.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    (folder / "suite.toml").write_text(SUITE, encoding="utf-8")
    for method in ("ideal", "adapted"):
        (folder / f"{method}.toml").write_text(LAYER.format(method=method), encoding="utf-8")
    head("what", "runs", "lasted", "verdict", "wanted", "cases worse", "better", "same results, bit by bit")


def _checked(folder: Path, suite: str, options: list[str], what: str, wanted: str) -> bool:
    """Checks a suite as a user does and prints what was found; whether it is what was wanted."""
    begun = time.monotonic()
    done = subprocess.run([sys.executable, "-m", "scenes.cli", "check", f"{suite}.toml", *options], cwd=folder,
                          capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])})
    out = folder / "out" / f"check_{suite}"
    if not (out / "comparison.json").is_file():
        raise SystemExit(done.stdout + done.stderr)
    comparison = json.loads((out / "comparison.json").read_text())
    results, baseline = (json.loads(path.read_text())["runs"] for path in
                         (out / "results.json", folder / ("suite.baseline.json" if suite == "suite" else "layer.json")))
    verdict = comparison["verdict"] if wanted else ""
    row(what, len(results), f"{time.monotonic() - begun:.0f} s", verdict, wanted, _cases(comparison, "worse"),
        _cases(comparison, "better"), "yes" if results == baseline else "no")
    return verdict == wanted and done.returncode == (wanted == "worse")


def _cases(told: dict[str, Any], verdict: str) -> str:
    return "; ".join(dict.fromkeys(figure["case"] for figure in told["figures"] if figure["verdict"] == verdict))


def _spoil(folder: Path, factor: float) -> None:
    """Gives all scenes the shipped model of their arm with friction times ``factor``."""
    for name, text in SCENES.items():
        robot = text.partition('robot = "')[2].partition('"')[0]
        model = json.loads(shipped_model(robot).read_text(encoding="utf-8"))
        for law in model["friction"]:
            law["coefficients"] = [[factor * value for value in values] for values in law["coefficients"]]
        (folder / f"{robot}.json").write_text(json.dumps(model), encoding="utf-8")
        (folder / f"{name}.toml").write_text(f'model = "{robot}.json"\n{text}', encoding="utf-8")
