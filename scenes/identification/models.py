"""The models that are shipped for the simulated arms: identified from recordings of the default world, as a user would.

Nothing is read from the world but what a controller logs and an external measuring device sees.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ideal_robot.identification.ripple_fit import fit_ripple
from ideal_robot.identification.whole_model import identify_model
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.identification.plan import plan, play_plan


def identified_model(robot_name: str, *, seed: int = 1, period: float = 20.0) -> tuple[Model, list[Recording]]:
    """Plays two identification motions in the default world of a simulated arm and identifies everything from them."""
    robot = Robot.load(robot_name)
    recordings = [play_plan(plan(robot, "joint", seed=seed + run, period=period), robot, seed + run)
                  for run in range(2)]
    model = identify_model(recordings, robot).model
    return model.with_effects(fit_ripple(recordings, model, robot)), recordings


def write_models(names: Sequence[str], folder: Path) -> list[Path]:
    """Identifies and writes the shipped models."""
    return [identified_model(name)[0].save(folder / f"{name}.json") for name in names]


if __name__ == "__main__":
    import sys

    for path in write_models(sys.argv[1:] or ["kr6", "kr15", "manutec_r15"], Path(__file__).parents[1] / "models"):
        print(path)
