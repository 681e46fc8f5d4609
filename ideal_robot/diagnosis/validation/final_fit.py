"""The final fit: what is held in it, and the standard deviations that it may claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.channels.motor_torque import about_model
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.search.scoring import ITERATIONS
from ideal_robot.diagnosis.statistics.least_squares import CLEAR
from ideal_robot.diagnosis.statistics.problem import Candidate, Estimate, Problem, prior_precision, with_parameters
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.effects import FittedEffect
from ideal_robot.effects.drive import CommonDelay
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places, parameter_vector

# Effects of the motor torque beside a model that stays as it is.
#
# A joint fit shares what a recording shows among the effects and all parameters of the model, and what the recording
# tells badly goes anywhere: into rotors, gravity, other joints' friction. On another motion that is an error of its
# own. Where the model is known and the effects are named, what the recording holds beyond the model is theirs alone.

def held_problem(regression: Regression, model: Model) -> Problem:
    """The problem of a recording with the model's parameters held.

    Args:
        regression: of the motor torques, about the model.
        model: that is known.
    """
    problem = Problem.of(regression, held_out=False).on_all_blocks()
    return problem.with_prior(prior_precision(model, problem)).held()


def beside_held_model(regression: Regression, model: Model,
                      effects: Sequence[FittedEffect]) -> tuple[FittedEffect, ...]:
    """Effects with the sizes that they have together beside a model whose parameters are held.

    Args:
        regression: of the motor torques, about the model, with the regressor of a payload.
        model: that was known then; effects in it stay as they are.
        effects: of which those of the motor torque are fitted, with their theta.

    Returns:
        Those of the motor torque that have a size which physics allows, in their order.
    """
    of_torque = [effect for effect in effects if effect.effect.at_motor]
    if not of_torque:
        return ()
    candidates = [Candidate(effect.effect, effect.joint, effect.theta) for effect in of_torque]
    found = held_problem(regression, model).fit(candidates, uncertainty=True)
    return tuple(replace(effect, coefficients=tuple(float(value) for value in own),
                         std=tuple(float(value) for value in std), theta_std=(), parameters=())
                 for effect, own, std in zip(of_torque, found.coefficients, found.std, strict=True)
                 if np.all(np.isfinite(own))
                 and effect.effect.plausible(own, effect.theta, regression.signals, effect.joint))


def friction_anew(regression: Regression, model: Model, joints: tuple[int, ...]) -> dict[int, Model]:
    """The model with the friction coefficients of one joint as a recording has them, for each of some joints.

    A coefficient at most doubles, and none changes its sign: what a motion tells badly stays near what was known. The
    law and its shape stay, so does all else of the model.

    Args:
        regression: of the motor torques, about the model.
        model: that is known; its effects stay.
        joints: from 1.

    Returns:
        A model for each joint whose friction can be told.
    """
    result: dict[int, Model] = {}
    places = friction_places(model.base, model.friction)
    for joint, (law, columns) in enumerate(zip(model.friction.laws, places, strict=True), start=1):
        use = regression.use[:, joint - 1]
        known = law.coefficients[:, 0]
        free = np.abs(known) > 0.0
        if joint not in joints or joint in regression.undecided or not free.any() or np.count_nonzero(use) < len(known):
            continue
        change, own = np.zeros(regression.W.shape[2]), np.arange(columns.start, columns.stop)[free]
        change[own] = lsq_linear(regression.W[use, joint - 1][:, own], regression.y[use, joint - 1],
                                 (-np.abs(known[free]), np.abs(known[free]))).x
        result[joint] = with_parameters(model, change)
    return result


def with_braking_friction(case: Case, found: Findings) -> Findings:
    """The findings about a model in which coefficients of friction that come out negative are zero and stay so.

    A model that was given brakes already, and is what errors are compared with.
    """
    if not case.shared or case.given is not None:
        return found
    for _ in range(case.robot.n):
        change = found.problem.on_all_blocks().fit(found.choices).change
        driving = _driving(found.start, change) & ~np.isin(np.arange(len(change)), found.held)
        if not driving.any():
            break
        found = _held(found, np.flatnonzero(driving))
    return found


def without_scatter(estimate: Estimate, held: tuple[int, ...]) -> Estimate:
    """The estimate where held parameters stay and have no scatter: they stand at their limit."""
    covariance, change = estimate.covariance.copy(), estimate.change.copy()
    covariance[list(held)] = 0.0
    covariance[:, list(held)] = 0.0
    change[list(held)] = 0.0
    return replace(estimate, change=change, covariance=covariance)


def _driving(model: Model, change: np.ndarray) -> np.ndarray:
    """Mask ``(P,)`` of coefficients of friction that a change of the parameters ``(P,)`` makes negative."""
    value = parameter_vector(model.base_values, model.friction) + change
    brakes = np.zeros(len(value), dtype=bool)
    for law, place in zip(model.friction.laws, friction_places(model.base, model.friction), strict=True):
        brakes[place] = law.nonnegative
    return np.asarray(brakes & (value < 0.0))


def _held(found: Findings, index: np.ndarray) -> Findings:
    """The same about a model whose parameters at ``index`` are zero, with no part in any fit."""
    values = parameter_vector(found.start.base_values, found.start.friction)
    change = np.zeros(len(values))
    change[index] = -values[index]
    start = with_parameters(found.start, change)

    def about(regression: Regression) -> Regression:
        W = regression.W.copy()
        W[:, :, index] = 0.0
        return replace(about_model(regression, start), signals=regression.signals, W=W)

    return replace(found, start=start, problem=found.problem.with_regression(about(found.problem.regression)),
                   validation=None if found.validation is None else about(found.validation),
                   held=(*found.held, *(int(i) for i in index)))


def beside_lag(torque: DomainDiagnosis) -> Estimate:
    """The fit of everything together, beside a lag of all torques where there clearly is one.

    A late torque turns inertia into friction, by as much as the motion is fast: a model that holds that is wrong in
    every other motion. The lag belongs to the recording, not to the arm, so only the parameters are of use.

    Args:
        torque: the domain of the motor torques, settled.
    """
    effects, signals = torque.choices, torque.problem.regression.signals
    lag = CommonDelay()
    if not lag.usable(signals, 0) or any(isinstance(c.effect, CommonDelay) for c in effects):
        return torque.final
    candidate = Candidate(lag, 0, lag.starts(signals, 0)[0])
    for _ in range(ITERATIONS):
        found = torque.problem.on_all_blocks().fit([*effects, candidate], uncertainty=True)
        theta = lag.consistent_theta(found.coefficients[-1], candidate.theta)
        candidate = Candidate(lag, 0, theta)
    own, std = found.coefficients[-1], found.std[-1]
    if not abs(own[0]) > CLEAR * std[0] or not lag.plausible(own, candidate.theta, signals, 0):
        return torque.final
    return found
