"""Time and memory that work costs, and how they grow with length.

Speeds are by processor time, which is what work costs also where other processes share the cores.
"""

from __future__ import annotations

import itertools
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ideal_robot.diagnosis import diagnose
from ideal_robot.identification.excitation import design_excitation
from ideal_robot.identification.idim import identify
from ideal_robot.identification.whole_model import identify_model
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import finished, let_go, new_columns
from ideal_robot.signals.preprocess import preprocess
from ideal_robot.signals.recording import Recording
from scenes import load_scene, run_scene
from scenes.identification.plan import fourier_commands
from scenes.line import cell as line_cell
from scenes.line.kind import run
from scenes.scene_files.line_scene import LineScene
from scenes.sweep import SweepFile, jobs, sweep
from sim.arm.arm import SimulatedArm
from sim.arm.kernel import drive_step
from sim.arm.world import STEP, World
from sim.bullet import pybullet
from studies.report import head, resident, row, scene_of, used

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 6.0
"""Arm time of the plant's motion [s]."""
STEPS = 4000
"""Steps of the plant that are timed together."""

FIGAROH = r'''
import sys, time, warnings
warnings.filterwarnings("ignore")
import numpy as np
import pinocchio as pin
from scipy import signal
from figaroh.tools.regressor import RegressorBuilder, RegressorConfig
from figaroh.tools.qrdecomposition import QRDecomposer
begun = time.process_time()
folder, urdf, factor = sys.argv[1], sys.argv[2], int(sys.argv[3])

class Robot:
    model = pin.buildModelFromUrdf(urdf)
    data = model.createData()

n = Robot.model.nv
settings = {"act_idxv": list(range(n)), "has_coupled_wrist": False, "act_Jid": list(range(1, n + 1))}
builder = RegressorBuilder(Robot, RegressorConfig(has_friction=True, has_actuator_inertia=True, has_joint_offset=True))
d = np.load(f"{folder}/estimation.npz")
W = builder.build_basic_regressor(d["q"], d["qd"], d["qdd"], settings)
N = len(d["q"])
# Rows are joint after joint, as FIGAROH stacks them.
parts, y = [], []
for j in range(n):
    parts.append(signal.decimate(W[j * N:(j + 1) * N], factor, axis=0, zero_phase=True)[5:-5])
    y.append(signal.decimate(d["tau"][:, j], factor, zero_phase=True)[5:-5])
W, tau = np.concatenate(parts), np.concatenate(y)
seen = np.flatnonzero(np.linalg.norm(W, axis=0) > 1e-3)
base, _ = QRDecomposer()._identify_base_parameters(W[:, seen], [f"p{i}" for i in seen])
phi = np.linalg.lstsq(W[:, seen][:, list(base)], tau, rcond=None)[0]
print(f"({time.process_time() - begun:.2f} s CPU)")
'''
"""FIGAROH's regressor, base parameters by QR, and least squares, with the decimation of its own pipeline."""


def speed(repeats: int = 7, first: bool = False) -> None:
    """Line, plant, identification, command line: minimum, median and maximum, beside peers and what is wanted.

    FIGAROH is no dependency. It is compared where it is installed apart (python3.11 -m venv figaroh-env;
    figaroh-env/bin/pip install figaroh) and FIGAROH_PYTHON names that Python. --first adds the first run in a new
    environment, with and without the compile step of the installation, each in an empty cache.
    """
    head(f"of {repeats}", "minimum", "median", "maximum", "", "wanted")
    _line(repeats, "bench", "≥ 5")
    _line(repeats, "workshop")
    _plant(repeats)
    _identification(repeats)
    _from_the_shell(repeats)
    if first:
        _first_runs()


def kr15_recording(seed: int, seconds: float) -> Recording:
    """A recording at 500 Hz of the simulated KR 15 moving along an optimised Fourier series."""
    robot = Robot.load("kr15")
    motion = design_excitation(robot, np.random.default_rng(seed), period=seconds - 10.0)
    commands = fourier_commands(robot, motion, robot.home, robot.t_ipo)[: round(seconds / robot.t_ipo)]
    with SimulatedArm(robot, World.default("kr15"), np.random.default_rng(seed), robot.home) as arm:
        for q_c in commands:
            arm.cycle(q_c)
        return arm.recording()


def _show(name: str, values: list[float], unit: str, wanted: str = "") -> None:
    row(name, *(f"{value:.3g}" for value in (min(values), np.median(values), max(values))), unit, wanted)


def _used_by(words: list[str], *, works: bool = True, **environment: str) -> float:
    """Processor time of a command with its children [s]; one that works ends with 0.

    It may keep its modules' bytecode, which an installation has from the beginning.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(words, check=works, capture_output=True,
                   env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "", **environment})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _line(repeats: int, world: str, wanted: str = "") -> None:
    """The main job and what precedes it."""
    scene = scene_of(LineScene, "line").changed(world=world)
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
            with line_cell.prepared(scene):
                pass
    finally:
        line_cell.calibrate_by_moving = inner
    factors, runs = [], []
    with line_cell.prepared(scene) as shared:
        run(scene, shared=shared)
        for _ in range(repeats):
            begun = time.process_time()
            result = run(scene, shared=shared)
            runs.append(time.process_time() - begun)
            factors.append(float(result.recording.t[-1]) / runs[-1])
    _show(f"`line` in the {world}, real time over processor time", factors, "×", wanted)
    _show(f"`line` in the {world}, the run", runs, "s")
    _show(f"`line` in the {world}, camera calibration before it", calibrating[1:], "s", "≤ the run")


def _plant(repeats: int) -> None:
    """The simulated arm alone, with elastic and with rigid gears, and what a step of it consists of."""
    robot = Robot.load("kr6")
    for name, world in (("arm alone", World.default("kr6")), ("arm alone, rigid gears", World.ideal("kr6"))):
        with SimulatedArm(robot, world, np.random.default_rng(0)) as arm:
            path = [robot.home + 0.2 * np.sin(np.pi * k * arm.t_ipo) ** 2 for k in range(round(SECONDS / arm.t_ipo))]

            def moves(arm: SimulatedArm = arm, path: list[np.ndarray] = path) -> None:
                arm.reset(robot.home)
                for q_c in path:
                    arm.cycle(q_c)

            moves()
            _show(f"{name}, real time over processor time", [SECONDS / used(moves) for _ in range(repeats)], "×",
                  "≥ 40" if name == "arm alone" else "")
    with SimulatedArm(robot, World.default("kr6"), np.random.default_rng(0)) as arm:
        arm.cycle(robot.home)
        zero, joints = np.zeros(robot.n), list(range(robot.n))
        parts = {
            "PyBullet's step": lambda: pybullet.stepSimulation(physicsClientId=arm.client),
            "its joint states": lambda: pybullet.getJointStates(arm.body, joints, physicsClientId=arm.client),
            "controller, motors, gears, friction": lambda: drive_step(
                1, arm._p, arm._shared, arm._counts, arm._x, arm._links, zero, arm._history.next_row),
        }
        for name, job in parts.items():
            spent = [used(lambda job=job: [job() for _ in range(STEPS)]) for _ in range(repeats)]  # type: ignore[misc]
            _show(f"{name} alone, real time over processor time", [STEP * STEPS / seconds for seconds in spent], "×")


def _identification(repeats: int) -> None:
    """60 s × 6 joints at 500 Hz of the KR 15 in its default world; both get the same filtered signals."""
    robot, estimation = Robot.load("kr15"), kr15_recording(1, 60.0)
    identify([estimation], robot, friction="viscous_coulomb")
    for friction, name, wanted in (("viscous_coulomb", "fixed law", "≤ a third of FIGAROH"),
                                   ("auto", "law chosen", "≤ FIGAROH")):
        times = [used(lambda friction=friction: identify([estimation], robot, friction=friction))  # type: ignore[misc]
                 for _ in range(repeats)]
        _show(f"identification of 60 s × 6 joints at 500 Hz, {name}", times, "s", wanted)
    python = os.environ.get("FIGAROH_PYTHON")
    if python is None:
        return
    with tempfile.TemporaryDirectory() as name:
        folder, s = Path(name), preprocess(estimation)
        np.savez(folder / "estimation.npz", q=s.q, qd=s.qd, qdd=s.qdd, tau=s.tau)
        (folder / "figaroh_run.py").write_text(FIGAROH)
        words = [python, str(folder / "figaroh_run.py"), str(folder), str(robot.urdf), str(s.factor)]
        outputs = [subprocess.run(words, capture_output=True, text=True, check=True).stdout for _ in range(repeats)]
        _show("the same by FIGAROH", [float(re.findall(r"\(([\d.]+) s CPU\)", output)[0]) for output in outputs], "s")


def _from_the_shell(repeats: int) -> None:
    """First answers of the program, and the main job with its report; the first call of each writes bytecode."""
    with tempfile.TemporaryDirectory() as folder:
        for words, name, wanted in (
                ("--help", "help of the command line", "≤ 0.3"),
                ("run nothing", "a scene that is not there, by `run`", "≤ 0.3"),
                ("diagnose nothing.csv --robot kr6", "a recording that is not there, by `diagnose`", "≤ 0.3"),
                (f"run line --out {folder}/line", "`run line`, report included", "≤ 6")):
            spent = [_used_by([sys.executable, "-m", "scenes.cli", *words.split()], works="nothing" not in words)
                     for _ in range(repeats + 1)]
            _show(name, spent[1:], "s", wanted)


def _first_runs() -> None:
    """`run line` with an empty cache of compiled code, and after the compile step."""
    words = [sys.executable, "-m", "scenes.cli", "run", "line", "--out"]
    with tempfile.TemporaryDirectory() as name:
        cold = _used_by([*words, f"{name}/a"], NUMBA_CACHE_DIR=f"{name}/cold")
        step = _used_by([sys.executable, "-m", "scenes.compiled"], NUMBA_CACHE_DIR=f"{name}/warm")
        warm = _used_by([*words, f"{name}/b"], NUMBA_CACHE_DIR=f"{name}/warm")
    _show("first `run line`, nothing compiled", [cold], "s")
    _show("compile step of the installation", [step], "s")
    _show("first `run line` after it, report included", [warm], "s", "≤ 15")


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
    figures = []
    for length in _numbers(lengths):
        seconds, megabytes = _apart(lambda length=length: job(length))  # type: ignore[misc]
        figures.append((length, seconds, megabytes))
        row(f"{kind}, {length:g} {unit}", f"{seconds:.1f} s", f"{megabytes:.0f} MB")
    return [f"{kind}, {a:g} to {b:g} {unit}: {(t1 - t0) / (b - a):.2f} s and {1e3 * (m1 - m0) / (b - a):.0f} kB for one"
            for (a, t0, m0), (b, t1, m1) in itertools.pairwise(figures)]


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
    columns = new_columns(minute.columns, rows * times)
    for k in range(times):
        for name, values in minute.columns.items():
            columns[name][k * rows : (k + 1) * rows] = values + (k * every if name == "t" else 0.0)
        let_go(columns["t"])
    Recording(finished(columns), minute.meta, "minutes").write(place)
