"""A model with other parameters, as a joint fit with the effects leaves them."""

from __future__ import annotations

import dataclasses

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.consistency import consistent_parameters
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.model import Model


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
