"""Friction that brakes in the final fit too: a coefficient that would drive the joint is held at none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.channels.motor_torque import about_model
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.statistics.estimate import Estimate
from ideal_robot.diagnosis.statistics.with_parameters import with_parameters
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import parameter_vector


def with_braking_friction(case: Case, found: Findings) -> Findings:
    """The findings about a model in which coefficients of friction that come out negative are zero and stay so.

    A model that was given brakes already, and is what errors are compared with.
    """
    if not case.shared or case.given is not None:
        return found
    for _ in range(case.robot.n):
        change = found.problem.on_all_blocks().fit([c.candidate for c in found.choices]).change
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
    mask = np.zeros(len(value), dtype=bool)
    at = model.base.count
    for law in model.friction.laws:
        mask[at : at + len(law.coefficients)] = law.nonnegative
        at += len(law.coefficients)
    return np.asarray(mask & (value < 0.0))


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
