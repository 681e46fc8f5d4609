"""An hour at 4 ms without an end of our own making: the server with the ideal robot, a controller in another process.

    python benchmarks/rsi_hour.py [MINUTES] [--virtual]

In real time; an answer later than three quarters of the cycle counts as late. With ``--virtual`` the controller sends
the next packet as soon as the last is answered. Prints memory and late answers as it goes, how the run ended, the
longest answer, and what the garbage collection finds afterwards; exit code 1 where the path was not completed.
"""

from __future__ import annotations

import argparse
import gc
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from scenes.online.processes import undisturbed
from scenes.rsi.setup import rsi_server
from tests.sim.devices.controllers import LaggingController

CYCLE = 0.004


class Forgetful(list):
    """A list that keeps the last hundred entries: the controller's memory shall not be taken for the server's."""

    def append(self, entry: object) -> None:
        super().append(entry)
        if len(self) > 200:
            del self[:100]


class Pace:
    """A controller's clock: hooks of ``LaggingController`` that wait for each cycle and judge its answer."""

    def __init__(self) -> None:
        self._due, self.late = time.perf_counter(), 0

    def wait(self, _: int) -> bool:
        """Until the cycle begins; a controller that was not let run goes on from now."""
        self._due = max(self._due + CYCLE, time.perf_counter() - 0.1 * CYCLE)
        time.sleep(max(self._due - time.perf_counter(), 0.0))
        return False

    def too_late(self, _: int) -> bool:
        """Whether the answer came too late."""
        late = time.perf_counter() > self._due + 0.75 * CYCLE
        self.late += late
        return late


def controller(port: int, virtual: bool) -> int:
    """The other process."""
    robot, pace = Robot.load("kr6"), Pace()
    hooks = {} if virtual else {"held_back": pace.wait, "late": pace.too_late}
    with RsiRobot(robot, port=0) as link:
        start = link.axes.angles(robot.home)
    with undisturbed(priority=60):
        LaggingController(start, cycle=CYCLE, commanded=Forgetful(), **hooks).run(("127.0.0.1", port))
    return 0


def main(minutes: float, virtual: bool) -> int:
    """Returns the exit code."""
    robot = Robot.load("kr6")
    t = np.arange(0.0, 60.0 * minutes, 0.012)
    # Whole periods, so that the path ends at rest.
    phase = 2.0 * np.pi * round(0.2 * t[-1]) * t / t[-1]
    q = robot.home + 0.15 * (1 - np.cos(phase))[:, None] * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    told, resident = time.perf_counter(), []
    with tempfile.TemporaryDirectory() as room:
        path = Path(room) / "path.parquet"
        pd.DataFrame({"t": t, **{f"q_d_{i + 1}": q[:, i] for i in range(robot.n)}}).to_parquet(path)
        begun = time.perf_counter()
        with rsi_server(path, robot="kr6", method="ideal", cycle=CYCLE, port=0) as server:
            server.link.timeout = 60.0

            def progress(share: float, _: str) -> None:
                nonlocal told
                if not resident or time.perf_counter() - told > max(60.0 * minutes / 20, 5.0):
                    told = time.perf_counter()
                    resident.append(_resident())
                    print(f"{told - begun:6.0f} s {1e2 * share:5.1f} %  {resident[-1]:.1f} MiB  late "
                          f"{server.link.counts.late}  lost {server.link.counts.lost}", flush=True)

            words = [sys.executable, __file__, "--controller", str(server.link.address[1])]
            root = Path(__file__).resolve().parents[1]
            with subprocess.Popen([*words, *(["--virtual"] if virtual else [])],
                                  env={**os.environ, "PYTHONPATH": str(root)}) as other:
                run = server.play(patience=60.0, progress=progress)
                other.terminate()
    cycles, counts = len(run.recording.t), run.counts
    print(f"{cycles} of {run.rows} cycles ({CYCLE * cycles / 60:.1f} min at 4 ms) in "
          f"{time.perf_counter() - begun:.0f} s; ended: {run.failure or 'path complete'}; "
          f"lost {counts['lost']}, late {counts['late']} "
          f"({1e2 * counts['late'] / max(cycles, 1):.4f} %)")
    print(f"answer after, ms: median {run.answer_times_ms['median']:.2f}, 99 % {run.answer_times_ms['p99']:.2f}, worst "
          f"{run.answer_times_ms['max']:.1f}; {', '.join(run.precautions)}")
    print(f"memory grew by {max(resident) - resident[0]:.1f} MiB on the way; objects in circles found afterwards: "
          f"{gc.collect()}")
    return int(run.failure is not None)


def _resident() -> float:
    """Memory of this process now [MiB]."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("minutes", type=float, nargs="?", default=60.0)
    parser.add_argument("--virtual", action="store_true")
    parser.add_argument("--controller", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    sys.exit(main(given.minutes, given.virtual) if given.controller is None else
             controller(given.controller, given.virtual))
