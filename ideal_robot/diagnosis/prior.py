"""What is known of a model's parameters before a recording: nothing, the same arm, or another arm of its type.

    Λ⁻¹ = cov(model) + daily spread                                        the same arm
    Λ⁻¹ = cov(model) + daily spread + G diag(spread of the type)² G'        another arm of its type

with G the grouping of full into base parameters ([G] 3.1.2). "All parameters are others" is so a set like all others:
it pays for its parameters by their prior, and a load of one number beats forty free ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.dynamics.base_parameters import parameter_scales
from ideal_robot.estimate.noise import ColouredNoise
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places, parameter_vector

DAILY_FRICTION = 0.04
"""By which friction of one arm differs from day to day: 3 % of dry friction, 5 % of what rises with speed."""
TYPE_FRICTION = 0.15
"""By which friction of two arms of one type differs."""
TYPE_LINK = 0.10
"""By which a link as a whole is heavier in another arm of the type."""
TYPE_PARAMETER = 0.05
"""By which each of its ten parameters differs, of its scale; a rotor's inertia likewise."""
ANOTHER_ARM = -float(np.log(2.0))
"""Logarithm of how likely another arm of the type is, against the same: an arm is exchanged, or its model shared."""
MISFIT = 0.5
"""Of what a model left where it was identified, the part that is there again on another motion; 0.5 has the largest
evidence of 0.5, 1 and 2 on short motions of four shipped scenes."""
MEMORY = 0.2
"""Time over which what a model leaves follows itself [s]."""
_ORDER = 8
"""Of the autoregression of a known noise: white noise beside what has a memory."""


@dataclass(frozen=True)
class Hypothesis:
    """What the parameters of a given model are taken for.

    Attributes:
        name: in words.
        precision: of the parameters about the model's ``(P, P)``.
        logarithm: of its probability beforehand, against the same arm.
    """

    name: str
    precision: Array
    logarithm: float


SAME, TYPE = "the same arm", "another arm of its type"


def hypotheses(model: Model, regression: Regression) -> Iterator[Hypothesis]:
    """The same arm, and another arm of its type.

    Args:
        model: that was given.
        regression: of the motor torques about it.
    """
    same = _same(model, regression)
    yield Hypothesis(SAME, _precision(same), 0.0)
    yield Hypothesis(TYPE, _precision(same + _of_type(model)), ANOTHER_ARM)


def _same(model: Model, regression: Regression) -> Array:
    values = parameter_vector(model.base_values, model.friction)
    spread = np.zeros(len(values))
    for place in friction_places(model.base, model.friction):
        spread[place] = DAILY_FRICTION * values[place]
    covariance = np.array(model.covariance) + np.diag(spread**2)
    # No parameter is known to better than what moves a torque by a five-hundredth of its size.
    squares = np.einsum("ncp,nc->cp", regression.W**2, regression.use.astype(float))
    torque = (regression.measured**2 * regression.use).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        moves = 0.002 * np.sqrt(torque[:, None] / squares)
    visible = np.min(np.where(squares > 0.0, moves, np.inf), axis=0)
    visible = np.where(np.isfinite(visible), visible, 1e-12 + np.abs(values))
    return np.asarray(covariance + np.diag(visible**2))


def _of_type(model: Model) -> Array:
    n, b = model.n, model.base.count
    full = np.asarray(model.consistent)
    scale = parameter_scales(full, n)
    own = np.diag((TYPE_PARAMETER * np.append(scale[: 11 * n], 0.0 * full[11 * n :])) ** 2)
    for i in range(n):
        link = np.zeros(12 * n)
        link[10 * i : 10 * i + 10] = TYPE_LINK * full[10 * i : 10 * i + 10]
        own += np.outer(link, link)
    values = parameter_vector(model.base_values, model.friction)
    more = np.zeros((len(values), len(values)))
    more[:b, :b] = model.base.grouping @ own @ model.base.grouping.T
    for place in friction_places(model.base, model.friction):
        more[place, place] += np.diag((TYPE_FRICTION * values[place]) ** 2)
    return more


def _precision(covariance: Array) -> Array:
    """Inverse of a covariance; none where it is not finite."""
    known = np.isfinite(covariance).all(axis=0)
    result = np.zeros_like(covariance)
    own = covariance[np.ix_(known, known)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-300))
    inverse = np.linalg.inv(own * np.outer(scale, scale) + 1e-9 * np.eye(len(own)))
    result[np.ix_(known, known)] = inverse * np.outer(scale, scale)
    return np.asarray(0.5 * (result + result.T))


def noise_of(model: Model, regression: Regression) -> tuple[ColouredNoise, ...]:
    """Noise of each torque as the model has it: what is measured, and what its class leaves, which has a memory.

    Args:
        model: whose ``noise_std`` is what it left where it was identified.
        regression: of the motor torques about it.
    """
    lags = np.arange(_ORDER + 1) * regression.step
    result = []
    for floor, left in zip(regression.noise_floor, model.noise_std, strict=True):
        covariance = (MISFIT * left) ** 2 * np.exp(-lags / MEMORY)
        covariance[0] += max(float(floor), 1e-3 * float(left)) ** 2
        result.append(ColouredNoise.of_autocovariance(np.maximum(covariance, 1e-30)))
    return tuple(result)
