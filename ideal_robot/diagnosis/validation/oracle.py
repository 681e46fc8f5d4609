"""An oracle: given the names and joints of effects, it estimates their size, and the model's parameters with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm_angle import arm_angle_regression
from ideal_robot.diagnosis.channels.blocks import time_blocks
from ideal_robot.diagnosis.channels.force import blocks_of, force_regressions
from ideal_robot.diagnosis.channels.line import line_blocks, line_regression
from ideal_robot.diagnosis.channels.motor_torque import in_position_band, torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.channels.tool_position import tool_regression
from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.estimate import fitted_effect
from ideal_robot.diagnosis.statistics.prior import prior_precision
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.statistics.with_parameters import with_parameters
from ideal_robot.effects import (
    ARM_POSITION,
    MOTOR_TORQUE,
    SENSOR,
    TCP_POSITION,
    Domain,
    Effect,
    FittedEffect,
    library,
    names,
)
from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


def with_named_effects(recording: Recording, robot: Robot, model: Model,
                       effects: tuple[tuple[str, int], ...]) -> Model:
    """The model with the named effects, estimated jointly with its parameters.

    An effect that shows in measured arm angles or at the measured tool is estimated there, else in the torque. Those of
    the torque and the
    parameters of the model are one fit, and the model returned is that of the fit: the effects on top of the
    parameters of before would count twice what both describe.

    Args:
        recording: as for ``diagnose``.
        robot: likewise.
        model: likewise.
        effects: name and joint (from 1) of each.

    Raises:
        InputError: no such effect.
    """
    (recording,), _ = checked([recording], robot)
    torque = torque_regression(recording, robot, model, payload=True)
    made = [(domain, build(recording, robot, torque, model.stiffness)) for domain, build in
            ((ARM_POSITION, arm_angle_regression), (TCP_POSITION, tool_regression))]
    found, result = [], model
    for name, joint in effects:
        places = [(regression, _named(name, domain)) for domain, regression in made if regression is not None]
        behind = next(((regression, kinds) for regression, kinds in places if kinds), None)
        if behind is not None:
            found.append(_estimated(*behind, joint, None)[0])
            continue
        kinds = _named(name, MOTOR_TORQUE)
        if not kinds:
            if name in names():
                # This arm measures nothing in which it shows.
                continue
            raise InputError("no such effect", field="effect", value=name)
        if kinds[0].absorbed_by_base:
            # A change of parameters beside parameters that are free could be anything: those of before are held.
            result = result.with_effects((_alone(recording, robot, result, kinds[0], joint),))
            continue
        # With what was estimated before in the model, as its parameters now are.
        effect, change = _estimated(torque_regression(recording, robot, result, payload=True), kinds, joint, result)
        result = with_parameters(result, change).with_effects((effect,))
    return result.with_effects(tuple(found))


def named_camera_effect(recording: Recording, robot: Robot, model: Model, name: str) -> FittedEffect:
    """An effect of the camera by its name, fitted to all of a line-following recording.

    Args:
        recording: as for ``diagnose``.
        robot: likewise.
        model: likewise.
        name: of the effect.

    Raises:
        InputError: no such effect, or no line in the recording.
    """
    return named_camera_effects(recording, robot, model, (name,))[0]


def named_camera_effects(recording: Recording, robot: Robot, model: Model,
                         names: Sequence[str]) -> tuple[FittedEffect, ...]:
    """Effects of the camera by their names, fitted together to all of a line-following recording.

    Args:
        recording: as for ``diagnose``.
        robot: likewise.
        model: likewise.
        names: of the effects.

    Raises:
        InputError: no such effect, or no line in the recording.
    """
    made = line_regression(recording, robot, torque_regression(recording, robot, model), model.stiffness)
    kinds = [effect for name in names for effect in _named(name, SENSOR) if effect.acts_on(SENSOR.prefix)]
    if made is None or len(kinds) < len(names):
        raise InputError("no such effect of a camera, or no line in the recording", field="effect",
                         value=", ".join(names))
    candidates = [Candidate(kind, 0) for kind in kinds]
    found = Problem(made, line_blocks(made, False)).fit(candidates, uncertainty=True)
    return tuple(fitted_effect(candidate, found, k) for k, candidate in enumerate(candidates))


def named_force_effects(recording: Recording, robot: Robot, model: Model,
                        names: Sequence[str]) -> tuple[FittedEffect, ...]:
    """Effects of force sensor and contact by their names, fitted to a recording; those it cannot show are left out.

    Args:
        recording: as for ``diagnose``.
        robot: likewise.
        model: likewise.
        names: of the effects.
    """
    (recording,), _ = checked([recording], robot)
    torque = in_position_band(torque_regression(recording, robot, model), recording)
    result: list[FittedEffect] = []
    for made, _ in force_regressions(recording, None, robot, torque, None, model.stiffness):
        kinds = [effect for name in names for effect in _named(name, SENSOR) if effect.usable(made.signals, 0)]
        candidates = [Candidate(kind, 0) for kind in kinds]
        found = Problem(made, blocks_of(made, False)).fit(candidates, uncertainty=True)
        result += [fitted_effect(candidate, found, k) for k, candidate in enumerate(candidates)]
    return tuple(result)


def _named(name: str, domain: Domain) -> list[Effect]:
    return [effect for effect in library() if effect.name == name and effect.domain == domain]


def _estimated(regression: Regression, kinds: Sequence[Effect], joint: int,
               model: Model | None) -> tuple[FittedEffect, Array]:
    """The form and start of an effect that leaves least, with the change of the model's parameters."""
    blocks = time_blocks(len(regression.t), float(regression.t[1] - regression.t[0]), held_out=False)
    problem = Problem(regression, blocks.without_folds())
    if model is not None and np.any(model.covariance):
        problem = problem.with_prior(prior_precision(model, problem))
    best: tuple[float, Candidate] | None = None
    for effect in kinds:
        for theta in _starts(problem, effect, joint):
            candidate = Candidate(effect, joint, theta)
            left = problem.fit([candidate]).residual(regression, [candidate])
            loss = float(np.sum(np.log(np.mean(np.where(regression.use, left, 0.0) ** 2, axis=0) + 1e-300)))
            if best is None or loss < best[0]:
                best = loss, candidate
    if best is None:
        raise InputError("the effect has nothing to start from in this recording", field="effect", value=kinds[0].name)
    final = problem.fit([best[1]], uncertainty=True)
    return fitted_effect(best[1], final, 0), final.change


def _starts(problem: Problem, effect: Effect, joint: int) -> Sequence[tuple[float, ...]]:
    """Values of theta to start from, of a scanned effect those that the residual suggests."""
    regression = problem.regression
    if not effect.scanned:
        return effect.starts(regression.signals, joint)
    left = problem.fit([]).residual(regression, [])
    return effect.starts_from_residual(regression.decimated_signals(), joint, left, regression.use)[0]


def _alone(recording: Recording, robot: Robot, model: Model, effect: Effect, joint: int) -> FittedEffect:
    """An effect of the torque without nonlinear parameters, beside a model whose parameters are held."""
    made = torque_regression(recording, robot, model, payload=True)
    columns = made.decimate(effect.columns(made.signals, joint, ()))
    weight = np.where(made.use, 1.0 / np.maximum(made.noise_floor, 1e-12), 0.0)
    rows = (weight[:, :, None] * columns).reshape(-1, columns.shape[2])
    size = np.linalg.lstsq(rows, (weight * made.y).ravel(), rcond=1e-6)[0]
    return FittedEffect(effect.name, joint, effect.channel(joint), tuple(float(value) for value in size))
