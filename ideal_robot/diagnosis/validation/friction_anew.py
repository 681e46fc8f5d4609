"""One joint's friction fitted anew beside a model that otherwise stays as it is."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.statistics.with_parameters import with_parameters
from ideal_robot.model.model import Model


def friction_anew(regression: Regression, model: Model, joints: tuple[int, ...]) -> dict[int, Model]:
    """The model with the friction coefficients of one joint as a recording has them, for each of some joints.

    A coefficient at most doubles, and none changes its sign: what a motion tells badly stays near what was known. The
    law and its shape stay, so does all else of the model.

    Args:
        regression: of the motor torques, about the model.
        model: that is known; its effects stay.
        joints: from 1.

    Returns:
        A model for each joint whose friction can be told.
    """
    result: dict[int, Model] = {}
    at = model.base.count
    for joint, law in enumerate(model.friction.laws, start=1):
        columns = slice(at, at + len(law.coefficients))
        at = columns.stop
        use = regression.use[:, joint - 1]
        known = law.coefficients[:, 0]
        free = np.abs(known) > 0.0
        if joint not in joints or joint in regression.undecided or not free.any() or np.count_nonzero(use) < len(known):
            continue
        change, own = np.zeros(regression.W.shape[2]), np.arange(columns.start, columns.stop)[free]
        change[own] = lsq_linear(regression.W[use, joint - 1][:, own], regression.y[use, joint - 1],
                                 (-np.abs(known[free]), np.abs(known[free]))).x
        result[joint] = with_parameters(model, change)
    return result
