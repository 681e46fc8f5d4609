"""What refitting a given model's parameters alone explains: a cause that looks like them may hide in that.

A spring, moved little, is a shift of masses; a wrong gain is heavier links and more friction. Where parameters have to
move far from what was known for a joint's error to fall, that is no proof that nothing is missing. What the recordings
that the model was made of had left open is no such move.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm import arm_angle_regression, tool_regression
from ideal_robot.diagnosis.channels.force import force_regressions
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import in_position_band, torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.statistics.least_squares import CLEAR
from ideal_robot.diagnosis.statistics.problem import (
    Candidate,
    Problem,
    fitted_effect,
    prior_covariance,
    torque_left_open,
)
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.diagnosis.validation.final_fit import held_problem
from ideal_robot.diagnosis.validation.result import ChannelResult, MovedParameter, RefitExplains
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
from ideal_robot.model.parametrisation import parameter_vector
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

_LARGE = 0.03
"""Share of a torque's spread that refitting has to explain: models of two healthy recordings of one arm differ by up to
1 %."""
_FALLS = 0.7
"""Error after over error before down to which refitting, or an effect, explains little."""
_MOST = 4


def explained_by_refitting(model: Model, torque: DomainDiagnosis,
                           channels: Sequence[ChannelResult]) -> tuple[RefitExplains, ...]:
    """Joints whose error falls by refitting alone, and not by an effect that was found.

    Args:
        model: as given.
        torque: the domain of the motor torques, settled.
        channels: its results.
    """
    levels = torque.levels
    regression, estimate = torque.problem.regression, torque.problem.fit(torque.choices)
    left_open = torque_left_open(model, torque.problem)
    sigma = np.sqrt(np.diag(prior_covariance(model, torque.problem)))
    result = []
    for j, c in enumerate(channels):
        explained = np.sqrt(max(c.rms_before**2 - c.rms_refit**2, 0.0))
        with_effects = float(levels[-1][j])
        least = max(_LARGE * c.spread, CLEAR * left_open[j])
        if (j + 1 in regression.undecided or c.rms_refit > _FALLS * c.rms_before or explained < least
                or (with_effects < _FALLS * c.rms_before and torque.problem.prior is not None)):
            continue
        result.append(RefitExplains(
            j + 1, c.channel, c.rms_before, c.rms_refit,
            _moved(model, estimate.change, sigma, regression.W[:, j] * regression.use[:, j, None]),
            f"joint {j + 1} uses more of its range, at other speeds and loads"))
    return tuple(result)


def _moved(model: Model, change: Array, sigma: Array, W: Array) -> tuple[MovedParameter, ...]:
    """Parameters that moved far, those first that change the joint's torque most.

    Args:
        model: as given.
        change: of its parameters ``(P,)``.
        sigma: how well they were known ``(P,)``.
        W: derivative of the joint's torque by them ``(N, P)``.
    """
    value = parameter_vector(model.base_values, model.friction)
    weight = np.abs(change) * np.sqrt(np.mean(W**2, axis=0))
    far = [int(i) for i in np.argsort(-weight) if abs(change[i]) > CLEAR * sigma[i] and weight[i] > 0.0]
    names = model.parameters
    return tuple(MovedParameter(names[i].name, names[i].unit, float(value[i]), float(value[i] + change[i]),
                                float(change[i] / sigma[i])) for i in far[:_MOST])


def with_named_effects(recording: Recording, robot: Robot, model: Model,
                       effects: tuple[tuple[str, int], ...]) -> Model:
    """The model with the named effects, each kind of measurement's together, beside the model as it is.

    An effect that shows in measured arm angles or at the measured tool is estimated there, else in the torque. The
    model's parameters are held: they are right but for what is named, and what one recording tells badly of them would
    bend another motion.

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
    made: list[tuple[Domain, Regression | None]] = [
        (domain, build(recording, robot, torque, model.stiffness)) for domain, build in
        ((ARM_POSITION, arm_angle_regression), (TCP_POSITION, tool_regression))]
    made.append((MOTOR_TORQUE, torque))
    wanted: dict[Domain, list[tuple[list[Effect], int]]] = {}
    for name, joint in effects:
        place = next((domain for domain, regression in made if regression is not None and _named(name, domain)), None)
        if place is not None:
            wanted.setdefault(place, []).append((_named(name, place), joint))
        elif name not in names():
            raise InputError("no such effect", field="effect", value=name)
    found: list[FittedEffect] = []
    for domain, regression in made:
        if regression is None or domain not in wanted:
            continue
        problem = held_problem(regression, model) if domain == MOTOR_TORQUE else Problem.of(regression, False)
        found += _together(problem, wanted[domain])
    return model.with_effects(tuple(found))


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
    found = Problem.of(made, False).fit(candidates, uncertainty=True)
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
        found = Problem.of(made, False).fit(candidates, uncertainty=True)
        result += [fitted_effect(candidate, found, k) for k, candidate in enumerate(candidates)]
    return tuple(result)


def _named(name: str, domain: Domain) -> list[Effect]:
    return [effect for effect in library() if effect.name == name and effect.domain == domain]


def _together(problem: Problem, wanted: Sequence[tuple[Sequence[Effect], int]]) -> list[FittedEffect]:
    """Effects in one fit; of each the form and start that leave least beside those before it."""
    regression, chosen = problem.regression, list[Candidate]()
    for kinds, joint in wanted:
        best: tuple[float, Candidate] | None = None
        for effect in kinds:
            for theta in _starts(problem, effect, joint, chosen):
                candidate = Candidate(effect, joint, theta)
                left = problem.fit([*chosen, candidate]).residual(regression, [*chosen, candidate])
                loss = float(np.sum(np.log(np.mean(np.where(regression.use, left, 0.0) ** 2, axis=0) + 1e-300)))
                if best is None or loss < best[0]:
                    best = loss, candidate
        if best is None:
            raise InputError("the effect has nothing to start from in this recording", field="effect",
                             value=kinds[0].name)
        chosen.append(best[1])
    final = problem.fit(chosen, uncertainty=True)
    return [fitted_effect(candidate, final, k) for k, candidate in enumerate(chosen)]


def _starts(problem: Problem, effect: Effect, joint: int, beside: Sequence[Candidate]) -> Sequence[tuple[float, ...]]:
    """Values of theta to start from, of a scanned effect those that the residual suggests."""
    regression = problem.regression
    if not effect.scanned:
        return effect.starts(regression.signals, joint)
    left = problem.fit(beside).residual(regression, beside)
    return effect.starts_from_residual(regression.decimated_signals(), joint, left, regression.use)[0]
