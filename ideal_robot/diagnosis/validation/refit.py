"""Fits beside a model: what is held in the last one, effects by their names, and what refitting alone explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.channels.arm import position_regressions
from ideal_robot.diagnosis.channels.force import force_regressions
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import about_model, in_position_band, torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.statistics.least_squares import CLEAR
from ideal_robot.diagnosis.statistics.problem import (
    Candidate,
    Estimate,
    Problem,
    prior_covariance,
    prior_precision,
    torque_left_open,
    with_parameters,
)
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.diagnosis.validation.result import ChannelResult, MovedParameter, RefitExplains
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, Domain, Effect, FittedEffect, library, names
from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places, parameter_vector
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

# Effects of the motor torque beside a model that stays as it is.
#
# A joint fit shares what a recording shows among the effects and all parameters of the model, and what the recording
# tells badly goes anywhere: into rotors, gravity, other joints' friction. On another motion that is an error of its
# own. Where the model is known and the effects are named, what the recording holds beyond the model is theirs alone.

def _held_problem(regression: Regression, model: Model) -> Problem:
    """The problem of the motor torques about a model with its parameters held."""
    problem = Problem.of(regression, held_out=False).on_all_blocks()
    return problem.with_prior(prior_precision(model, problem)).held()


def beside_held_model(regression: Regression, model: Model,
                      effects: Sequence[FittedEffect]) -> tuple[FittedEffect, ...]:
    """Effects of the motor torque with the sizes that they have together, where physics allows these, in their order.

    Args:
        regression, model: with the regressor of a payload, about the model, whose parameters and effects are held.
        effects: of which those of the motor torque are fitted, with their theta.
    """
    of_torque = [effect for effect in effects if effect.effect.at_motor]
    if not of_torque:
        return ()
    candidates = [Candidate(effect.effect, effect.joint, effect.theta) for effect in of_torque]
    estimate = _held_problem(regression, model).fit(candidates, uncertainty=True)
    return tuple(replace(effect, coefficients=tuple(own.tolist()), std=tuple(std.tolist()), theta_std=(), parameters=())
                 for effect, own, std in zip(of_torque, estimate.coefficients, estimate.std, strict=True)
                 if np.all(np.isfinite(own))
                 and effect.effect.plausible(own, effect.theta, regression.signals, effect.joint))


def friction_anew(regression: Regression, model: Model, joints: tuple[int, ...]) -> dict[int, Model]:
    """The model with the friction coefficients of one joint as a recording has them, for each that can be told.

    A coefficient at most doubles, and none changes its sign: what a motion tells badly stays near what was known. The
    law and its shape stay, so does all else of the model.

    Args:
        regression, model: of the motor torques, about the model.
        joints: from 1.
    """
    result: dict[int, Model] = {}
    places = friction_places(model.base, model.friction)
    for joint, (law, columns) in enumerate(zip(model.friction.laws, places, strict=True), start=1):
        use, known = regression.use[:, joint - 1], law.coefficients[:, 0]
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
        start = found.start
        value = parameter_vector(start.base_values, start.friction)
        brakes = np.zeros(len(value), dtype=bool)
        for law, place in zip(start.friction.laws, friction_places(start.base, start.friction), strict=True):
            brakes[place] = law.nonnegative
        brakes[list(found.held)] = False
        change = found.problem.on_all_blocks().fit(found.choices).change
        index = np.flatnonzero(brakes & (value + change < 0.0))
        if not len(index):
            break
        found = _held(found, index, value)
    return found


def _held(found: Findings, index: np.ndarray, value: Array) -> Findings:
    """The same about a model whose parameters ``(P,)`` are zero at ``index``, with no part in any fit."""
    change = np.zeros(len(value))
    change[index] = -value[index]
    start = with_parameters(found.start, change)

    def about(regression: Regression) -> Regression:
        W = regression.W.copy()
        W[:, :, index] = 0.0
        return replace(about_model(regression, start), signals=regression.signals, W=W)

    return replace(found, start=start, problem=found.problem.with_regression(about(found.problem.regression)),
                   validation=None if found.validation is None else about(found.validation),
                   held=(*found.held, *index.tolist()))


def without_scatter(estimate: Estimate, held: tuple[int, ...]) -> Estimate:
    """The estimate where held parameters stay and have no scatter: they stand at their limit."""
    covariance, change, index = estimate.covariance.copy(), estimate.change.copy(), list(held)
    covariance[index], covariance[:, index], change[index] = 0.0, 0.0, 0.0
    return replace(estimate, change=change, covariance=covariance)


# What refitting a given model's parameters alone explains: a cause that looks like them may hide in that.
#
# A spring, moved little, is a shift of masses; a wrong gain is heavier links and more friction. Where parameters have
# to move far from what was known for a joint's error to fall, that is no proof that nothing is missing. What the
# recordings that the model was made of had left open is no such move.


def explained_by_refitting(model: Model, torque: DomainDiagnosis,
                           channels: Sequence[ChannelResult]) -> tuple[RefitExplains, ...]:
    """Joints whose error falls by refitting alone; effects that were found take less than half of that away.

    Args:
        model: as given.
        torque, channels: the settled domain of the motor torques, and its results.
    """
    regression, estimate = torque.problem.regression, torque.problem.fit(torque.choices)
    left_open = torque_left_open(model, torque.problem)
    sigma = np.sqrt(np.diag(prior_covariance(model, torque.problem)))
    result = []
    for j, c in enumerate(channels):
        explained = max(c.rms_before**2 - c.rms_refit**2, 0.0)
        by_effects = float(torque.levels[0][j] ** 2 - torque.levels[-1][j] ** 2)
        named = torque.problem.prior is not None and 2.0 * by_effects > explained
        if j + 1 in regression.undecided or named or np.sqrt(explained) <= CLEAR * left_open[j]:
            continue
        result.append(RefitExplains(
            j + 1, c.channel, c.rms_before, c.rms_refit,
            _moved(model, estimate.change, sigma, regression.W[:, j] * regression.use[:, j, None]),
            f"joint {j + 1} uses more of its range, at other speeds and loads"))
    return tuple(result)


def _moved(model: Model, change: Array, sigma: Array, W: Array) -> tuple[MovedParameter, ...]:
    """The four of the parameters ``(P,)`` that moved far and change the joint's torque ``W (N, P)`` most."""
    value = parameter_vector(model.base_values, model.friction)
    weight = np.abs(change) * np.sqrt(np.mean(W**2, axis=0))
    far = [int(i) for i in np.argsort(-weight) if abs(change[i]) > CLEAR * sigma[i] and weight[i] > 0.0]
    names = model.parameters
    return tuple(MovedParameter(names[i].name, names[i].unit, float(value[i]), float(value[i] + change[i]),
                                float(change[i] / sigma[i])) for i in far[:4])


def with_named_effects(recording: Recording, robot: Robot, model: Model,
                       effects: tuple[tuple[str, int], ...]) -> Model:
    """The model with the named effects, each kind of measurement's together, beside the model as it is.

    An effect that shows in measured arm angles or at the measured tool is estimated there, else in the torque. The
    model's parameters are held: they are right but for what is named, and what one recording tells badly of them would
    bend another motion.

    Args:
        recording, robot, model: as for ``diagnose``.
        effects: name and joint (from 1) of each.

    Raises:
        InputError: no such effect.
    """
    (recording,), _ = checked([recording], robot)
    torque = torque_regression(recording, robot, model, payload=True)
    by_domain = {r.domain: r for r in (*position_regressions(recording, robot, torque, model.known_stiffness), torque)}
    wanted: dict[Domain, list[tuple[list[Effect], int]]] = {}
    for name, joint in effects:
        place = next((domain for domain in by_domain if _named(name, domain)), None)
        if place is not None:
            wanted.setdefault(place, []).append((_named(name, place), joint))
        elif name not in names():
            raise InputError("no such effect", field="effect", value=name)
    fitted: list[FittedEffect] = []
    for domain, regression in by_domain.items():
        if domain in wanted:
            problem = _held_problem(regression, model) if domain == MOTOR_TORQUE else Problem.of(regression, False)
            fitted += _together(problem, wanted[domain])
    return model.with_effects(tuple(fitted))


def named_sensor_effects(recording: Recording, robot: Robot, model: Model,
                         names: Sequence[str]) -> tuple[FittedEffect, ...]:
    """Effects of camera, force sensor and contact by their names, fitted together; those it cannot show are left out.

    Args:
        recording, robot, model: as for ``diagnose``.
        names: of the effects.
    """
    (recording,), _ = checked([recording], robot)
    torque = in_position_band(torque_regression(recording, robot, model), recording)
    line = line_regression(recording, robot, torque, model.known_stiffness)
    force = force_regressions(recording, None, robot, torque, None, model.known_stiffness)
    result: list[FittedEffect] = []
    for regression in (line, *(regression for regression, _ in force)):
        if regression is not None:
            candidates = [Candidate(effect, 0) for name in names for effect in _named(name, SENSOR)
                          if effect.usable(regression.signals, 0)]
            estimate = Problem.of(regression, False).fit(candidates, uncertainty=True)
            result += estimate.all_fitted(regression.prismatic)
    return tuple(result)


def _named(name: str, domain: Domain) -> list[Effect]:
    return [effect for effect in library() if effect.name == name and effect.domain == domain]


def _together(problem: Problem, wanted: Sequence[tuple[Sequence[Effect], int]]) -> tuple[FittedEffect, ...]:
    """Effects in one fit; of each the form and start that leave least beside those before it."""
    regression, chosen = problem.regression, list[Candidate]()

    def left(effects: Sequence[Candidate]) -> Array:
        return problem.fit(effects).residual(regression)

    def loss(candidate: Candidate) -> float:
        squares = np.where(regression.use, left([*chosen, candidate]), 0.0) ** 2
        return float(np.sum(np.log(np.mean(squares, axis=0) + 1e-300)))

    for kinds, joint in wanted:
        tried = []
        for effect in kinds:
            starts = effect.starts(regression.signals, joint) if not effect.scanned else effect.starts_from_residual(
                regression.decimated_signals(), joint, left(chosen), regression.use)[0]
            tried += [Candidate(effect, joint, theta) for theta in starts]
        if not tried:
            raise InputError("the effect has nothing to start from in this recording", field="effect",
                             value=kinds[0].name)
        chosen.append(min(tried, key=loss))
    return problem.fit(chosen, uncertainty=True).all_fitted(regression.prismatic)
