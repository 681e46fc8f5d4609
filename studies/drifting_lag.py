"""A joint controller whose lag drifts while a path of two minutes is played, with and without adaptation."""

from __future__ import annotations

from pathlib import Path

from ideal_robot.errors import IdealRobotError
from studies.five_commands import ARMS, command, identified, left, write_path
from studies.other_arms import crx
from studies.report import head, row


def drifting_lag(seed: int = 1, duration: float = 120.0, low: float = 0.084, high: float = 0.18,
                 methods: str = "none,ideal,adapted", folder: Path = Path("out/drifting-lag")) -> None:
    """Errors of a path behind FANUC's emulated controller whose lag goes from one value to another meanwhile.

    The arm is identified by three of the five commands with the emulator's own lag of 125 ms. Measured on an arm, by
    the emulator's makers: 84 to 180 ms, by duty. Errors are desired minus measured joint positions at the same instant,
    root mean squares over all joints, of the whole path and of its second half. The guard knows the identified loop
    with every method, and that loops drift.

    Args:
        seed: of the path.
        duration: of the path, and of the drift [s].
        low, high: lag at the begin and at the end [s].
        methods: with commas between.
        folder: where recordings and the model are kept; what is there is not played again.
    """
    folder = folder.resolve()
    robot = identified(ARMS["crx"], folder, 20.0)
    write_path(folder / "path.csv", robot, seed, duration)
    head("method", "whole path [mrad]", "second half")
    for method in methods.split(","):
        played = folder / f"{method}.parquet"
        if not played.is_file():
            with crx(folder, slowed=0.0, lag=(low, high), drifts=duration) as (address, _):
                try:
                    command(folder, "play", "path.csv", "--robot", robot, "--arm", address, "--method", method,
                            "--model", "model.json", "-o", played.name)
                except IdealRobotError as error:
                    row(method, str(error), "")
                    continue
        row(method, f"{left(played):.3g}", f"{left(played, 0.5 * duration):.3g}")
