"""Closing with a path: run, diagnose a motion about the path, extend the model, run again.

The scene's world holds an effect that the model does not know. The run ``oracle`` knows its name and joint, and
estimates its size from the same recording; a size that makes the path worse is not used.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array, interpolated
from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.diagnosis.validation.refit import with_named_effects
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import IdealRobotError
from ideal_robot.feedforward.base import Feedforward, PassThrough
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.progress import Steps
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.closing.drives import DRIVES, controllers_anew
from scenes.closing.loop import ROUNDS, Comparison, Form, Forms, Found, Group, Place, Subject, close
from scenes.closing.result import (
    SHARES,
    Closing,
    Measured,
    Played,
    Words,
    checked_measured,
    tool_deviation,
    visible,
)
from scenes.methods import IDEAL
from scenes.metrics import PathErrors
from scenes.models import model_for
from scenes.path.candidates import AskedMotion, asked_motion, changes, diagnostic_motion
from scenes.path.cell import PathCell, Play, set_up
from scenes.report.page import Report
from scenes.result import Progress, silent
from scenes.scene_files.path_scene import PathScene
from scenes.scene_files.scene import OWN
from scenes.undeclared import declared_world, undeclared_effects

WORDS = Words(
    "path_error_mm", "Path error E_car, aligned [mm]", "measured E_car mm",
    ("model", "E_car timed", "aligned", "geometric", "E_max aligned"), "the model as it was",
    "[G] (14) and (21), of the true TCP [mm].", "Path error, aligned, as far as the arm measures it.",
    ("share of the path's time [%]", "deviation [mm]", "Deviation of the true TCP along the path, aligned."))
IN_TIME = dataclasses.replace(
    WORDS, error="Path error E_car, time-matched [mm]", judged="measured deviation mm",
    decides="Of controllers, how far the tool was from where it was wanted at the same instant, by the motors; of all "
    "else the path error, aligned, as far as the arm measures it.",
    axes=("share of the path's time [%]", "deviation [mm]", "Deviation of the true TCP along the path, time-matched."))
"""The same where controllers are not the model's: there a delay counts as an error."""
_DOUBT_OF_GEARS = 0.3
"""Share by which the give of gears may be wrong that no device on the arm's side has shown: a gear is softer under
small loads than under large ones, by about so much from end to end of its catalogue's stiffness, and motor angles show
nothing of it. What a load's own standard deviation leaves open comes on top."""
_SIGMAS = 2.0
"""Standard deviations that a load's size may be off by: 95 %."""


def close_loop(scene: PathScene, *, measured: str = "tcp", ask: bool = True, out: Path | None = None,
               progress: Progress = silent) -> Closing:
    """Runs a path, diagnoses what the model lacks from a further motion; see ``CloseLoop.__call__``.

    ``ask``: whether the motion that a diagnosis requests is run before the loop gives up.
    """
    checked = checked_measured(measured)
    undeclared = undeclared_effects(scene, arm_of(scene.robot).n)
    # An own model is identified from the arm without the undeclared effects.
    own = scene.model_copy(update={"world": declared_world(scene)}) if scene.model == OWN else scene
    cell = set_up(scene, delay=False, model=model_for(own, arm_of(scene.robot), progress))
    subject = ArmOnPath(cell, checked, ask, drives=DRIVES in undeclared)
    return closed(scene, subject, undeclared, out=out, progress=progress)


def closed(scene: PathScene, subject: ArmOnPath, undeclared: tuple[Place, ...], *, oracle: Feedforward | None = None,
           rounds_at_most: int = ROUNDS, out: Path | None = None, progress: Progress = silent) -> Closing:
    """``close-loop`` on an arm that is already set up, also one without a scene file.

    Args:
        scene: the scene with the path.
        subject: the path, the arm and the model as it was.
        undeclared: effects that the arm has and the model does not know: name, joint.
        oracle: runs the path with the true effects; None: their names and joints are known, their sizes are estimated
            from the first recording.
        rounds_at_most: of finding and trying.
        out: folder for recording, model and report; nothing is written without.
        progress: called with the fraction done.
    """
    cell, job = subject.cell, Steps(progress, SHARES)
    known = cell.model
    job.begin("before")
    before = cell.play(cell.feedforward(IDEAL))
    done = close(subject, known, before, rounds=rounds_at_most, out=out, progress=job.part("rounds"))
    job.begin("oracle")
    moved, oracle_errors = done.found[0].recording, before.errors
    if oracle is not None:
        oracle_errors = cell.play(oracle).errors
    elif undeclared:
        named = tuple(place for place in undeclared if place != DRIVES)
        told = known if subject.anew is None else subject.anew.change(known, before)
        fitted = subject.play(with_named_effects(moved, cell.robot, told, named) if named else told).errors
        # For effects that this arm does not measure the oracle's fit is arbitrary; a fit that makes the path worse is
        # not used.
        oracle_errors = min(fitted, before.errors, key=lambda errors: (
            errors.time_matched if DRIVES in undeclared else errors.aligned).E_car)
    # Where controllers cause a delay, the time-matched error is reported.
    timed = DRIVES in undeclared
    plays = {name: played(name, errors, timed=timed) for name, errors in
             (("before", before.errors), ("after", done.run.errors), ("oracle", oracle_errors))}
    job.begin("report")
    errors_of = {name: play.error for name, play in plays.items()}
    more = {"E_car_time_matched_mm" if timed else "E_car_aligned_mm": errors_of, "measured": subject.measured,
            "measured_before_mm": 1e3 * done.first, "plan": None if subject.plan is None else subject.plan.json()}
    return Closing(scene, undeclared, plays, done, IN_TIME if timed else WORDS, {"diagnostic_motion.parquet": moved},
                   more, subject.section).written(out)


class ArmOnPath(Subject[Play]):
    """A path and its arm, whose model ``close-loop`` extends.

    Args:
        cell: path, arm and the model as it was.
        measured: the quantities that the arm measures.
        ask: whether the motion that a diagnosis requests is run before the loop gives up.
        drives: whether the joint controllers may be others than the model's.
    """

    def __init__(self, cell: PathCell, measured: Measured, ask: bool = False, *, drives: bool = False) -> None:
        self.plan: AskedMotion | None = None
        self.anew: Form | None = None
        self._drives = drives
        self.cell, self._known, self.measured, self._ask, self._round = cell, cell.model, measured, ask, 0

    def play(self, model: Model) -> Play:
        """Runs the motion with a model; raises ``IdealRobotError`` where that is not possible; see ``Subject.play``."""
        tried = dataclasses.replace(self.cell, model=model)
        return tried.play(tried.feedforward(IDEAL))

    def find(self, model: Model, run: Play, progress: Progress) -> Found:
        """Diagnoses what the model lacks, from the last run or from a motion of its own; see ``Subject.find``."""
        # The run is not diagnosed: it decides afterwards which changes are kept.
        self.cell, self._round = dataclasses.replace(self.cell, model=model), self._round + 1
        played = self.cell.play(PassThrough(self.cell.world.t_ipo), path=diagnostic_motion(self.cell))
        moved = visible(played.recording, self.measured)
        if self._drives and self.anew is None:
            self.anew = controllers_anew(self._known, moved, self.cell.robot)
            if self.anew is not None:
                # The joint controllers are changed before other effects are searched in their torques.
                return Found(None, moved, (Group((self.anew,)),))
        return self._suggested(diagnose(moved, self.cell.robot, model=model, progress=progress), moved)

    def _suggested(self, diagnosis: Diagnosis, moved: Recording) -> Found:
        return Found(diagnosis, moved, *changes(self.cell.model, diagnosis, self.measured))

    def readings(self, before: Play, after: Play, known: Model, model: Model) -> list[tuple[Array, Array]]:
        """Measured deviations ``(N,)`` or ``(N, c)`` of two runs [SI]; see ``Subject.readings``."""
        if model.controller is not self.cell.model.controller or model.command is not self.cell.model.command:
            # Controllers affect when the arm reaches a place, so time-matched errors are compared.
            return [(self._in_time(before), self._in_time(after))]
        # Both runs are evaluated with the same assumed gear torques, for each assumed error of them.
        loads = carried(model.effects[len(self._known.effects):])
        path, doubts = self.cell.path, doubts_of(loads) if self.measured == "motor" else (0.0,)
        recordings = [visible(run.recording, self.measured) for run in (before, after)]
        pairs = [[tool_deviation(recording, (path.t, path.q_d, path.counts), self.cell.robot, self._known, loads, doubt)
                  for recording in recordings] for doubt in doubts]
        return [(without, with_it) for without, with_it in pairs]

    def _in_time(self, run: Play) -> Array:
        """How far the tool was, by its motors, from where it was wanted at the same instant ``(N, 3)`` [m]."""
        path, robot = self.cell.path, self.cell.robot
        q = interpolated(path.t, run.recording.t, run.recording.joints("q"))
        return np.asarray(robot.tool_places(q) - robot.tool_places(path.q_d))[path.counts]

    def foreseen(self, forms: Forms, models: list[Model], model: Model, run: Play) -> tuple[list[int], str]:
        """Indices of the forms to run, the most promising first, and why there are none; see ``Subject.foreseen``."""
        if DRIVES in forms[0].places:
            return super().foreseen(forms, models, model, run)
        # A change that explains less of the path error than the present model cannot correct it.
        present = self._left(model, run)
        compared = [Comparison.of(present, self._left(extended, run)) for extended in models]
        order = sorted(range(len(forms)), key=lambda k: compared[k].after)
        best = compared[order[0]]
        if not np.isfinite(best.after):
            return [], "the identified loop cannot be played along the run, with it or without"
        return ([k for k in order if not compared[k].rises],
                f"played on the identified loop it explains less of the run: {1e3 * best.before:.3g} to "
                f"{1e3 * best.after:.3g} mm are left")

    def _left(self, model: Model, run: Play) -> Array:
        try:
            return left_unexplained(self.cell, model, run, self.measured)
        except IdealRobotError:
            return np.empty(0)

    def asked(self, found: Found, model: Model, run: Play, progress: Progress) -> Found | None:
        """The result of a further motion after a round without success; see ``Subject.asked``."""
        if not self._ask or self.plan is not None or found.diagnosis is None:
            return None
        self.plan = asked_motion(self.cell, found.diagnosis, found.recording, self.measured, self._round, progress)
        if self.plan is None or self.plan.diagnosis is None or self.plan.recording is None:
            return None
        return self._suggested(self.plan.diagnosis, self.plan.recording)

    def section(self, page: Report) -> None:
        """Adds the sections about diagnostic motions to the page of the result."""
        if self.plan is not None:
            page.heading("The motion that the diagnosis asked for")
            page.table(["cause", "or", "recorded σ", "planned σ", "distinguishable"], self.plan.table(),
                       self.plan.reason or f"In round {self.plan.round} nothing stayed, and these were open. σ: "
                       "expected distance of the two causes in standard deviations of the noise, by the motion that "
                       "was recorded and by the one that was planned, played and diagnosed.")


def played(name: str, errors: PathErrors, *, timed: bool = False) -> Played:
    """The true errors of a run on a path for the report, with the name of its model.

    Args:
        name: of the model.
        errors: of the true TCP.
        timed: whether the reported error is the time-matched one.
    """
    sizes = (errors.time_matched.E_car, errors.aligned.E_car, errors.geometric.E_car, errors.aligned.E_max)
    told = errors.time_matched if timed else errors.aligned
    deviation = 1e3 * told.deviation
    return Played(errors, 1e3 * told.E_car, [name, *(1e3 * size for size in sizes)], errors.json_mm(),
                  (np.linspace(0.0, 100.0, len(deviation)), deviation))


def carried(effects: tuple[FittedEffect, ...]) -> tuple[FittedEffect, ...]:
    """The effects that change the gear torques."""
    changes = [(effect, effect.effect.loop_change(effect.coefficients, effect.theta)) for effect in effects]
    return tuple(effect for effect, change in changes if change.body or change.gravity is not None)


def doubts_of(loads: tuple[FittedEffect, ...]) -> tuple[float, ...]:
    """Relative errors to assume for the gear deflection under added loads where only motor angles are measured."""
    if not loads:
        return (0.0,)
    doubt = min(float(np.hypot(_DOUBT_OF_GEARS, max(doubt_of_load(load) for load in loads))), 1.0)
    return (0.0, doubt, -doubt)


def doubt_of_load(effect: FittedEffect) -> float:
    """Relative error of the gear torque of an effect, from its own standard deviation."""
    # A body is represented by its mass, and gravity by its two components, as moments have other units.
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    count = 1 if change.body else 2 if change.gravity is not None else len(effect.coefficients)
    size = float(np.linalg.norm(effect.coefficients[:count]))
    return _SIGMAS * float(np.linalg.norm(effect.std[:count])) / max(size, 1e-300)


def left_unexplained(cell: PathCell, model: Model, run: Play, measured: Measured) -> Array:
    """Distance at the tool between the measured joints and a simulated loop's on the same commands ``(N, 3)`` [m].

    A constant difference and a constant delay are removed, as in an aligned path error.

    Args:
        cell: path, arm and how commands reach it.
        model: the model whose loop is simulated.
        run: the run of the arm.
        measured: motor angles where nothing else is measured, else arm angles.

    Raises:
        IdealRobotError: the loop of that model cannot be simulated.
    """
    motion = simulate(loop_model(model, cell.robot, delay=cell.delay), run.q_c)
    angles = run.recording.joints("q" if measured == "motor" else "qa")
    counts = cell.path.counts[: len(motion.t)]
    t = motion.t[: len(counts)][counts]
    seen = interpolated(t, run.recording.t, angles)
    place = cell.robot.tool_places((motion.q_m if measured == "motor" else motion.q_a)[: len(counts)][counts])
    apart = cell.robot.tool_places(seen) - place
    apart, speed = apart - apart.mean(axis=0), np.gradient(place, axis=0)
    return np.asarray(apart - speed * np.sum(apart * speed) / max(np.sum(speed**2), 1e-300))
