"""The RSI server in real time: an hour at 4 ms, and public simulators of the controller's side."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer

from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.rsi.message import RsiFormat
from scenes.models import shipped_model
from scenes.online.processes import undisturbed
from scenes.rsi.server import RsiRun, rsi_server
from studies.report import head, resident, row
from tests.sim.devices.controllers import LaggingController

CYCLE = 0.004


class _Forgetful(list):
    """A list that keeps the last hundred entries: the controller's memory shall not be taken for the server's."""

    def append(self, entry: object) -> None:
        super().append(entry)
        if len(self) > 200:
            del self[:100]


class _Pace:
    """A controller's clock: hooks of ``LaggingController`` that wait for each cycle and judge its answer."""

    def __init__(self) -> None:
        self._due = time.perf_counter()

    def wait(self, _: int) -> bool:
        """Until the cycle begins; a controller that was not let run goes on from now."""
        self._due = max(self._due + CYCLE, time.perf_counter() - 0.1 * CYCLE)
        time.sleep(max(self._due - time.perf_counter(), 0.0))
        return False

    def too_late(self, _: int) -> bool:
        return time.perf_counter() > self._due + 0.75 * CYCLE


def _controller(port: int, virtual: bool) -> None:
    """The other process."""
    robot, pace = Robot.load("kr6"), _Pace()
    hooks: dict[str, Any] = {} if virtual else {"held_back": pace.wait, "late": pace.too_late}
    with RsiRobot(robot, port=0) as link:
        start = link.axes.angles(robot.home)
    with undisturbed(priority=60):
        LaggingController(start, cycle=CYCLE, commanded=_Forgetful(), **hooks).run(("127.0.0.1", port))


def rsi_hour(minutes: float = 60.0, virtual: bool = False,
             controller: Annotated[int, typer.Option(hidden=True)] = 0) -> None:
    """An hour at 4 ms in real time: the server with the ideal robot, a controller in a process of its own.

    An answer later than three quarters of the cycle counts as late. With --virtual the controller sends the next packet
    as soon as the last is answered. Exit code 1 where the path was not completed.
    """
    if controller:
        _controller(controller, virtual)
        return
    robot, begun, grown = Robot.load("kr6"), time.perf_counter(), [(0.0, np.inf)]
    t = np.arange(0.0, 60.0 * minutes, 0.012)
    # Whole periods, so that the path ends at rest.
    phase = 2.0 * np.pi * round(0.2 * t[-1]) * t / t[-1]
    q = robot.home + 0.15 * (1 - np.cos(phase))[:, None] * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    with tempfile.TemporaryDirectory() as room:
        path = Path(room) / "path.parquet"
        pd.DataFrame({"t": t, **{f"q_d_{i + 1}": q[:, i] for i in range(robot.n)}}).to_parquet(path)
        with rsi_server(path, robot="kr6", method="ideal", cycle=CYCLE, port=0) as server:
            server.link.timeout = 60.0

            def progress(share: float, _: str) -> None:
                if time.perf_counter() - grown[-1][0] > max(60.0 * minutes / 20, 5.0):
                    grown.append((time.perf_counter(), resident()))
                    print(f"{grown[-1][0] - begun:6.0f} s {1e2 * share:5.1f} %  {grown[-1][1]:.1f} MiB  late "
                          f"{server.link.counts.late}  lost {server.link.counts.lost}", flush=True)

            words = [sys.executable, "-m", "studies", "rsi-hour", "--controller", str(server.link.address[1])]
            root = str(Path(__file__).resolve().parents[1])
            with subprocess.Popen([*words, *(["--virtual"] if virtual else [])],
                                  env={**os.environ, "PYTHONPATH": root}) as other:
                run = server.play(patience=60.0, progress=progress)
                other.terminate()
    cycles, counts, answers = len(run.recording.t), run.counts, run.answer_times_ms
    print(f"{cycles} of {run.rows} cycles ({CYCLE * cycles / 60:.1f} min at 4 ms) in "
          f"{time.perf_counter() - begun:.0f} s; ended: {run.failure or 'path complete'}; "
          f"lost {counts['lost']}, late {counts['late']} ({1e2 * counts['late'] / max(cycles, 1):.4f} %)")
    print(f"answer after, ms: median {answers['median']:.2f}, 99 % {answers['p99']:.2f}, worst {answers['max']:.1f}; "
          f"{', '.join(run.precautions)}")
    print(f"memory grew by {max(usage for _, usage in grown[1:]) - grown[1][1]:.1f} MiB on the way; objects in circles "
          f"found afterwards: {gc.collect()}")
    raise typer.Exit(run.failure is not None)


@dataclass(frozen=True)
class Simulator:
    """How one is started and what is known of it.

    Attributes:
        file: what has to lie in the folder.
        words: command behind the interpreter, with {port} and {config}, a copy of its configuration with that port.
        path: entries of PYTHONPATH.
        cycle: one of its cycles [s].
        start: axes at which it begins [deg].
        config: its own RSI ethernet XML, if it has one.
    """

    file: str
    words: tuple[str, ...]
    path: tuple[str, ...]
    cycle: float
    start: tuple[float, ...] = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
    config: str | None = None


# kroshu's gives up after one of its own cycles; an answer that comes later stays in its socket and makes each that
# follows a cycle old. It waits for a second, as the others do.
_PATIENT = """import kroshu

class Patient(kroshu.RSISimulator):
    def __init__(self, name):
        super().__init__(name)
        self.socket_.settimeout(1.0)

kroshu.RSISimulator = Patient
kroshu.main()
"""

SIMULATORS = {
    "ros-industrial/kuka_experimental": Simulator(
        "kuka_experimental.py", ("kuka_experimental.py", "127.0.0.1", "{port}"), ("stubs",), 0.004),
    "adamleon/kuka": Simulator("adamleon.py", ("adamleon.py", "127.0.0.1", "{port}"), ("stubs",), 0.004),
    "kroshu/kuka_drivers": Simulator("kroshu.py", ("-c", _PATIENT), ("stubs", "."), 0.04),
    "fzi kuka_rsi_driver": Simulator(
        "fzi/kuka_rsi_driver/simulator.py",
        ("-c", "from kuka_rsi_driver.simulator import main; main()", "--host-ip", "127.0.0.1", "--host-port", "{port}"),
        ("stubs", "fzi"), 0.004, (0.0,) * 6, "fzi/share/ros_rsi_ethernet.xml"),
    "RSIPI": Simulator(
        "RSIPI/rsi_echo_server.py",
        ("-c", "import sys; from RSIPI.rsi_echo_server import EchoServer\n"
         "server = EchoServer(sys.argv[1], 4, mode='absolute'); server.start(); server.thread.join()", "{config}"),
        (".",), 0.004, (0.0,) * 6, "RSIPI/contexts/RSI_EthernetConfig_Joints.xml"),
}


def home_of(folder: Path, name: str) -> Path | None:
    """Where a simulator lies: in the folder, or among the installed packages; None if nowhere."""
    places = [folder, *(Path(entry) for entry in sys.path if entry)]
    return next((place for place in places if (place / SIMULATORS[name].file).is_file()), None)


def played(folder: Path, name: str, *, method: str = "ideal", size: float = 5.0, seconds: float = 1.5) -> RsiRun:
    """One motion of every axis by ``size`` [deg] out and back against one simulator.

    Args:
        folder: where the simulators lie.
        name: key of ``SIMULATORS``.
        method: see ``rsi_server``.
        size: how far each axis goes [deg].
        seconds: how long the motion takes [s].
    """
    simulator, robot, home = SIMULATORS[name], Robot.load("kr6"), home_of(folder, name)
    if home is None:
        raise FileNotFoundError(simulator.file)
    t = np.arange(0.0, seconds, simulator.cycle)
    q = robot.home + np.radians(size) * np.sin(np.pi * t / t[-1])[:, None] ** 4
    form = RsiFormat.read(home / simulator.config, robot.n) if simulator.config else None
    # The simulators move whatever they are told; the arm's own zero is put where they start.
    zero = np.array(simulator.start) - np.array(robot.data["rsi"]["axis_sign"]) * np.degrees(robot.home)
    with tempfile.TemporaryDirectory() as room:
        urdf, path = Path(room) / "arm.urdf", Path(room) / "path.csv"
        urdf.write_bytes(robot.urdf.read_bytes())
        lines = [line for line in robot.urdf.with_suffix(".toml").read_text().splitlines()
                 if not line.startswith("axis_zero")]
        urdf.with_suffix(".toml").write_text(
            "\n".join(lines).replace("[rsi]", f"[rsi]\naxis_zero = {zero.tolist()}") + "\n")
        pd.DataFrame({"t": t, **{f"q_d_{i + 1}": q[:, i] for i in range(robot.n)}}).to_csv(path, index=False)
        with (rsi_server(path, robot=str(urdf), model=shipped_model("kr6"), method=method, cycle=simulator.cycle,
                         port=0, form=form) as server,
              Running(home, simulator, server.link.address[1], Path(room))):
            return server.play(patience=20.0)


class Running:
    """The simulator as a process of its own while the block runs."""

    def __init__(self, home: Path, simulator: Simulator, port: int, room: Path) -> None:
        paths = os.pathsep.join(str((home / entry).resolve()) for entry in simulator.path)
        config = room / "config.xml"
        if simulator.config:
            text = (home / simulator.config).read_text(encoding="latin-1")
            text = re.sub("<IP_NUMBER>.*?<", "<IP_NUMBER>127.0.0.1<", text)
            config.write_text(re.sub("<PORT>.*?<", f"<PORT>{port}<", text), encoding="latin-1")
        self._words = [sys.executable, *(word.format(port=port, config=config) for word in simulator.words)]
        # Scripts are named from their folder; a package writes its log where it is run.
        self._folder = room if simulator.words[0] == "-c" else home
        self._environment = {**os.environ, "PYTHONPATH": paths, "SIM_SECONDS": "30",
                             "SIM_PARAMS": repr({"rsi_port": port})}

    def __enter__(self) -> None:
        self._process = subprocess.Popen(self._words, cwd=self._folder, env=self._environment,
                                         stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(10.0)


def rsi_simulators(folder: Path) -> None:
    """Our RSI server against public simulators of the controller's side, each in one of its own cycles.

    FOLDER holds the simulators: kuka_experimental.py, adamleon.py, kroshu.py, fzi/, and stubs/ for the ROS modules they
    import; the fifth, RSIPI, is a package (pip install RSIPI). Exit code 1 if one of them did not complete.
    """
    head("simulator", "cycle ms", "answered", "lost", "late", "time stamps", "largest error mrad")
    failed = []
    for name, simulator in SIMULATORS.items():
        if home_of(folder.resolve(), name) is None:
            row(name, *[""] * 5, "neither in the folder nor installed")
            continue
        run = played(folder.resolve(), name)
        recording = run.recording
        # These simulators are where they were commanded, a cycle later.
        error = 1e3 * np.abs(recording.joints("q")[1:] - recording.joints("q_c")[:-1]).max()
        row(name, f"{1e3 * simulator.cycle:.0f}", f"{len(recording.t)} of {run.rows}", run.counts["lost"],
            run.counts["late"], run.stamps, f"{error:.3f}")
        failed += [f"{name}: {run.failure}"] if run.failure else []
    print("", *failed, sep="\n")
    raise typer.Exit(bool(failed))
