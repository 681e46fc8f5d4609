"""The models that are shipped for the simulated arms: identified from recordings of the default world, as a user would.

Nothing is read from the world but what a controller logs and an external measuring device sees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from ideal_robot.identification.friction_runs import fit_ripple
from ideal_robot.identification.whole_model import identify_model
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.identification.plan import plan, play_plan
from scenes.result import Progress, part_of, silent
from sim.arm.world import World


def identified_model(robot_name: str, *, seed: int = 1, period: float = 20.0, world: World | None = None,
                     progress: Progress = silent) -> tuple[Model, list[Recording]]:
    """Plays two identification motions on a simulated arm and identifies everything from them.

    Args:
        robot_name: the arm as its data sheet has it.
        seed: of motions and noise.
        period: of the motions [s].
        world: what the arm is like; its default world if None.
        progress: called with the fraction done.
    """
    robot = Robot.load(robot_name)
    if world is not None:
        robot = replace(robot, t_ipo=world.t_ipo, t_position=world.t_position, t_velocity=world.t_velocity)
    recordings = []
    for run in range(2):
        progress(0.4 * run, "planning an identification motion")
        planned = plan(robot, "joint", seed=seed + run, period=period)
        played = part_of(progress, 0.4 * run + 0.1, 0.3)
        recordings.append(play_plan(planned, robot, seed + run, partial(_moving, played), world))
    progress(0.8, "identifying")
    model = identify_model(recordings, robot).model
    return model.with_effects(fit_ripple(recordings, model, robot)), recordings


def _moving(progress: Progress, share: float) -> None:
    progress(share, "moving to be identified")


def write_models(names: Sequence[str], folder: Path) -> list[Path]:
    """Identifies and writes the shipped models."""
    return [identified_model(name)[0].save(folder / f"{name}.json") for name in names]


if __name__ == "__main__":
    import sys

    for path in write_models(sys.argv[1:] or ["kr6", "kr15", "manutec_r15"], Path(__file__).parents[1] / "models"):
        print(path)
