"""Numbers of a joint fit, and an effect with its numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.dynamics.base_parameters import consistent_parameters
from ideal_robot.effects import Effect, FittedEffect
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.model import Model

# A candidate: an effect at a joint, with fixed theta.

@dataclass(frozen=True)
class Candidate:
    """An effect at a joint with fixed theta.

    Attributes:
        effect, joint, theta: see ``Effect``.
        tries: how many values of theta were looked at to arrive here; p-values are corrected for them.
    """

    effect: Effect
    joint: int
    theta: tuple[float, ...] = ()
    tries: int = 1

    @property
    def key(self) -> str:
        """Name of its group of columns."""
        return f"{self.place}@{','.join(f'{value:.9g}' for value in self.theta)}"

    @property
    def place(self) -> str:
        """Effect, channel and joint without theta: what competes with itself over theta."""
        return f"{self.effect.name}:{self.effect.channel(self.joint)}:{self.joint}:{id(self.effect)}"

    @property
    def parameter_count(self) -> int:
        """Number of parameters, theta included."""
        return len(self.effect.coefficient_names) + len(self.theta)


@dataclass(frozen=True)
class Estimate:
    """Numbers of a joint fit.

    Attributes:
        change: of the model's parameters ``(p,)``.
        covariance: of the model's parameters ``(p, p)``.
        coefficients, std, theta_std: of each effect, in the order of the candidates.
        theta_step: by how much each theta would still move, to first order.
    """

    change: Array
    covariance: Array
    coefficients: tuple[Array, ...]
    std: tuple[Array, ...]
    theta_std: tuple[Array, ...]
    theta_step: tuple[Array, ...] = ()

    def residual(self, regression: Regression, effects: Sequence[Candidate]) -> Array:
        """What a regression leaves with these numbers ``(N, c)``; ``effects`` are those of the fit, in their order."""
        r = regression.y - regression.W @ self.change
        for added in self.contributions(regression, effects):
            r = r - added
        return np.asarray(r)

    def contributions(self, regression: Regression, effects: Sequence[Candidate]) -> list[Array]:
        """What each effect adds at the rows of a regression ``(N, c)``."""
        return [regression.decimate(c.effect.columns(regression.signals, c.joint, c.theta) @ own)
                for c, own in zip(effects, self.coefficients, strict=True)]


def fitted_effect(candidate: Candidate, found: Estimate, k: int, *, sliding: bool = False,
                  evidence: Mapping[str, Any] | None = None) -> FittedEffect:
    """An effect with its numbers, ready for a model file.

    Args:
        candidate: effect, joint and theta.
        found: the joint fit, with uncertainty.
        k: its place among the effects of that fit.
        sliding: whether its joint slides, so that its parameters are in metres and newtons.
        evidence: for ``FittedEffect``.
    """
    effect, theta = candidate.effect, tuple(float(v) for v in candidate.theta)
    theta_std = tuple(float(v) for v in found.theta_std[k])
    parameters = effect.parameters(found.coefficients[k], found.std[k], theta, theta_std)
    if sliding:
        parameters = [replace(p, unit=linear_unit(p.unit)) for p in parameters]
    return FittedEffect(effect.name, candidate.joint, effect.channel(candidate.joint),
                        tuple(float(v) for v in found.coefficients[k]), tuple(float(v) for v in found.std[k]), theta,
                        theta_std, effect.to_data(), tuple(parameters), evidence or {})


def linear_unit(unit: str) -> str:
    """The unit of a prismatic joint's parameter: N m → N, rad → m, kg m² → kg."""
    return unit.replace("N m", "N").replace("kg m²", "kg").replace("rad", "m")


# A model with other parameters, as a joint fit with the effects leaves them.

def with_parameters(model: Model, change: Array, covariance: Array | None = None) -> Model:
    """The model with its parameter vector changed.

    Args:
        model: where to start.
        change: to be added to the parameter vector ``(P,)`` (``ideal_robot.model.parametrisation``).
        covariance: of the new vector ``(P, P)``; that of the model if None.
    """
    at = model.base.count
    base_values = model.base_values + change[:at]
    laws = []
    for law in model.friction.laws:
        count = len(law.coefficients)
        laws.append((law, law.coefficients + change[at : at + count, None]))
        at += count
    new = []
    for law, coefficients in laws:
        # Shapes are positive; a linear step may go to a third or to three times of what they were.
        shape = np.clip(law.shape + change[at : at + len(law.shape), None], law.shape / 3.0, 3.0 * law.shape)
        new.append(type(law)(coefficients, shape, presliding=law.presliding, loaded=law.loaded))
        at += len(law.shape)
    return dataclasses.replace(
        model, base_values=base_values, friction=PerJointFriction(new),
        covariance=model.covariance if covariance is None else covariance,
        # The full parameters that have these base parameters and lie closest to those of before.
        consistent=model.base.nearest_full(base_values, model.consistent))


def with_possible_inertias(model: Model, near: Array) -> Model:
    """The model with inertias that bodies can have, nearest to its base parameters.

    A fit of all parameters leaves what the data hardly tell anywhere within its uncertainty, also where no body could
    have it; such an arm cannot be simulated. Predicted torques do not change, they come from the base parameters.

    Args:
        model: whose base parameters they shall have.
        near: possible full parameters ``(p,)`` that what cannot be seen keeps near to.

    Raises:
        IdealRobotError: there are none near.
    """
    b = model.base.count
    possible = consistent_parameters(model.base, model.base_values, model.covariance[:b, :b], near)
    return dataclasses.replace(model, consistent=possible.full)
