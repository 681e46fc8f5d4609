"""What is known of a model's parameters before a recording is looked at."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.statistics.least_squares import Fit, weights_of_channels
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.model.model import Model


def prior_precision(model: Model, problem: Problem) -> Array:
    """Precision of the model's parameters ``(P, P)``, in the units of the weighted squares.

    That of ``prior_covariance`` times the number of samples that count for one, as the residual is coloured.
    """
    design = problem.design()
    fit = Fit(design, ["W"], weights_of_channels(design, ["W"], None, 0))
    covariance = prior_covariance(model, problem)
    # Of parameters without a finite covariance nothing is known.
    known = np.isfinite(covariance).all(axis=0) & np.isfinite(covariance).all(axis=1)
    precision = np.zeros_like(covariance)
    precision[np.ix_(known, known)] = fit.inflation * np.linalg.pinv(covariance[np.ix_(known, known)])
    return precision


def prior_covariance(model: Model, problem: Problem) -> Array:
    """Covariance of the model's parameters ``(P, P)``.

    The model's own, never taken for better than two percent of a friction coefficient or, of any parameter, than what
    moves a torque by a five-hundredth of its size.
    """
    products = problem.products
    squares = np.einsum("bcii->ci", problem.design().cross("W", "W")[problem.blocks.selecting])
    torque = (problem.regression.measured**2 * products.use).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        moves = 0.002 * np.sqrt(torque[:, None] / squares)
        visible = np.min(np.where(squares > 0, moves, np.inf), axis=0)
    # Friction changes from day to day, bodies do not.
    friction = np.abs(np.concatenate([np.concatenate([law.coefficients[:, 0] for law in model.friction.laws]),
                                      *[law.shape[:, 0] for law in model.friction.laws]]))
    values = np.concatenate([np.zeros(model.base.count), friction])
    size = len(values)
    floor = np.where(np.isfinite(visible[:size]), np.hypot(0.02 * values, visible[:size]), 1.0)
    return np.asarray(model.covariance + np.diag(floor**2))


def torque_left_open(model: Model, problem: Problem) -> Array:
    """Standard deviation of each joint's torque, as what is not known of the parameters makes it ``(n,)`` [N m]."""
    covariance, made = prior_covariance(model, problem), problem.regression
    result = np.full(len(made.channels), np.inf)
    for j in range(len(result)):
        rows = made.W[made.use[:, j], j]
        moves = np.any(rows != 0.0, axis=0)
        rows, own = rows[:, moves], covariance[np.ix_(moves, moves)]
        if len(rows) and np.isfinite(own).all():
            result[j] = np.sqrt(np.mean(np.sum(rows @ own * rows, axis=1)))
    return result
