"""Sweeps whose workers, scheduler and client are killed, and what a task costs on a cluster."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import typer

from scenes.regression.results import read_results
from scenes.run_set import RunSet
from scenes.sweep import Job, jobs, sweep
from studies.report import head, row

CLIENT = """
import sys
from pathlib import Path
from scenes.run_set import RunSet
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
                for one in places:
                    _replace(parts, one, Path(name), address)
            if killed == 2 * kills // 3 and client.poll() is None:
                client.send_signal(signal.SIGKILL)
                client.wait()
                client = subprocess.Popen(words)
        lasted = time.monotonic() - begun
        kept = RunSet(folder, resume=True).answers
        twice = len(read_results(folder).runs) - len(kept)
        expected = {number: quick(job) for number, job in enumerate(jobs(["line"], seeds=range(count)))}
    found = {int(answer["seed"]): answer for answer in kept.values()}
    missing = [number for number in range(count) if number not in found]
    different = [number for number, answer in found.items() if json.loads(json.dumps(expected[number])) != answer]
    head("runs", "kills of workers", "of the scheduler", "of the client", "lasted", "kept", "missing", "twice",
         "different")
    row(count, killed, int(killed >= kills // 3), int(killed >= 2 * kills // 3), f"{lasted:.0f} s", len(kept),
        len(missing), twice, len(different))
    raise typer.Exit(bool(missing or different or len(kept) != count))


def sweep_efficiency(count: int = 500, workers: str = "1,2") -> None:
    """Quick runs of 20 ms on Dask with one and two workers: time over the ideal one, and overhead of a task."""
    head("workers", "runs of 20 ms", "lasted", "efficiency", "overhead of a run")
    for number in map(int, workers.split(",")):
        with tempfile.TemporaryDirectory(prefix="sweep-") as name, cluster(Path(name), number) as (address, _):
            sweep(jobs(["line"], seeds=range(20 * number)), dask=address, function=quick)
            begun = time.monotonic()
            sweep(jobs(["line"], seeds=range(count)), dask=address, function=quick)
            lasted = time.monotonic() - begun
        row(number, count, f"{lasted:.1f} s", f"{0.02 * count / number / lasted:.2f}",
            f"{1e3 * (lasted * number / count - 0.02):.1f} ms")


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
