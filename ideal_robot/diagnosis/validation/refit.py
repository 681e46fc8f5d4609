"""Fits named effects beside a model whose parameters are fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.arm import position_regressions
from ideal_robot.diagnosis.channels.force import force_regressions
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import in_position_band, torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, Domain, Effect, FittedEffect, library, names
from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


def _held(regression: Regression) -> Problem:
    """The problem of a regression whose model is fixed: only effects are fitted."""
    return Problem(replace(regression, W=regression.W[:, :, :0]))


def with_named_effects(recording: Recording, robot: Robot, model: Model,
                       effects: tuple[tuple[str, int], ...]) -> Model:
    """The model with the named effects added, fitted for each kind of measurement; its parameters are fixed.

    An effect that shows in measured arm angles or at the measured tool is estimated there, else in the torque. The
    model's parameters are fixed: they are assumed right, and a poor estimate of them from one recording would harm the
    prediction of other motions.

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
            raise InputError("no such effect; `ideal-robot list effects` prints them", field="effect", value=name)
    fitted: list[FittedEffect] = []
    for domain, regression in by_domain.items():
        if domain in wanted:
            problem = _held(regression) if domain == MOTOR_TORQUE else Problem(regression)
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
            estimate = Problem(regression).fit(candidates, uncertainty=True)
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
