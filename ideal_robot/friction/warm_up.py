"""Friction that falls while a gear warms up, [G] Figs 3 and 12: a law scaled by ``1 + α (T_ref - T) / 10 K``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.friction.laws import FrictionModel


@dataclass(frozen=True)
class WarmUp:
    """How the friction of one joint changes with gear temperature.

    Attributes:
        law: friction of the joint at ``reference``.
        surplus: α: relative surplus of friction 10 K below ``reference``.
        surplus_std: its standard deviation.
        reference: temperature at which the law holds [°C].
        rms, rms_constant: residual with and without the change [N m].
    """

    law: FrictionModel
    surplus: float
    surplus_std: float
    reference: float
    rms: float
    rms_constant: float


def fit_warm_up(law: type[FrictionModel], qd: Array, tau: Array, temperature: Array) -> WarmUp:
    """Fits a law and its change while warming up to friction torques of one joint.

    Args:
        law: a law without shape parameters, e.g. ``CubeRoot``.
        qd: velocities ``(N,)`` [rad/s].
        tau: friction torques ``(N,)`` [N m].
        temperature: gear temperatures ``(N,)`` [°C].

    Raises:
        InputError: a law with shape parameters, or too little change to see anything.
    """
    if law.shape_names:
        raise InputError("a law without shape parameters is needed (viscous_coulomb, cube_root, asymmetric)",
                         field="law", value=law.key)
    if np.ptp(temperature) < 1.0:
        raise InputError("the gear hardly warms up in these data", field="temperature",
                         value=float(np.ptp(temperature)))
    columns = law(np.ones((len(law.coefficient_names), 1))).regressor(np.asarray(qd, dtype=float)[:, None])[:, 0]
    reference = float(np.max(temperature))

    def solved(alpha: float) -> tuple[Array, Array]:
        scaled = columns * (1.0 + alpha * (reference - temperature) / 10.0)[:, None]
        c = np.asarray(np.linalg.lstsq(scaled, tau, rcond=None)[0])
        return c, tau - scaled @ c

    found = optimize.least_squares(lambda x: solved(float(x[0]))[1], [0.2])
    alpha = float(found.x[0])
    (c, left), constant = solved(alpha), solved(0.0)[1]
    sigma2 = float(left @ left) / max(1, len(tau) - len(c) - 1)
    std = float(np.sqrt(np.linalg.pinv(found.jac.T @ found.jac)[0, 0] * sigma2))
    return WarmUp(law(c[:, None]), alpha, std, reference, float(np.sqrt(np.mean(left**2))),
                  float(np.sqrt(np.mean(constant**2))))
