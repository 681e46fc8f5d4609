"""What a diagnosis found, taken into the model for another motion as far as a recording of that motion bears it out.

Effects of the torque are fitted together with the friction of their joint: a dry friction that rises towards
standstill leaves less to the Coulomb term, and a model's curve may have imitated the effect. So a joint's effects
and its friction are one package: they are taken together or not at all. An effect on top of the friction of before
counts twice what both describe.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm_angle import arm_angle_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.channels.regression import without_known
from ideal_robot.diagnosis.validation.carry_over import accepted
from ideal_robot.diagnosis.validation.result import Diagnosis
from ideal_robot.effects import ARM_POSITION, FittedEffect
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

_LEAST = -np.log(0.99)
"""What does not lower an error by a hundredth is not taken for an improvement."""


def adopted(known: Model, found: Diagnosis, run: Recording, robot: Robot) -> Model:
    """The known model with the joints, changed as the diagnosis says, that predict another recording better.

    Joints count in which something was found, and those whose error refitting the known model alone explains.

    Args:
        known: the model that the diagnosis was given.
        found: what it found in one recording.
        run: another recording of the same arm; only what was measured is looked at.
        robot: the arm.
    """
    kept = dataclasses.replace(known, effects=known.effects + behind_gears(known, found, run, robot))
    fitted = found.model
    if fitted is None:
        return kept
    at_torque = [f.fitted for f in (*found.effects, *found.unknown) if f.fitted.effect.at_motor]

    def with_joints(joints: Sequence[int]) -> Model:
        model = kept
        for joint in joints:
            model = with_joint(model, fitted, joint, tuple(e for e in at_torque if e.joint == joint))
        return model

    joints = accepted(sorted({effect.joint for effect in at_torque} | {one.joint for one in found.refitted}),
                      lambda some: with_joints(some).predict(run).relative_error_percent,
                      lambda joint: joint - 1 if joint else None, _LEAST)
    return with_joints(joints)


def with_joint(model: Model, fitted: Model, joint: int, effects: tuple[FittedEffect, ...]) -> Model:
    """The model with the friction that one joint has in a joint fit, and the effects that were in that fit.

    Args:
        model: what keeps all else.
        fitted: the joint fit.
        joint: from 1; 0 leaves all friction as it is.
        effects: of this joint.
    """
    laws = list(model.friction.laws)
    if joint:
        laws[joint - 1] = fitted.friction.laws[joint - 1]
    return dataclasses.replace(model, friction=PerJointFriction(laws), effects=model.effects + effects)


def behind_gears(known: Model, found: Diagnosis, run: Recording, robot: Robot) -> tuple[FittedEffect, ...]:
    """Effects of the measured arm angles that also lower the error of those of the run.

    Args:
        known: the model that the diagnosis was given.
        found: what it found in one recording.
        run: another recording of the same arm.
        robot: the arm.
    """
    behind = [f.fitted for f in found.effects if f.fitted.domain == ARM_POSITION]
    arm = arm_angle_regression(run, robot, torque_regression(run, robot, known), known.stiffness) if behind else None
    if arm is None:
        return ()
    arm = without_known(arm, known.effects)
    columns = {id(effect): arm.decimate(effect.contribution(arm.signals)) for effect in behind}

    def error(effects: Sequence[FittedEffect]) -> Array:
        left = arm.y - sum((columns[id(effect)] for effect in effects), np.zeros_like(arm.y))
        # A constant difference of the measuring devices says nothing about gears.
        return np.asarray(np.linalg.norm(left - left.mean(axis=0), axis=0) + 1e-300)

    return tuple(accepted(behind, error, lambda effect: effect.joint - 1, _LEAST))
