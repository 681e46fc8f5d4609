"""Numbers of a joint fit, and an effect with its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.effects import FittedEffect


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
