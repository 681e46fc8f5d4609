"""An oracle: told the names and joints of effects, it estimates their size, and the model's parameters with them."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm import arm_experiment
from ideal_robot.diagnosis.channels.motor_torque import Experiment, experiment
from ideal_robot.diagnosis.diagnose import prior_precision
from ideal_robot.diagnosis.search.candidates import Candidate
from ideal_robot.diagnosis.statistics.cross_products import Blocks, Data, time_blocks
from ideal_robot.diagnosis.statistics.estimate import estimate, fitted_effect
from ideal_robot.diagnosis.statistics.rebase import with_parameters
from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, Domain, Effect, FittedEffect, library
from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


def told(recording: Recording, robot: Robot, model: Model, effects: tuple[tuple[str, int], ...]) -> Model:
    """The model with the named effects, estimated jointly with its parameters.

    An effect that shows in measured arm angles is estimated there, else in the torque. Those of the torque and the
    parameters of the model are one fit, and the model returned is that of the fit: the effects on top of the
    parameters of before would count twice what both describe.

    Args:
        recording, robot, model: as for ``diagnose``.
        effects: name and joint (from 1) of each.

    Raises:
        InputError: no such effect.
    """
    (recording,), _ = checked([recording], robot)
    torque = experiment(recording, robot, model, payload=True)
    arm = arm_experiment(recording, robot, torque, model.stiffness)
    found, result = [], model
    for name, joint in effects:
        behind = _named(name, ARM_POSITION) if arm is not None else []
        raw, kinds = (arm, behind) if arm is not None and behind else (torque, _named(name, MOTOR_TORQUE))
        if not kinds:
            raise InputError("no such effect", field="effect", value=name)
        if raw is arm:
            found.append(_estimated(raw, kinds, joint, None)[0])
            continue
        # With what was estimated before in the model, as its parameters now are.
        effect, change = _estimated(experiment(recording, robot, result, payload=True), kinds, joint, result)
        result = with_parameters(result, change).with_effects((effect,))
    return result.with_effects(tuple(found))


def _named(name: str, domain: Domain) -> list[Effect]:
    return [effect for effect in library() if effect.name == name and effect.domain == domain]


def _estimated(raw: Experiment, kinds: list[Effect], joint: int, model: Model | None
               ) -> tuple[FittedEffect, Array]:
    blocks = time_blocks(len(raw.t), float(raw.t[1] - raw.t[0]), held_out=False)
    data = Data(raw.y, raw.W, raw.use, Blocks(blocks.edges, np.zeros(blocks.count, dtype=int), 0))
    prior = prior_precision(model, raw, data) if model is not None and np.any(model.covariance) else None
    best: tuple[float, Candidate] | None = None
    for effect in kinds:
        for theta in effect.starts(raw.signals, joint):
            candidate = Candidate(effect, joint, theta)
            fit = estimate(raw, data, [candidate], prior, spread=False)
            left = raw.y - raw.W @ fit.change - raw.decimate(
                effect.columns(raw.signals, joint, theta) @ fit.coefficients[0])
            loss = float(np.sum(np.log(np.mean(np.where(raw.use, left, 0.0) ** 2, axis=0) + 1e-300)))
            if best is None or loss < best[0]:
                best = loss, candidate
    if best is None:
        raise InputError("the effect has nothing to start from in this recording", field="effect", value=kinds[0].name)
    final = estimate(raw, data, [best[1]], prior)
    return fitted_effect(best[1], final.coefficients[0], final.std[0], final.theta_std[0], False, {}), final.change
