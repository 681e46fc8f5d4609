"""A follower and a simulated cell, two processes of their own, for tests and measurements of both together."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from scenes.online.journal import journal_rows
from tests.sources import ROOT


def free_ports() -> dict[str, int]:
    """Ports nobody has at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as arm, socket.socket() as camera, \
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as force:
        for link in (arm, camera, force):
            link.bind(("127.0.0.1", 0))
        return {"arm": arm.getsockname()[1], "camera": camera.getsockname()[1], "force": force.getsockname()[1]}


@dataclass
class Cell:
    """A served cell: the process of ``simulate --serve``, its devices' ports, and a folder for files."""

    process: subprocess.Popen[str]
    ports: dict[str, int]
    folder: Path
    relative: bool
    protocol: str = "rsi"

    def follow(self, scene: str, *options: str, program: str = "scenes.cli") -> subprocess.Popen[str]:
        """Starts a follower of a shipped scene, or of a file whose name begins like one's, by a program's ``main``."""
        kind = Path(scene).stem
        devices = ["--arm", f"{self.protocol}://127.0.0.1:{self.ports['arm']}", "--out", str(self.folder / "out")]
        devices += ["--relative"] if self.relative else []
        if not kind.startswith("force_wave"):
            devices += ["--camera", f"stream://127.0.0.1:{self.ports['camera']}"]
        if not kind.startswith("line"):
            devices += ["--force", f"netft://127.0.0.1:{self.ports['force']}?rate=250", "--force-delay", "19"]
        (self.folder / "follow.json").unlink(missing_ok=True)
        return started("follow", scene, "--delay", "--wait", "240", "--json", str(self.folder / "follow.json"),
                       *devices, *options, program=program)

    def truth(self, session: int, seconds: float = 60.0) -> dict[str, Any]:
        """What really happened in a session, waited for."""
        file, end = self.folder / "truth.json", time.monotonic() + seconds
        while time.monotonic() < end:
            if file.exists():
                truth: dict[str, Any] = json.loads(file.read_text())
                if truth["session"] >= session:
                    return truth
            time.sleep(0.2)
        raise TimeoutError(f"no session {session} within {seconds} s")

    def figures(self) -> dict[str, Any]:
        """The follower's figures."""
        figures: dict[str, Any] = json.loads((self.folder / "follow.json").read_text())
        return figures


def started(*words: str, program: str = "scenes.cli") -> subprocess.Popen[str]:
    """A verb of the command line as a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen([sys.executable, "-m", program, *words], stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True, env=environment)


@contextmanager
def served(scene: str, folder: Path, *options: str, relative: bool = True, protocol: str = "rsi") -> Iterator[Cell]:
    """``simulate --serve`` until the block ends."""
    ports = free_ports()
    words = ["--arm", f"{protocol}://127.0.0.1:{ports['arm']}", "--camera-port", str(ports["camera"]), "--force-port",
             str(ports["force"]), "--json", str(folder / "truth.json"), *(["--relative"] if relative else []), *options]
    process = started("simulate", scene, "--serve", *words)
    try:
        yield Cell(process, ports, folder, relative, protocol)
    finally:
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def wait_until(happened: Callable[[], bool], seconds: float) -> None:
    """Waits for something that happens in another process."""
    end = time.monotonic() + seconds
    while not happened():
        if time.monotonic() > end:
            raise TimeoutError(f"it did not happen within {seconds} s")
        time.sleep(0.02)


def rows(folder: Path) -> int:
    """Cycles that are in the follower's journal by now."""
    try:
        return len(journal_rows(folder / "out")[0])
    except (OSError, ValueError):
        return 0


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    pids = []
    for folder in Path(f"/proc/{pid}/task").glob("*/children"):
        pids += [int(word) for word in folder.read_text().split()]
    return pids


# An arm that does what it is told, without a wire, for tests of what leads it.

@dataclass
class Counts:
    cycles: int = 0


@dataclass
class Tame:
    """A ``Link`` whose controller's clock is given by hand; ``lost`` cycles are left out of it."""

    robot: Robot = field(default_factory=lambda: Robot.load("kr6"))
    fault: str | None = None
    lost: tuple[int, ...] = ()
    raises: Exception | None = None
    repeats: bool = False

    def __post_init__(self) -> None:
        self.t_ipo = self.robot.t_ipo
        self.commanded = self.robot.home.copy()
        self.counts, self.answer_times = Counts(), []
        self.arrived, self._k, self._begun = time.perf_counter(), 0, time.perf_counter()
        self.taken: list[Array] = []
        self.skipped: list[Array] = []
        self.gone_on, self.missed = 0, False
        self.unanswered: tuple[RobotState, ...] = ()

    def send(self, q_c: Array) -> None:
        self.commanded = q_c
        self.taken.append(q_c)

    def skip(self, q_c: Array) -> None:
        self.skipped.append(q_c)

    def receive(self) -> RobotState:
        if self.raises is not None:
            raise self.raises
        lost = self._k + 1 in self.lost
        self._k += 1 + lost
        self.gone_on, self.missed = lost if self.repeats else 0, lost
        self.arrived = self._begun + self._k * self.t_ipo
        return RobotState(self._k * self.t_ipo, self.commanded.copy(), np.zeros(self.robot.n))
