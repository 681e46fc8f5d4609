"""All speeds in one table, by processor time: minimum, median and maximum of seven, beside peers and what is wanted.

    FIGAROH_PYTHON=… python benchmarks/bench_speed.py [--repeats 7] [--first]

Processor time is what the work costs, also where other processes share the cores. FIGAROH is no dependency
(``bench_identify.py`` says how to install it apart); without it its row is left out. ``--first`` adds the first run in
a new environment, once with and once without the compile step of the installation, each in an empty cache.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from benchmarks import bench_identify  # noqa: E402
from ideal_robot.identification.idim import identify  # noqa: E402
from ideal_robot.robots.robot import Robot  # noqa: E402
from ideal_robot.signals.preprocess import preprocess  # noqa: E402
from scenes import load_scene  # noqa: E402
from scenes.line import cell as line_cell  # noqa: E402
from scenes.line.kind import run  # noqa: E402
from sim.arm.arm import SimulatedArm  # noqa: E402
from sim.arm.world import STEP, World  # noqa: E402
from sim.bullet import pybullet  # noqa: E402

SECONDS = 6.0
"""Arm time of the plant's motion [s]."""


def used(job: Callable[[], object]) -> float:
    """Processor time of a job in this process [s]."""
    begun = time.process_time()
    job()
    return time.process_time() - begun


def used_by(words: list[str], **environment: str) -> tuple[float, str]:
    """Processor time of a command with its children [s], and what it printed."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(words, check=True, capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": str(ROOT), **environment})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def show(name: str, values: list[float], unit: str, wanted: str = "") -> None:
    """One row of the table."""
    low, middle, high = min(values), np.median(values), max(values)
    print(f"| {name} | {low:.3g} | {middle:.3g} | {high:.3g} | {unit} | {wanted} |", flush=True)


def line(repeats: int, world: str, wanted: str = "") -> None:
    """The main job and what precedes it, in the bench world or in the workshop."""
    scene = load_scene("line").changed(world=world)
    calibrating: list[float] = []
    inner = line_cell.calibrate_by_moving

    def timed(*arguments: object, **named: object) -> object:
        begun = time.process_time()
        result = inner(*arguments, **named)  # type: ignore[arg-type]
        calibrating.append(time.process_time() - begun)
        return result

    line_cell.calibrate_by_moving = timed  # type: ignore[assignment]
    try:
        for _ in range(repeats + 1):
            with line_cell.prepared(scene) as shared:
                pass
    finally:
        line_cell.calibrate_by_moving = inner
    factors, runs = [], []
    with line_cell.prepared(scene) as shared:
        run(scene, method="ideal", shared=shared)
        for _ in range(repeats):
            begun = time.process_time()
            result = run(scene, method="ideal", shared=shared)
            runs.append(time.process_time() - begun)
            factors.append(float(result.recording.t[-1]) / runs[-1])
    show(f"`line` in the {world}, real time over processor time", factors, "×", wanted)
    show(f"`line` in the {world}, the run", runs, "s")
    show(f"`line` in the {world}, camera calibration before it", calibrating[1:], "s", "≤ the run")


def plant(repeats: int) -> None:
    """The simulated arm alone, and PyBullet's step alone."""
    robot = Robot.load("kr6")
    with SimulatedArm(robot, World.default("kr6"), np.random.default_rng(0)) as arm:
        path = [robot.home + 0.2 * np.sin(np.pi * k * arm.t_ipo) ** 2 for k in range(round(SECONDS / arm.t_ipo))]

        def moves() -> None:
            arm.reset(robot.home)
            for q_c in path:
                arm.cycle(q_c)

        moves()
        show("arm alone, real time over processor time", [SECONDS / used(moves) for _ in range(repeats)], "×", "≥ 40")
        count = 4000

        def steps() -> None:
            for _ in range(count):
                pybullet.stepSimulation(physicsClientId=arm.client)

        show("PyBullet's step alone, the same", [STEP * count / used(steps) for _ in range(repeats)], "×")


def identification(repeats: int) -> None:
    """60 s × 6 joints at 500 Hz, beside FIGAROH."""
    robot = Robot.load("kr15")
    estimation, validation = bench_identify.recording(1, 60.0), bench_identify.recording(2, 30.0)
    identify([estimation], robot, friction="viscous_coulomb")
    for friction, name, wanted in (("viscous_coulomb", "fixed law", "≤ a third of FIGAROH"),
                                   ("auto", "law chosen", "≤ FIGAROH")):
        times = [used(lambda friction=friction: identify([estimation], robot, friction=friction))  # type: ignore[misc]
                 for _ in range(repeats)]
        show(f"identification of 60 s × 6 joints at 500 Hz, {name}", times, "s", wanted)
    python = os.environ.get("FIGAROH_PYTHON")
    if python is None:
        return
    with tempfile.TemporaryDirectory() as name:
        folder, signals = Path(name), preprocess(estimation)
        for role, r in (("estimation", estimation), ("validation", validation)):
            s = preprocess(r, cutoff=signals.cutoff)
            np.savez(folder / f"{role}.npz", q=s.q, qd=s.qd, qdd=s.qdd, tau=s.tau)
        (folder / "figaroh_run.py").write_text(bench_identify.FIGAROH)
        times = []
        for _ in range(repeats):
            said = subprocess.run([python, str(folder / "figaroh_run.py"), str(folder), str(robot.urdf),
                                   str(signals.factor)], capture_output=True, text=True, check=True).stdout
            found = re.search(r"\(([\d.]+) s CPU\)", said)
            assert found is not None
            times.append(float(found.group(1)))
        show("the same by FIGAROH", times, "s")


def first_runs() -> None:
    """`run line` with an empty cache of compiled code, and after the compile step."""
    words = [sys.executable, "-m", "scenes.cli", "run", "line", "--out"]
    with tempfile.TemporaryDirectory() as name:
        cold, _ = used_by([*words, f"{name}/a"], NUMBA_CACHE_DIR=f"{name}/cold")
        step, _ = used_by([sys.executable, "-m", "scenes.compiled"], NUMBA_CACHE_DIR=f"{name}/warm")
        warm, _ = used_by([*words, f"{name}/b"], NUMBA_CACHE_DIR=f"{name}/warm")
    show("first `run line`, nothing compiled", [cold], "s")
    show("compile step of the installation", [step], "s")
    show("first `run line` after it, report included", [warm], "s", "≤ 15")


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--first", action="store_true", help="also the first run in a new environment")
    options = parser.parse_args()
    print(f"| of {options.repeats} | minimum | median | maximum | | wanted |\n| --- | --- | --- | --- | --- | --- |")
    line(options.repeats, "bench", "≥ 5")
    line(options.repeats, "workshop")
    plant(options.repeats)
    identification(options.repeats)
    show("help of the command line", [used_by([sys.executable, "-m", "scenes.cli", "--help"])[0]
                                  for _ in range(options.repeats)], "s", "≤ 0.3")
    if options.first:
        first_runs()


if __name__ == "__main__":
    main()
