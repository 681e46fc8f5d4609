"""A model with other parameters, as a joint fit with the effects leaves them."""

from __future__ import annotations

import dataclasses

import numpy as np

from ideal_robot.friction import PerJointFriction
from ideal_robot.interface import Array
from ideal_robot.model import Model


def with_parameters(model: Model, change: Array, covariance: Array | None = None) -> Model:
    """The model with its parameter vector changed.

    Args:
        model: where to start.
        change: to be added to the parameter vector ``(P,)`` (``ideal_robot.parametrisation``); what follows after the
            ``P`` parameters (nuisances of a fit) is ignored.
        covariance: of the new vector ``(P, P)``; that of the model if None.
    """
    size = len(model.covariance)
    covariance = None if covariance is None else covariance[:size, :size]
    at = model.base.count
    base_values = model.base_values + change[:at]
    laws = []
    for law in model.friction.laws:
        count = len(law.coefficients)
        laws.append((law, law.coefficients + change[at : at + count, None]))
        at += count
    new = []
    for law, coefficients in laws:
        low = np.array([bound[0] for bound in law.shape_bounds])[:, None]
        high = np.array([bound[1] for bound in law.shape_bounds])[:, None]
        shape = law.shape + change[at : at + len(law.shape), None]
        new.append(type(law)(coefficients, np.clip(shape, low, high) if len(low) else shape))
        at += len(law.shape)
    return dataclasses.replace(
        model, base_values=base_values, friction=PerJointFriction(new),
        covariance=model.covariance if covariance is None else covariance,
        # The full parameters that have these base parameters and lie closest to those of before.
        consistent=model.base.nearest_full(base_values, model.consistent))
