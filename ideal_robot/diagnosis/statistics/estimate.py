"""The final fit: parameters of the model and of all selected effects together, theta included, with their scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import Experiment
from ideal_robot.diagnosis.search.candidates import Candidate, prepared
from ideal_robot.diagnosis.statistics.block_regression import Design, Fit, channel_weights
from ideal_robot.diagnosis.statistics.cross_products import Data
from ideal_robot.effects import EffectParameter, FittedEffect


@dataclass(frozen=True)
class Estimate:
    """Numbers of a joint fit.

    Attributes:
        change: of the model's parameters ``(p,)``.
        covariance: of the model's parameters ``(p, p)``.
        coefficients, std, theta_std: of each effect, in the order of the candidates.
    """

    change: Array
    covariance: Array
    coefficients: tuple[Array, ...]
    std: tuple[Array, ...]
    theta_std: tuple[Array, ...]


def estimate(experiment: Experiment, data: Data, chosen: list[Candidate], prior: Array | None,
             spread: bool = True) -> Estimate:
    """Fits the model's parameters and all chosen effects on the selecting blocks of ``data``.

    Args:
        experiment, data: the regression.
        chosen: effects with their theta.
        prior: precision of the model's parameters, or None.
        spread: whether standard deviations are wanted; theta's derivative columns then join the fit.
    """
    design = Design(data)
    for c in chosen:
        design.add(c.key, c.columns(experiment, data))
    keys = ["W", *[c.key for c in chosen]]
    weights = channel_weights(Fit(design, ["W"], np.ones(data.c), prior).squares(), data.count)
    for _ in range(3):
        fit = Fit(design, keys, weights, prior)
        weights = channel_weights(fit.squares(), data.count)
    beta = fit.beta
    p = data.W.m
    coefficients, at = [], p
    for c in chosen:
        m = design.groups[c.key].m
        coefficients.append(beta[at : at + m])
        at += m
    if not spread:
        return Estimate(beta[:p], np.zeros((p, p)), tuple(coefficients), (), ())

    # Uncertainty: theta moves the prediction by dC/dtheta c, which joins the fit as further columns.
    extra: list[str] = []
    for c, own in zip(chosen, coefficients, strict=True):
        moves = c.effect.theta_is_physical and bool(c.effect.bounds(experiment.signals, c.joint))
        for i in range(len(c.theta) if moves else 0):
            key = f"d{i}:{c.key}"
            step = 1e-3 * max(abs(c.theta[i]), 1e-6)
            if c.theta[i] == 0.0:
                continue
            sides = []
            for sign in (1.0, -1.0):
                theta = list(c.theta)
                theta[i] += sign * step
                sides.append(c.effect.columns(experiment.signals, c.joint, tuple(theta)) @ own)
            design.add(key, prepared(experiment, data, ((sides[0] - sides[1]) / (2.0 * step))[:, :, None]))
            extra.append(key)
    full = Fit(design, [*keys, *extra], weights, prior)
    covariance = full.covariance()
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std, theta_std, at = [], [], p
    for c in chosen:
        m = design.groups[c.key].m
        std.append(sigma[at : at + m])
        at += m
    where = {key: at + i for i, key in enumerate(extra)}
    for c in chosen:
        theta_std.append(np.array([sigma[where[f"d{i}:{c.key}"]] if f"d{i}:{c.key}" in where else 0.0
                                   for i in range(len(c.theta))]))
    return Estimate(beta[:p], covariance[:p, :p], tuple(coefficients), tuple(std), tuple(theta_std))


def fitted_effect(candidate: Candidate, coefficients: Array, std: Array, theta_std: Array,
                  prismatic: bool, evidence: dict[str, object]) -> FittedEffect:
    """The effect with its numbers, ready for a model file; units of a prismatic joint in metres and newtons."""
    effect = candidate.effect
    theta = candidate.theta
    parameters = effect.parameters(coefficients, std, theta, tuple(float(v) for v in theta_std))
    if prismatic:
        parameters = [EffectParameter(p.name, p.value, p.std, linear_unit(p.unit)) for p in parameters]
    return FittedEffect(effect.name, candidate.joint, effect.channel(candidate.joint),
                        tuple(float(v) for v in coefficients), tuple(float(v) for v in std),
                        tuple(float(v) for v in theta), tuple(float(v) for v in theta_std), effect.to_data(),
                        tuple(parameters), evidence)


def linear_unit(unit: str) -> str:
    """The unit of a prismatic joint's parameter: N m → N, rad → m, kg m² → kg."""
    return unit.replace("N m", "N").replace("kg m²", "kg").replace("rad", "m")
