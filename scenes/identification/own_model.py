"""An arm's own model, identified from motions of the simulated arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from ideal_robot.identification.command import judged
from ideal_robot.identification.excitation import Workspace
from ideal_robot.identification.friction_runs import fit_ripple
from ideal_robot.identification.whole_model import identify_model
from ideal_robot.model.model import Model
from ideal_robot.robots.collisions import Obstacle, Shapes
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.identification.plan import plan, play_plan
from scenes.result import Progress, part_of, silent
from sim.arm.world import World


def identified_model(robot_name: str, *, world: World | None = None, boxes: Sequence[Obstacle] = (),
                     progress: Progress = silent) -> tuple[Model, list[Recording]]:
    """Runs two identification motions on a simulated arm and identifies a complete model from them.

    Args:
        robot_name, world: the arm by its data sheet, and its simulated world; the default one if None.
        boxes: boxes that stand in the cell.
        progress: called with the fraction done.
    """
    robot = arm_of(robot_name) if world is None else world.with_cycles(arm_of(robot_name))
    recordings = []
    workspace = replace(Workspace.of(robot), cell=Shapes(robot, boxes=boxes)) if boxes else None
    for run in range(2):
        progress(0.4 * run, "planning an identification motion")
        planned = plan(robot, "joint", seed=run + 1, workspace=workspace)
        played = part_of(progress, 0.4 * run + 0.1, 0.3)
        recordings.append(play_plan(planned, robot, run + 1, partial(_moving, played), world))
    progress(0.8, "identifying")
    model = identify_model(recordings, robot).model
    model = model.with_effects(fit_ripple(recordings, model, robot))
    if model.command is not None and model.controller is not None:
        # The final loop knows the ripple and predicts better than the one that was first compared with the command law.
        model = replace(model, command=judged(model.command, recordings, model, robot))
    return model, recordings


def _moving(progress: Progress, share: float) -> None:
    progress(share, "moving to be identified")
