"""Five commands make an arm ideal: played on arms that are simulated behind their makers' interfaces."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer

from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from studies.controlled_arms import motion
from studies.other_arms import crx, fr3, kr6
from studies.report import head, row

DURATION = 8.0
"""Of a path [s]."""
QUICK = 1.5
"""How many times as fast the quick path is played."""
Served = Callable[[Path], AbstractContextManager[tuple[str, str]]]
"""Serves an arm whose files are written to a folder; yields its address and what ``--robot`` names."""


@dataclass(frozen=True)
class Simulated:
    """An arm behind its maker's interface.

    Attributes:
        title: of arm and interface.
        by: whose simulator it is.
        served: serves it.
        quick: whether a quick path is played, too.
    """

    title: str
    by: str
    served: Served
    quick: bool = False


@contextmanager
def _fr3(folder: Path) -> Iterator[tuple[str, str]]:
    with fr3(folder, host="127.0.0.65", slowed=0.0) as (address, urdf):
        yield address, str(urdf)


@contextmanager
def _crx(folder: Path) -> Iterator[tuple[str, str]]:
    with crx(folder, slowed=0.0) as (address, urdf):
        yield address, str(urdf)


def _kr6(wire: str) -> Served:
    @contextmanager
    def served(folder: Path) -> Iterator[tuple[str, str]]:
        with kr6(wire) as address:
            yield address, "kr6"
    return served


ARMS = {
    "fr3": Simulated("Franka FR3, FCI", "franky-sim (MuJoCo)", _fr3, quick=True),
    "crx": Simulated("FANUC CRX-10iA/L, Stream Motion", "airo-fanuc", _crx, quick=True),
    "ros2": Simulated("KR 6, ROS 2", "ours, by ros2_control's documents", _kr6("ros2")),
    "egm": Simulated("KR 6, ABB EGM", "ours, by ABB's manual", _kr6("egm")),
    "rtde": Simulated("KR 6, UR RTDE", "ours, by UR's documents", _kr6("rtde")),
    "rsi": Simulated("KR 6, KUKA RSI", "ours", _kr6("rsi")),
}


def five_commands(rows: Annotated[str, typer.Option(help="Arms, with commas between.")] = ",".join(ARMS),
                  seed: int = 1, period: float = 20.0, method: str = "", folder: Path = Path("out/five-commands"),
                  ) -> None:
    """Five commands on each arm, plan-identification to play --compare: errors of a path before and after.

    The commands are those of the command line, each in a process of its own; what stands in the folder from before is
    not played again. Errors are root mean squares, desired minus measured joint positions at the same instant over all
    joints, and of the flange.

    Args:
        rows: arms.
        seed: of the paths.
        period: of the identification's motion [s].
        method: of precorrect; its usual one if empty.
        folder: where recordings, models and figures are kept.
    """
    unknown = [name for name in rows.split(",") if name not in ARMS]
    if unknown:
        raise InputError(f"expected of {', '.join(ARMS)}", field="--rows", value=unknown[0])
    head("arm and interface", "simulator", "path", "before [mrad]", "after", "expected", "flange before [mm]", "after")
    for name in rows.split(","):
        arm = ARMS[name]
        for path in ("path", "quick") if arm.quick else ("path",):
            try:
                played = chain(arm, folder.resolve() / name, path, seed, period, method)
            except IdealRobotError as error:
                row(arm.title, arm.by, path, str(error), "", "", "", "")
                continue
            before, after = played["before"], played["after"]
            row(arm.title, arm.by, path, *(f"{value:.3g}" for value in (
                before["joints"], after["joints"], played["expected"], before["flange"], after["flange"])))


def chain(arm: Simulated, folder: Path, path: str, seed: int, period: float, method: str = "") -> dict[str, Any]:
    """Plays the five commands of one arm.

    Args:
        arm: which one.
        folder: where its files are; those that are there are not made again.
        path: ``path``, or ``quick`` for the same in less time.
        seed, period, method: see ``five_commands``.

    Returns errors ``before`` and ``after``, of ``joints`` [mrad] and ``flange`` [mm], and what was ``expected`` [mrad].

    Raises:
        IdealRobotError: a command has failed.
    """
    robot = identified(arm, folder, period)
    corrected, played = folder / f"{path}_corrected.parquet", folder / f"{path}_played.json"
    # Without the path as it is a play was interrupted.
    if not played.is_file() or "before" not in json.loads(played.read_text(encoding="utf-8")):
        write_path(folder / f"{path}.csv", robot, seed, DURATION, QUICK if path == "quick" else 1.0)
        command(folder, "precorrect", f"{path}.csv", "--model", "model.json", "--robot", robot, "-o", corrected.name,
                 "--json", f"{path}_corrected.json", *(["--method", method] if method else []))
        with arm.served(folder) as (address, _):
            command(folder, "play", corrected.name, "--compare", "-o", f"{path}_played.parquet", "--json", played.name,
                     "--robot", robot, "--arm", address)
    figures = json.loads(played.read_text(encoding="utf-8"))
    return {"expected": expected(folder / f"{path}_corrected.json"), **{
        name: {"joints": left(folder / f"{path}_played{suffix}.parquet"),
               "flange": found["flange_error"]["time_matched"]["E_car"]}
        for name, suffix, found in (("before", "_before", figures["before"]), ("after", "", figures))}}


def identified(arm: Simulated, folder: Path, period: float) -> str:
    """Makes ``model.json`` by the first three commands, where the folder has none; returns what ``--robot`` names.

    Args:
        arm, folder, period: see ``chain``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The files of robots of others are written when they are served.
    robot = next(map(str, folder.glob("*.urdf")), "kr6")
    if not (folder / "moved.parquet").is_file():
        with arm.served(folder) as (address, robot):
            command(folder, "plan-identification", "--robot", robot, "--period", str(period), "--out", "plan")
            command(folder, "play", "plan/commands.csv", "--robot", robot, "--arm", address, "-o", "moved.parquet")
    if not (folder / "model.json").is_file():
        command(folder, "identify", "moved.parquet", "--robot", robot, "--model", "model.json")
    return robot


def write_path(file: Path, robot: str, seed: int, duration: float, faster: float = 1.0) -> None:
    """Writes a path of a robot's joints that is drawn at random, in its cycle, so many times as fast.

    Args:
        file, robot: CSV, and what ``--robot`` names.
        seed, duration, faster: of the path, before it is made faster [s].
    """
    known = Robot.load(robot)
    desired = motion(known, np.random.default_rng(seed), duration, faster * known.t_ipo)
    pd.DataFrame({"t": known.t_ipo * np.arange(len(desired)),
                  **{f"q_d_{i + 1}": desired[:, i] for i in range(known.n)}}).to_csv(file, index=False)


def expected(figures: Path) -> float:
    """What ``precorrect`` expects the corrected path to leave, over all joints [mrad]."""
    values = json.loads(figures.read_text(encoding="utf-8"))
    return float(np.sqrt(np.mean(np.square(values["expected_rms_error_mrad"]["corrected"]))))


def left(recording: Path, since: float = 0.0) -> float:
    """Desired minus measured positions over all joints and instants from one on, root mean square [mrad].

    Args:
        recording: of a played path.
        since: instant [s].
    """
    rec = Recording.read(recording)
    return 1e3 * float(np.sqrt(np.mean((rec.joints("q_d") - rec.joints("q"))[rec.t >= since] ** 2)))


def command(folder: Path, *words: str) -> None:
    """A verb of the command line in a process of its own, in a folder; raises IdealRobotError where it fails."""
    print(f"ideal-robot {' '.join(words)}", file=sys.stderr, flush=True)
    done = subprocess.run([sys.executable, "-c", "from scenes.cli import main; main()", *words], cwd=folder, text=True,
                          capture_output=True, check=False)
    (folder / f"{words[0]}.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
    if done.returncode:
        raise IdealRobotError(f"{words[0]}: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
