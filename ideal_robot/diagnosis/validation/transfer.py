"""What a diagnosis found, taken into the model for another motion as far as a recording of that motion bears it out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm import arm_angle_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.channels.regression import without_known
from ideal_robot.diagnosis.prior import TYPE
from ideal_robot.diagnosis.validation.result import Diagnosis
from ideal_robot.effects import ARM_POSITION, FittedEffect
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

T = TypeVar("T")
Error = Callable[[Sequence[T]], Array]
"""Error of each channel of the other recording ``(c,)`` with some of the effects."""


def log_reduction(without: Array, present: Array, channel: int | None) -> float:
    """Logarithm of the error without an effect over that with it.

    Args:
        without, present: errors of each channel ``(c,)``, in their units.
        channel: the effect's own; None takes the mean over all.
    """
    ratio = np.log(without / present)
    return float(np.mean(ratio) if channel is None else ratio[channel])


def accepted(effects: Sequence[T], error: Error[T], channel_of: Callable[[T], int | None]) -> list[T]:
    """Takes, one after another, the effects that lower the error beside those already taken.

    Args:
        effects, error: in the order in which they are tried, and the error with some of them.
        channel_of: the channel of an effect, None if it has no own.
    """
    chosen = list[T]()
    present = error(chosen)
    for effect in effects:
        tried = error([*chosen, effect])
        if log_reduction(present, tried, channel_of(effect)) > 0.0:
            chosen, present = [*chosen, effect], tried
    return chosen


# Effects of the torque are fitted together with the friction of their joint: a dry friction that rises towards
# standstill leaves less to the Coulomb term, and a model's curve may have imitated the effect. So a joint's effects
# and its friction are one package: they are taken together or not at all. An effect on top of the friction of before
# counts twice what both describe.

def adopted(known: Model, found: Diagnosis, run: Recording, robot: Robot) -> Model:
    """The known model with the joints, changed as the diagnosis says, that predict another recording better.

    Joints are tried in which something was found; all of them where the arm is another of its type.

    Args:
        known, found: the model that the diagnosis was given, and what it found in one recording.
        run, robot: another recording of the same arm, of which only what was measured is looked at.
    """
    base = dataclasses.replace(known, effects=known.effects + behind_gears(known, found, run, robot))
    fitted = found.model
    if fitted is None:
        return base
    at_torque = [f.fitted for f in (*found.effects, *found.unknown) if f.fitted.effect.at_motor]

    def with_joints(joints: Sequence[int]) -> Model:
        model = base
        for joint in joints:
            model = with_joint(model, fitted, joint, tuple(e for e in at_torque if e.joint == joint))
        return model

    others = set(range(1, known.n + 1)) if found.taken_for == TYPE else set[int]()
    joints = accepted(sorted({effect.joint for effect in at_torque} | others),
                      lambda some: with_joints(some).predict(run).relative_error_percent,
                      lambda joint: joint - 1 if joint else None)
    return with_joints(joints)


def with_joint(model: Model, fitted: Model, joint: int, effects: tuple[FittedEffect, ...]) -> Model:
    """The model with the friction that one joint has in a joint fit, and the effects that were in that fit.

    Args:
        model, fitted: what keeps all else, and the joint fit.
        joint, effects: from 1, where 0 leaves all friction as it is; and what it has.
    """
    laws = list(model.friction.laws)
    if joint:
        laws[joint - 1] = fitted.friction.laws[joint - 1]
    return dataclasses.replace(model, friction=PerJointFriction(laws), effects=model.effects + effects)


def behind_gears(known: Model, found: Diagnosis, run: Recording, robot: Robot) -> tuple[FittedEffect, ...]:
    """Effects of the measured arm angles that also lower the error of those of the run.

    Args:
        known, found: the model that the diagnosis was given, and what it found in one recording.
        run, robot: another recording of the same arm.
    """
    behind = [f.fitted for f in found.effects if f.fitted.domain == ARM_POSITION]
    arm = arm_angle_regression(run, robot, torque_regression(run, robot, known), known.stiffness) if behind else None
    if arm is None:
        return ()
    arm = without_known(arm, known.effects)
    columns = {id(effect): arm.filtered.decimate(effect.contribution(arm.signals)) for effect in behind}

    def error(effects: Sequence[FittedEffect]) -> Array:
        residual = arm.y - sum((columns[id(effect)] for effect in effects), np.zeros_like(arm.y))
        # A constant difference of the measuring devices says nothing about gears.
        return np.asarray(np.linalg.norm(residual - residual.mean(axis=0), axis=0) + 1e-300)

    return tuple(accepted(behind, error, lambda effect: effect.joint - 1))
