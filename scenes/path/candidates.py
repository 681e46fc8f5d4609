"""The motions that an arm on a path is diagnosed from, and the changes of its model that a diagnosis suggests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Diagnosis, DiagnosisPlan, diagnose, open_questions, plan_diagnosis
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.prior import TYPE
from ideal_robot.diagnosis.validation.refit import beside_held_model, friction_anew
from ideal_robot.diagnosis.validation.transfer import adopted, behind_gears, with_joint
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, TCP_POSITION, FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.closing.loop import Form, Forms, Group, Step, places_of, said
from scenes.closing.result import Measured, at_speeds, visible
from scenes.path.cell import PathCell, training_path, without_tcp
from scenes.result import Progress, part_of, silent
from scenes.scene_files.path_scene import JointPath

_ONLY_BEHIND = ("only a device on the arm's side, or a clamped flange ([J]), shows a gear's give or a joint's zero; "
                "motor angles and currents do not")
_SHOWN_BEHIND = "the arm angles, which are measured, show what a gear gives better than currents"
_NO_SIZE = "beside the model as it is it has no size that physics allows"
_HELD = "the model's parameters held"
_REFITTED = "with the joint's friction fitted anew"
Effects = tuple[FittedEffect, ...]


@dataclass(frozen=True)
class Candidates:
    """What the diagnosis of a recording suggests for an arm and its model.

    Attributes:
        moved: the recording.
        run: the last play of the path, as far as it was measured.
    """

    model: Model
    found: Diagnosis
    moved: Recording
    run: Recording
    robot: Robot
    measured: Measured

    def groups(self) -> tuple[tuple[Group, ...], tuple[Step, ...]]:
        """All that moves the joints, together and apart, then all that only the tool shows; and what is not tried.

        Effects of the torque come in two forms: as large as they are beside the model as it is, and with the friction
        that their joint has in the joint fit, for dry friction that rises towards standstill leaves less to the Coulomb
        term. Where the arm is another of its type, the friction of each joint is a change of its own: as the joint fit
        has it, or fitted beside all else.
        """
        effects = [effect.fitted for effect in (*self.found.effects, *self.found.unknown)]
        refused, torque, rest = _sorted(effects, self.measured)
        at_tool = [effect for effect in rest if effect.domain == TCP_POSITION]
        behind = [effect for effect in rest if effect.domain != TCP_POSITION]
        regression = torque_regression(self.moved, self.robot, self.model, payload=True)
        # What does not act on the path takes its share of the recording all the same.
        places = {_place(effect) for effect in torque}
        held = tuple(e for e in beside_held_model(regression, self.model, effects) if _place(e) in places)
        of_gears = () if self.measured == "motor" else behind_gears(self.model, self.found, self.run, self.robot)
        whole = [*([Form.adding(f"all that was found, {_HELD}", (*held, *of_gears))] if held or of_gears else []),
                 *self._predicting()]
        by_joint, no_size = self._by_joint(torque, held)
        apart = [*((Form.adding(said(effect.name, effect.joint), (effect,)),) for effect in behind), *by_joint,
                 *self._friction_anew(regression)]
        return (Group(tuple(whole), tuple(apart)), Group.adding(at_tool)), (*refused, *no_size)

    def _predicting(self) -> list[Form]:
        """The changed joints that predict the last play better, and gears whose give it shows."""
        predicting = adopted(self.model, self.found, self.run, self.robot)
        more = predicting.effects[len(self.model.effects):]
        laws = zip(predicting.friction.laws, self.model.friction.laws, strict=True)
        changed = more or any(a is not b for a, b in laws)
        if not changed or any(_not_of_currents(effect, self.measured) for effect in more):
            return []
        return [Form("all that predict the run better", lambda model, run: predicting, places_of(more))]

    def _by_joint(self, torque: Sequence[FittedEffect], held: Effects) -> tuple[list[Forms], list[Step]]:
        """The effects of each joint's torque, and those that come in no form."""
        result, refused = list[Forms](), list[Step]()
        for joint in dict.fromkeys(effect.joint for effect in torque):
            own = tuple(effect for effect in torque if effect.joint == joint)
            of_held = tuple(effect for effect in held if effect.joint == joint)
            label = " and ".join(said(effect.name, effect.joint) for effect in own)
            forms = [Form.adding(f"{label}, {_HELD}", of_held)] if of_held else []
            if self.found.model is not None and joint:
                forms.append(self._refitted(f"{label}, {_REFITTED}", self.found.model, joint, own))
            result += [tuple(forms)] if forms else []
            refused += [] if forms else [Step(label, _NO_SIZE, places=places_of(own))]
        return result, refused

    def _friction_anew(self, regression: Regression) -> list[Forms]:
        """The friction of each joint, where the arm is another of its type."""
        joints = tuple(range(1, self.robot.n + 1)) if self.found.taken_for == TYPE else ()
        return [tuple(self._refitted(f"friction of joint {joint} fitted anew", fit, joint, ())
                      for fit in (anew, self.found.model) if fit is not None)
                for joint, anew in friction_anew(regression, self.model, joints).items()]

    @staticmethod
    def _refitted(label: str, fitted: Model, joint: int, effects: Effects) -> Form:
        return Form(label, lambda model, run: with_joint(model, fitted, joint, effects), places_of(effects))


def _sorted(effects: Sequence[FittedEffect],
            measured: Measured) -> tuple[list[Step], list[FittedEffect], list[FittedEffect]]:
    """What is not tried, effects of the torque, and those behind the gears."""
    refused, torque, behind = list[Step](), list[FittedEffect](), list[FittedEffect]()
    for effect in effects:
        nowhere = effect.effect.loop_change(effect.coefficients, effect.theta).nowhere
        if effect.domain == SENSOR:
            nowhere = "no sensor takes part in this path"
        if reason := f"does not act: {nowhere}" if nowhere else _not_of_currents(effect, measured):
            refused.append(Step(said(effect.name, effect.joint), reason, places=places_of((effect,))))
        else:
            (torque if effect.domain == MOTOR_TORQUE else behind).append(effect)
    return refused, torque, behind


def _place(effect: FittedEffect) -> tuple[str, str, tuple[float, ...]]:
    return effect.name, f"{effect.channel}:{effect.joint}:{dict(effect.data)}", effect.theta


def _not_of_currents(effect: FittedEffect, measured: Measured) -> str:
    """Why what currents say of a gear or a joint's zero is not taken; empty where it may be, or they did not say it."""
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    gear = change.gear_compliance is not None or bool(change.half_gap)
    if effect.domain != MOTOR_TORQUE or not (gear or change.zero):
        return ""
    if measured == "motor":
        return _ONLY_BEHIND
    return _SHOWN_BEHIND if gear else ""


# The motion of every round, and the one that a diagnosis asks for.

_BEYOND = 1.05
"""Of a path's range that is covered: a path turns round at its ends, and of places where it has never been the motion
can say nothing of what depends on place."""


def diagnostic_motion(cell: PathCell) -> JointPath:
    """All joints about the path's postures, at full, half and a fifth of the path's speed, one after another."""
    fast = covering(training_path(cell.path, cell.world.t_ipo).q_d, cell.path.q_d, cell.robot)
    # Wider is faster.
    fastest = float(np.max(np.abs(np.diff(fast, axis=0)) / (cell.world.t_ipo * cell.robot.v_max)))
    q_d = at_speeds(fast, tuple(slowness * max(1.0, fastest) for slowness in (1.0, 2.0, 5.0)))
    t = cell.world.t_ipo * np.arange(float(len(q_d)))
    counts = np.ones(len(q_d), dtype=bool)
    return JointPath(q_d, np.zeros((len(q_d), 3)), np.asarray(t), counts)


def covering(motion: Array, path: Array, robot: Robot) -> Array:
    """A motion whose joints reach to both ends of a path: those that do not are widened and centred on its range.

    Args:
        motion: joint angles ``(M, n)`` [rad].
        path: likewise ``(N, n)``, within the limits.
        robot: whose limits hold.
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
    """What a diagnosis asked for, and what came of it.

    Attributes:
        round: from 1.
        plan: pairs to be told apart and the motion; None where none lies within the limits.
        reason: why there is no motion; empty where there is one.
        recording, diagnosis: of the motion, where it was played.
    """

    round: int
    plan: DiagnosisPlan | None
    reason: str = ""
    recording: Recording | None = field(default=None, repr=False)
    diagnosis: Diagnosis | None = field(default=None, repr=False)

    def json(self) -> dict[str, Any]:
        """For ``--json``."""
        effects = None if self.diagnosis is None else [
            {"effect": effect.fitted.name, "joint": effect.fitted.joint,
             "indistinguishable_from": list(effect.indistinguishable_from)} for effect in self.diagnosis.effects]
        return {"round": self.round, **({} if self.plan is None else self.plan.to_dict()),
                "played": self.recording is not None, "reason": self.reason or None, "found": effects}

    def table(self) -> list[list[Any]]:
        """One row a pair: cause, rival, σ before and planned, whether the motion tells them."""
        return [] if self.plan is None else [
            [pair.cause, pair.rival or "none", pair.before.sigma, pair.planned.sigma,
             "yes" if pair.told_apart else pair.only] for pair in self.plan.pairs]


def asked_motion(cell: PathCell, found: Diagnosis, moved: Recording, measured: Measured, round_: int,
                 progress: Progress = silent) -> AskedMotion | None:
    """Plans, plays and diagnoses what a diagnosis asks for; None where it asks for nothing.

    Args:
        cell: path, arm and present model.
        found: what the diagnosis found with that model.
        moved: the recording it was found in.
        measured: what the arm measures.
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
        return AskedMotion(round_, plan, "no motion within the limits tells them apart")
    progress(0.5, "playing the planned motion")
    t_ipo = cell.world.t_ipo
    played = visible(cell.play(PassThrough(t_ipo), path=without_tcp(plan.commands, t_ipo)).recording, measured)
    again = diagnose(played, cell.robot, model=cell.model, progress=part_of(progress, 0.6, 0.4, "planned motion"))
    return AskedMotion(round_, plan, "", played, again)
