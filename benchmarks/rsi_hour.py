"""An hour at 4 ms without an end of our own making: the server with the ideal robot, the controller in lockstep.

    python benchmarks/rsi_hour.py [MINUTES]

Virtual time: the controller sends the next packet as soon as the last is answered. Prints how the run ended, the
longest answer, the memory after a tenth of the time and at the end, and what the garbage collection finds afterwards.
"""

from __future__ import annotations

import gc
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from ideal_robot.robots.robot import Robot
from scenes.rsi.setup import rsi_server
from tests.sim.devices.lagging_controller import LaggingController, playing

CYCLE = 0.004


class Forgetful(list):
    """A list that keeps the last hundred entries: the controller's memory shall not be taken for the server's."""

    def append(self, entry: object) -> None:
        super().append(entry)
        if len(self) > 200:
            del self[:100]


def main(minutes: float) -> int:
    """Returns the exit code: 1 if the path was not completed."""
    robot, resident = Robot.load("kr6"), []
    t = np.arange(0.0, 60.0 * minutes, 0.012)
    # Whole periods, so that the path ends at rest.
    phase = 2.0 * np.pi * round(0.2 * t[-1]) * t / t[-1]
    q = robot.home + 0.15 * (1 - np.cos(phase))[:, None] * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    cycles = round(60.0 * minutes / CYCLE)

    def measured(k: int, at: np.ndarray) -> np.ndarray:
        if k in (cycles // 10, cycles - 2):
            with open("/proc/self/statm", encoding="ascii") as file:
                resident.append(int(file.read().split()[1]) * resource.getpagesize() / 2**20)
        return at

    with tempfile.TemporaryDirectory() as room:
        path = Path(room) / "path.parquet"
        pd.DataFrame({"t": t, **{f"q_d_{i + 1}": q[:, i] for i in range(robot.n)}}).to_parquet(path)
        begun = time.perf_counter()
        with rsi_server(path, robot="kr6", method="ideal", cycle=CYCLE, port=0) as server:
            server.link.timeout = 60.0
            controller = LaggingController(server.link.axes.angles(robot.home), cycle=CYCLE, commanded=Forgetful(),
                                           measured=measured)
            with playing(controller, server.link.address):
                run = server.play(patience=60.0)
    print(f"{len(run.recording.t)} of {run.rows} cycles ({CYCLE * len(run.recording.t) / 60:.1f} min at 4 ms) in "
          f"{time.perf_counter() - begun:.0f} s; ended: {run.failure or 'path complete'}; lost {run.counts['lost']}, "
          f"late {run.counts['late']}")
    print(f"answer after, ms: median {run.answer_times_ms['median']:.2f}, 99 % {run.answer_times_ms['p99']:.2f}, worst "
          f"{run.answer_times_ms['max']:.1f}")
    print(f"memory after a tenth and at the end: {', '.join(f'{mib:.1f}' for mib in resident)} MiB; "
          f"objects in circles found afterwards: {gc.collect()}")
    return int(run.failure is not None)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0))
