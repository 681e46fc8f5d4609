"""Effects of the motor torque beside a model that stays as it is.

A joint fit shares what a recording shows among the effects and all parameters of the model, and what the recording
tells badly goes anywhere: into rotors, gravity, other joints' friction. On another motion that is an error of its own.
Where the model is known and the effects are named, what the recording holds beyond the model is theirs alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.diagnosis.channels.blocks import time_blocks
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.prior import prior_precision
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.effects import FittedEffect
from ideal_robot.model.model import Model


def held_problem(regression: Regression, model: Model) -> Problem:
    """The problem of a recording with the model's parameters held.

    Args:
        regression: of the motor torques, about the model.
        model: that is known.
    """
    blocks = time_blocks(len(regression.t), float(regression.t[1] - regression.t[0]), held_out=False)
    problem = Problem(regression, blocks.without_folds())
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
