"""Friction that falls while a gear warms up, [G] Figs 3 and 12.

A law is scaled by ``1 + α w``, where w says how cold or settled the gear is: with a measured temperature
``w = (T_ref - T) / 10 K``; without one ``w = exp(-t / t_w)``, t since the start of motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.friction.laws import FrictionModel


@dataclass(frozen=True)
class WarmUp:
    """How the friction of one joint changes with gear temperature or with time since start.

    Attributes:
        law: friction of the warm joint (at ``reference``, or long after the start).
        by: ``temperature`` or ``time``.
        surplus: α: relative surplus of friction 10 K below ``reference``, or at the start.
        surplus_std: its standard deviation.
        time: time constant t_w [s]; nan by temperature.
        reference: temperature at which the law holds [°C]; nan by time.
        rms, rms_constant: residual with and without the change [N m].
    """

    law: FrictionModel
    by: str
    surplus: float
    surplus_std: float
    time: float
    reference: float
    rms: float
    rms_constant: float

    def scale(self, cold: Array) -> Array:
        """Factor on the law's torque: ``cold`` is the temperature [°C] or the time since start [s]."""
        return 1.0 + self.surplus * _coldness(self.by, np.asarray(cold, dtype=float), self.reference, self.time)

    def torque(self, qd: Array, cold: Array) -> Array:
        """Friction torque ``(N,)`` [N m] at velocities ``(N,)`` and temperatures or times ``(N,)``."""
        return np.asarray(self.law.torque(np.asarray(qd, dtype=float)[:, None])[:, 0] * self.scale(cold))


def fit_warm_up(law: type[FrictionModel], qd: Array, tau: Array, *, temperature: Array | None = None,
                time: Array | None = None) -> WarmUp:
    """Fits a law and its change while warming up to friction torques of one joint.

    Args:
        law: a law without shape parameters, e.g. ``CubeRoot``.
        qd: velocities ``(N,)`` [rad/s].
        tau: friction torques ``(N,)`` [N m].
        temperature: gear temperatures ``(N,)`` [°C]; preferred where given.
        time: times since the start of motion ``(N,)`` [s], otherwise.

    Raises:
        InputError: neither temperature nor time, a law with shape parameters, or too little change to see anything.
    """
    if law.shape_names:
        raise InputError("a law without shape parameters is needed (viscous_coulomb, cube_root, asymmetric)",
                         field="law", value=law.key)
    if temperature is None and time is None:
        raise InputError("temperatures or times are needed", field="temperature")
    by = "time" if temperature is None else "temperature"
    cold = np.asarray(time if temperature is None else temperature, dtype=float)
    if np.ptp(cold) < (1.0 if by == "temperature" else 10.0):
        raise InputError("the gear hardly warms up in these data", field=by, value=float(np.ptp(cold)))
    columns = law(np.ones((len(law.coefficient_names), 1))).regressor(np.asarray(qd, dtype=float)[:, None])[:, 0]
    reference = float(np.max(cold)) if by == "temperature" else float("nan")

    def solved(time_constant: float, alpha: float) -> tuple[Array, Array]:
        scaled = columns * (1.0 + alpha * _coldness(by, cold, reference, time_constant))[:, None]
        c = np.asarray(np.linalg.lstsq(scaled, tau, rcond=None)[0])
        return c, tau - scaled @ c

    def residual(x: Array) -> Array:
        return solved(float(np.exp(x[1])) if by == "time" else float("nan"), float(x[0]))[1]

    starts = [[0.2, np.log(share * np.ptp(cold))] for share in (0.1, 0.3, 1.0)] if by == "time" else [[0.2, 0.0]]
    found = min((optimize.least_squares(residual, x0) for x0 in starts), key=lambda result: result.cost)
    t_w = float(np.exp(found.x[1])) if by == "time" else float("nan")
    c, left = solved(t_w, float(found.x[0]))
    count = len(c) + (2 if by == "time" else 1)
    sigma2 = float(left @ left) / max(1, len(tau) - count)
    std = float(np.sqrt(np.linalg.pinv(found.jac.T @ found.jac)[0, 0] * sigma2))
    constant = solved(1.0, 0.0)[1]
    return WarmUp(law(c[:, None]), by, float(found.x[0]), std, t_w, reference, float(np.sqrt(np.mean(left**2))),
                  float(np.sqrt(np.mean(constant**2))))


def _coldness(by: str, cold: Array, reference: float, time: float) -> Array:
    return np.asarray((reference - cold) / 10.0 if by == "temperature" else np.exp(-cold / time))
