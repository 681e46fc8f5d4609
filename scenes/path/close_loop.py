"""The whole circle on a simulated arm: run, diagnose, extend the model, run again; path error before and after.

The scene's world holds an effect that the model does not know. The oracle knows its name and joint, and estimates
its size from the same recording; a size that makes the path worse it leaves out.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.diagnosis.validation.refit import with_named_effects
from ideal_robot.feedforward.base import Feedforward, PassThrough
from ideal_robot.model.model import Model
from ideal_robot.progress import Steps
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.measured import checked_measured, visible
from scenes.methods import IDEAL
from scenes.metrics import PathErrors
from scenes.models import model_for
from scenes.path.adoption_on_path import Step, adopt_on_path, measured_error
from scenes.path.asked_motion import AskedMotion, asked_motion
from scenes.path.cell import PathCell, set_up
from scenes.path.close_loop_page import write_circle
from scenes.path.close_loop_result import CloseLoopResult
from scenes.path.diagnostic_motion import diagnostic_motion
from scenes.path.last_good import last_good
from scenes.result import Progress, part_of, silent
from scenes.scene_files.path_scene import PathScene
from scenes.scene_files.scene import OWN
from scenes.undeclared import declared_world, undeclared_effects

ROUNDS = 3
"""Of run and diagnosis, at most."""
SHARES = {"before": 0.02, "rounds": 0.78, "oracle": 0.1, "report": 0.1}
"""Measured shares of the time."""
SHARES_OF_ROUND = {"moving": 0.12, "diagnosis": 0.63, "adopting": 0.1, "asking": 0.15}
"""Those of a round; a motion is asked for in one of them at most."""
_LEFT = 0.4
"""Of the rounds' time, what a round leaves to those after it, which need not come."""


def close_loop(scene: PathScene, *, measured: str = "tcp", ask: bool = True, out: Path | None = None,
               progress: Progress = silent) -> CloseLoopResult:
    """Plays a path, finds what its model misses from a diagnostic motion, extends the model and plays it again.

    What does not lower the path error that the arm measures is taken back; the rounds end when nothing more is found.
    Whatever ends it early, the folder holds the model of the last round that was done.

    Args:
        scene: what to play.
        measured: what the arm measures: ``motor``, ``arm`` or ``tcp`` (``scenes.measured``).
        ask: whether the motion that a diagnosis asks for is played before the loop gives up.
        out: folder for recording, model and report; nothing is written without.
        progress: called with the fraction done.

    Raises:
        InputError: a scene whose world holds nothing undeclared or cannot be closed, or another word for what is
            measured.
    """
    checked_measured(measured)
    undeclared = undeclared_effects(scene, Robot.load(scene.robot).n)
    # An own model is of the arm as it was before.
    own = scene.model_copy(update={"world": declared_world(scene)}) if scene.model == OWN else scene
    cell = set_up(scene, delay=False, model=model_for(own, Robot.load(scene.robot), progress))
    return closed(scene, cell, undeclared, measured=measured, ask=ask, out=out, progress=progress)


def closed(scene: PathScene, cell: PathCell, undeclared: tuple[tuple[str, int], ...], *, measured: str = "tcp",
           oracle: Feedforward | None = None, rounds_at_most: int = ROUNDS, ask: bool = False, out: Path | None = None,
           progress: Progress = silent) -> CloseLoopResult:
    """The same with a cell that is set up: its arm may be one that no scene file describes.

    Args:
        scene: whose path the cell plays.
        cell: path, arm and the model as it was.
        undeclared: effects that the arm has and the model does not know: name, joint.
        measured: what the arm measures.
        oracle: plays what an oracle knows of the arm; None: name and joint, and the size from the first recording.
        rounds_at_most: of run and diagnosis.
        ask: whether the motion that a diagnosis asks for is played before the loop gives up.
        out: folder for recording, model and report; nothing is written without.
        progress: called with the fraction done.
    """
    seen_by = checked_measured(measured)
    job = Steps(progress, SHARES)
    job.begin("before")
    known, before = cell.model, cell.play(cell.feedforward(IDEAL))
    first = measured_error(before, cell.path, cell.robot, known, seen_by)
    steps: tuple[Step, ...] = ()
    present = before
    rounds: list[tuple[Diagnosis, Recording]] = []
    plan: AskedMotion | None = None
    with last_good(out) as keep:
        for round_ in range(1, rounds_at_most + 1):
            before_it = 1.0 - _LEFT ** (round_ - 1)
            within = Steps(part_of(job.part("rounds"), before_it, (1.0 - _LEFT) * (1.0 - before_it)), SHARES_OF_ROUND)
            within.begin("moving", f"round {round_}: diagnostic motion")
            keep.round = round_
            moved = visible(cell.play(PassThrough(cell.world.t_ipo), path=diagnostic_motion(cell)).recording, seen_by)
            # The run takes no part in the diagnosis: it decides afterwards what goes into the loop.
            diagnosis = diagnose(moved, cell.robot, model=cell.model, progress=within.part("diagnosis"))
            rounds.append((diagnosis, moved))
            within.begin("adopting", f"round {round_}: what was found is tried")
            model, present, tried = adopt_on_path(cell, diagnosis, moved, present, known, seen_by, round_)
            steps += tried
            if ask and model is cell.model and plan is None:
                # Before it gives up: what could not be told apart may be told by another motion.
                plan = asked_motion(cell, diagnosis, moved, seen_by, round_, within.part("asking"))
                if plan is not None and plan.diagnosis is not None and plan.recording is not None:
                    model, present, tried = adopt_on_path(cell, plan.diagnosis, plan.recording, present, known,
                                                          seen_by, round_)
                    steps += tried
            if model is cell.model:
                break
            keep.model(model)
            cell = dataclasses.replace(cell, model=model)
        keep.round = 0
        job.begin("oracle")
        found, recording = rounds[0]
        if oracle is None and not undeclared:
            told = before.errors
        elif oracle is None:
            told = _played(cell, with_named_effects(recording, cell.robot, known, undeclared))
            # Told of what this arm does not measure, it finds any size: nobody would leave that in the loop.
            told = min(told, before.errors, key=lambda errors: errors.aligned.E_car)
        else:
            told = cell.play(oracle).errors
        result = CloseLoopResult(scene, undeclared, before.errors, present.errors, told, found, recording, seen_by,
                                 first, steps, plan)
        job.begin("report")
        return result if out is None else write_circle(result, cell.model, out)


def _played(cell: PathCell, model: Model) -> PathErrors:
    again = dataclasses.replace(cell, model=model)
    return again.play(again.feedforward(IDEAL)).errors
