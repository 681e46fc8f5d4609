"""Diagnostic motions of an arm on a path, and the model changes that a diagnosis suggests."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Diagnosis, DiagnosisPlan, diagnose, open_questions, plan_diagnosis
from ideal_robot.diagnosis.prior import TYPE
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.closing.loop import Form, Group, Step, places_of, said
from scenes.closing.result import Measured, at_speeds, visible
from scenes.path.cell import PathCell, training_path, without_tcp
from scenes.result import Progress, part_of, silent
from scenes.scene_files.path_scene import JointPath

_ONLY_BEHIND = ("only a device on the arm's side, or a clamped flange ([J]), shows a gear's give or a joint's zero; "
                "motor angles and currents do not")
_SHOWN_BEHIND = "the arm angles, which are measured, show what a gear gives better than currents"


def changes(model: Model, found: Diagnosis, measured: Measured) -> tuple[tuple[Group, ...], tuple[Step, ...]]:
    """Model changes that a diagnosis suggests, as groups to try, and those that are not tried, with reasons.

    Args:
        model: the model that was given to the diagnosis.
        found: in a recording of the arm.
        measured: the quantities that the arm measures.
    """
    effects = [effect.fitted for effect in (*found.effects, *found.unknown)]
    reasons = [_not_tried(effect, measured) for effect in effects]
    refused = tuple(Step(said(effect.name, effect.joint), reason, places=places_of((effect,)))
                    for effect, reason in zip(effects, reasons, strict=True) if reason)
    acting = tuple(effect for effect, reason in zip(effects, reasons, strict=True) if not reason)
    # Effects too small to be reported are in the extended model, too, and explain their part of the error.
    more = () if found.model is None else found.model.effects[len(model.effects):]
    added = (*acting, *(effect for effect in more if effect not in effects and not _not_tried(effect, measured)))
    apart = [(Form.adding(said(effect.name, effect.joint), (effect,)),) for effect in acting]
    if found.model is None or found.taken_for != TYPE:
        # The groups are of the same arm, so earlier parameters are kept.
        together = (Form.adding("all that was found", added),) if added else ()
        return (Group(together, tuple(apart)),), refused
    other = replace(found.model, effects=model.effects)
    whole = Form(f"{TYPE}, and all that was found", lambda model, run: other.with_effects(added), places_of(added))
    return (Group((whole,), ((Form(TYPE, lambda model, run: other),), *apart)),), refused


def _not_tried(effect: FittedEffect, measured: Measured) -> str:
    """Why an effect is not tried; empty where it is."""
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    if effect.domain == SENSOR or change.nowhere:
        return f"does not act: {change.nowhere or 'no sensor takes part in this path'}"
    if effect.domain != MOTOR_TORQUE or not (change.of_gear or change.zero):
        return ""
    if measured == "motor":
        return _ONLY_BEHIND
    return _SHOWN_BEHIND if change.of_gear else ""


# The diagnostic motion of every round, and the one that a diagnosis requests.

_BEYOND = 1.05
"""Of a path's range that is covered: a path turns round at its ends, and of places where it has never been the motion
can say nothing of what depends on place."""


def diagnostic_motion(cell: PathCell) -> JointPath:
    """All joints about the path's postures, at full, half and a fifth of the path's speed, one after another."""
    fast = covering(training_path(cell.path, cell.world.t_ipo).q_d, cell.path.q_d, cell.robot)
    # A wider motion is faster, so it is slowed down accordingly.
    fastest = float(np.max(np.abs(np.diff(fast, axis=0)) / (cell.world.t_ipo * cell.robot.v_max)))
    q_d = at_speeds(fast, tuple(slowness * max(1.0, fastest) for slowness in (1.0, 2.0, 5.0)))
    t = cell.world.t_ipo * np.arange(float(len(q_d)))
    counts = np.ones(len(q_d), dtype=bool)
    return JointPath(q_d, np.zeros((len(q_d), 3)), np.asarray(t), counts)


def covering(motion: Array, path: Array, robot: Robot) -> Array:
    """The motion, widened and centred so that each joint covers its range on a path.

    Args:
        motion: joint angles ``(M, n)`` [rad].
        path: likewise ``(N, n)``, within the limits.
        robot: the robot whose limits hold.
    """
    low, high = path.min(axis=0), path.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    reach = np.minimum(_BEYOND * half, np.minimum(robot.q_max - middle, middle - robot.q_min))
    least, most = motion.min(axis=0), motion.max(axis=0)
    short = (most < high) | (least > low)
    factor = np.where(short, 2.0 * reach / np.maximum(most - least, 1e-12), 1.0)
    moved = middle + factor * (motion - 0.5 * (least + most))
    return np.asarray(np.where(short, moved, motion))


@dataclass(frozen=True)
class AskedMotion:
    """A motion that a diagnosis requested, with its result.

    Attributes:
        round: from 1.
        plan: pairs to be distinguished and the motion; None where none lies within the limits.
        reason: why there is no motion; empty where there is one.
        recording, diagnosis: of the motion, where it was run.
    """

    round: int
    plan: DiagnosisPlan | None
    reason: str = ""
    recording: Recording | None = field(default=None, repr=False)
    diagnosis: Diagnosis | None = field(default=None, repr=False)

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        effects = None if self.diagnosis is None else [
            {"effect": effect.fitted.name, "joint": effect.fitted.joint,
             "indistinguishable_from": list(effect.indistinguishable_from)} for effect in self.diagnosis.effects]
        return {"round": self.round, **({} if self.plan is None else self.plan.to_dict()),
                "played": self.recording is not None, "reason": self.reason or None, "found": effects}

    def table(self) -> list[list[Any]]:
        """One row per pair: cause, rival, σ before and planned, whether the motion distinguishes them."""
        return [] if self.plan is None else [
            [pair.cause, pair.rival or "none", pair.before.sigma, pair.planned.sigma,
             "yes" if pair.told_apart else pair.only] for pair in self.plan.pairs]


def asked_motion(cell: PathCell, found: Diagnosis, moved: Recording, measured: Measured, round_: int,
                 progress: Progress = silent) -> AskedMotion | None:
    """Plans, runs and diagnoses the motion that a diagnosis requests; None where it requests none.

    Args:
        cell: path, arm and present model.
        found: the diagnosis with that model.
        moved: the diagnosed recording.
        measured: the quantities that the arm measures.
        round_: from 1.
        progress: called with the fraction done.
    """
    questions = open_questions(found)
    if not questions.asks:
        return None
    try:
        plan = plan_diagnosis(moved, cell.robot, questions, model=cell.model, seed=cell.seed,
                              progress=part_of(progress, 0.0, 0.5, "planned motion"))
    except InputError as error:
        return AskedMotion(round_, None, str(error))
    if not plan.useful:
        return AskedMotion(round_, plan, "no motion within the limits distinguishes them")
    progress(0.5, "playing the planned motion")
    t_ipo = cell.world.t_ipo
    played = visible(cell.play(PassThrough(t_ipo), path=without_tcp(plan.commands, t_ipo)).recording, measured)
    again = diagnose(played, cell.robot, model=cell.model, progress=part_of(progress, 0.6, 0.4, "planned motion"))
    return AskedMotion(round_, plan, "", played, again)
