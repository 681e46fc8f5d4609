"""Which of a diagnosis' findings go into the loop: those that lower the path error that this arm measures.

Torque prediction alone does not decide: a stiffness that explains the currents a little better can bend the path by
millimetres. Every candidate is played on the arm; what does not lower the measured error is taken back, and the ladder
of trials with the reason of every refusal is the report's first table.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Diagnosis
from ideal_robot.diagnosis.validation.adoption import adopted, with_joint
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, TCP_POSITION, FittedEffect
from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.errors import IdealRobotError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.measured import Measured, visible
from scenes.methods import IDEAL
from scenes.metrics import path_errors
from scenes.path.cell import PathCell
from scenes.path.player import Play
from scenes.path.scene import JointPath

_LEAST = 0.99
"""An error that falls by less than a hundredth has not fallen."""
_ONLY_BEHIND = ("only a device on the arm's side, or a clamped flange ([J]), shows a gear's give or a joint's zero; "
                "motor angles and currents do not")


@dataclass(frozen=True)
class Step:
    """One trial of a change of the model.

    Attributes:
        round: of run and diagnosis, from 1.
        tried: what was changed.
        taken: whether it stays.
        refused: why it does not; empty where it does.
        error: measured E_car, aligned, with it [m]; NaN where it was not played.
    """

    round: int
    tried: str
    taken: bool
    refused: str
    error: float


def measured_error(played: Play, path: JointPath, robot: Robot, known: Model, measured: Measured,
                   effects: tuple[FittedEffect, ...] = ()) -> float:
    """Path error ``E_car``, aligned, as this arm measures it [m].

    Motor angles are brought behind the gears by what was known of these before, so that a changed stiffness cannot
    confirm itself; what the gears carry, which currents show, counts.

    Args:
        played: the play.
        path: what was wanted.
        robot: kinematics.
        known: the model of before.
        measured: what is measured.
        effects: of the model that is tried, those of before first.
    """
    recording = played.recording
    if measured == "tcp":
        x: Array = np.column_stack([recording.columns[axis] for axis in "xyz"])
    else:
        q = recording.joints("qa" if measured == "arm" else "q")
        if measured == "motor":
            q = q - _deflections(known.with_effects(_loads(effects[len(known.effects):])), path, recording.t)
        pose = robot.fk()
        x = np.array([pose(row).translation for row in q])
    return path_errors(path.t[path.counts], path.x_d[path.counts], recording.t, x).aligned.E_car


def adopt_on_path(cell: PathCell, found: Diagnosis, before: Play, known: Model, measured: Measured, round_: int,
                  error: float) -> tuple[Model, float, tuple[Step, ...]]:
    """The cell's model with those findings that lower the measured path error, that error, and the trials.

    First all that predict the run better, then joint by joint, each on top of what was taken.

    Args:
        cell: path, arm and present model.
        found: what the diagnosis found with that model.
        before: the play with that model.
        known: the model of before the first round.
        measured: what the arm measures.
        round_: of run and diagnosis, from 1.
        error: measured with the present model [m].
    """
    steps: list[Step] = []
    model, at_present = cell.model, before

    def attempt(label: str, candidate: Model) -> bool:
        nonlocal model, error, at_present
        try:
            again = dataclasses.replace(cell, model=candidate)
            played = again.play(again.feedforward(IDEAL))
            # Both plays with the same idea of what the gears carry.
            reached, present = (measured_error(one, cell.path, cell.robot, known, measured, candidate.effects)
                                for one in (played, at_present))
        except IdealRobotError as failed:
            steps.append(Step(round_, label, False, f"cannot be played: {failed}", float("nan")))
            return False
        if reached < _LEAST * present:
            model, error, at_present = candidate, reached, played
            steps.append(Step(round_, label, True, "", reached))
            return True
        steps.append(Step(round_, label, False, f"the path error does not fall: {1e3 * present:.3g} to "
                                                f"{1e3 * reached:.3g} mm", reached))
        return False

    whole = adopted(model, found, visible(before.recording, measured), cell.robot)
    changed = whole.effects != model.effects and not _stiffens(whole, model, measured)
    taken = changed and attempt("all that predict the run better", whole)
    for label, change, effects in _packages(found, measured, steps, round_):
        # Behind what was taken together only the tool is left to be looked at.
        if not taken or all(effect.domain == TCP_POSITION for effect in effects):
            attempt(label, change(model))
    return model, error, tuple(steps)


def _packages(found: Diagnosis, measured: Measured, steps: list[Step],
              round_: int) -> list[tuple[str, Callable[[Model], Model], tuple[FittedEffect, ...]]]:
    """What can be taken alone: a joint's effects of the torque with its friction, an effect behind a gear."""
    changes: list[tuple[str, Callable[[Model], Model], tuple[FittedEffect, ...]]] = []
    torque: dict[int, list[FittedEffect]] = {}
    for one in (*found.effects, *found.unknown):
        effect = one.fitted
        name = f"{effect.name} in joint {effect.joint}" if effect.joint else effect.name
        nowhere = effect.effect.loop_change(effect.coefficients, effect.theta).nowhere
        if effect.domain == SENSOR:
            nowhere = "no sensor takes part in this path"
        if nowhere:
            steps.append(Step(round_, name, False, f"does not act: {nowhere}", float("nan")))
        elif effect.domain != MOTOR_TORQUE:
            changes.append((name, partial(_with_effect, effect=effect), (effect,)))
        elif measured == "motor" and _behind_gear(effect):
            steps.append(Step(round_, name, False, _ONLY_BEHIND, float("nan")))
        else:
            torque.setdefault(effect.joint, []).append(effect)
    fitted = found.model
    for joint, effects in torque.items():
        if fitted is None:
            break
        label = " and ".join(effect.name for effect in effects)
        label += f" in joint {joint}" if joint else ""
        changes.append((label, partial(with_joint, fitted=fitted, joint=joint, effects=tuple(effects)),
                        tuple(effects)))
    return changes


def _with_effect(model: Model, effect: FittedEffect) -> Model:
    return model.with_effects((effect,))


def _stiffens(candidate: Model, model: Model, measured: Measured) -> bool:
    """Whether a candidate holds something of a gear or a joint's zero that this arm cannot show."""
    return measured == "motor" and any(_behind_gear(effect) for effect in candidate.effects[len(model.effects):])


def _behind_gear(effect: FittedEffect) -> bool:
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    return change.gear_compliance is not None or bool(change.half_gap) or bool(change.zero)


def _loads(effects: tuple[FittedEffect, ...]) -> tuple[FittedEffect, ...]:
    """Those that change what the gears carry."""
    changes = [(effect, effect.effect.loop_change(effect.coefficients, effect.theta)) for effect in effects]
    return tuple(effect for effect, change in changes if change.body or change.gravity is not None)


def _deflections(model: Model, path: JointPath, t: Array) -> Array:
    """Deflection of the gears at times ``(M,)`` [s] along a path ``(M, n)`` [rad], as a model expects it."""
    gears = GearDeflection(model, float(path.t[1] - path.t[0]))
    padded = np.concatenate([path.q_d[:1], path.q_d, path.q_d[-1:]])
    at_cycles = np.array([gears.at(padded[k : k + 3]) for k in range(len(path.q_d))])
    return np.column_stack([np.interp(t, path.t, column) for column in at_cycles.T])
