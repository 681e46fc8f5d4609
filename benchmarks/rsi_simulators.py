"""Our RSI server against public simulators of the controller's side, each in one of its own cycles.

    python benchmarks/rsi_simulators.py FOLDER

FOLDER holds the simulators as its README says: kuka_experimental.py, adamleon.py, kroshu.py, fzi/ and stubs/ for the
ROS modules they import; the fifth, RSIPI, is a package (pip install RSIPI). Prints a table; ends with 1 if one of them
did not complete.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ideal_robot.robots.robot import Robot
from ideal_robot.rsi.message import RsiFormat
from scenes.rsi.server import RsiRun
from scenes.rsi.setup import rsi_server


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


SIMULATORS = {
    "ros-industrial/kuka_experimental": Simulator(
        "kuka_experimental.py", ("kuka_experimental.py", "127.0.0.1", "{port}"), ("stubs",), 0.004),
    "adamleon/kuka": Simulator("adamleon.py", ("adamleon.py", "127.0.0.1", "{port}"), ("stubs",), 0.004),
    "kroshu/kuka_drivers": Simulator("kroshu.py", ("kroshu.py",), ("stubs",), 0.04),
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
    """One motion of every axis out and back against one simulator.

    Args:
        folder: where the simulators lie.
        name: key of ``SIMULATORS``.
        method: see ``rsi_server``.
        size: how far each axis goes [deg].
        seconds: how long the motion takes [s].
    """
    simulator, robot = SIMULATORS[name], Robot.load("kr6")
    home = home_of(folder, name)
    if home is None:
        raise FileNotFoundError(simulator.file)
    # The simulators move whatever they are told; the arm's own zero is put where they start.
    start = np.array(simulator.start)
    sign = np.array(robot.data["rsi"]["axis_sign"])
    t = np.arange(0.0, seconds, simulator.cycle)
    q = robot.home + np.radians(size) * np.sin(np.pi * t / t[-1])[:, None] ** 4
    form = RsiFormat.read(home / simulator.config, robot.n) if simulator.config else None
    with tempfile.TemporaryDirectory() as room:
        urdf = Path(room) / "arm.urdf"
        urdf.write_bytes(robot.urdf.read_bytes())
        text = robot.urdf.with_suffix(".toml").read_text()
        zero = (start - sign * np.degrees(robot.home)).tolist()
        urdf.with_suffix(".toml").write_text(_with_zero(text, zero))
        path = Path(room) / "path.csv"
        pd.DataFrame({"t": t, **{f"q_d_{i + 1}": q[:, i] for i in range(robot.n)}}).to_csv(path, index=False)
        with (rsi_server(path, robot=str(urdf), model=_model(), method=method, cycle=simulator.cycle, port=0, form=form)
              as server, Running(home, simulator, server.link.address[1], Path(room))):
            return server.play(patience=20.0)


def _with_zero(text: str, zero: list[float]) -> str:
    lines = [line for line in text.splitlines() if not line.startswith("axis_zero")]
    return "\n".join(lines).replace("[rsi]", f"[rsi]\naxis_zero = {zero}") + "\n"


def _model() -> Path:
    from scenes.models import shipped_model

    return shipped_model("kr6")


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


def main() -> int:
    """Prints one row a simulator."""
    folder = Path(sys.argv[1]).resolve() if len(sys.argv) == 2 else None
    if folder is None or not folder.is_dir():
        print(__doc__)
        return 2
    print("| simulator | cycle ms | answered | lost | late | time stamps | largest error mrad | ended |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    failed = 0
    for name, simulator in SIMULATORS.items():
        if home_of(folder, name) is None:
            print(f"| {name} | | | | | | | neither in the folder nor installed |")
            continue
        run = played(folder, name)
        failed += run.failure is not None
        recording = run.recording
        # These simulators are where they were commanded, a cycle later.
        error = 1e3 * np.abs(recording.joints("q")[1:] - recording.joints("q_c")[:-1]).max()
        print(f"| {name} | {1e3 * simulator.cycle:.0f} | {len(recording.t)} of {run.rows} | {run.counts['lost']} | "
              f"{run.counts['late']} | {run.stamps} | {error:.3f} | {run.failure or 'path complete'} |")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
