"""Friction from motions at constant velocity, gravity removed by the mean of both directions, [G] 3.1.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.friction import Arctan, CubeRoot, FrictionModel


@dataclass(frozen=True)
class FrictionFit:
    """A law fitted to speeds and torques of one joint.

    Attributes:
        law: the law with its parameters.
        covariance: of coefficients, then shape ``(m + s, m + s)``.
        rms: of the residual [N m].
        held_out_rms: of the residual at speeds the fit had not seen [N m].
    """

    law: FrictionModel
    covariance: Array
    rms: float
    held_out_rms: float

    @property
    def std(self) -> Array:
        """Standard deviations of coefficients, then shape ``(m + s,)``."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def fit_law(law: type[FrictionModel], qd: Array, tau: Array) -> FrictionFit:
    """Fits one law: linear ones by least squares, shape parameters by bounded optimisation from several starts.

    Args:
        law: one of ``ideal_robot.friction.LAWS``.
        qd: velocities ``(N,)`` [rad/s], both signs.
        tau: friction torques ``(N,)`` [N m].

    Raises:
        InputError: fewer points than parameters.
    """
    qd, tau = np.asarray(qd, dtype=float), np.asarray(tau, dtype=float)
    count = len(law.coefficient_names) + len(law.shape_names)
    if len(qd) <= count:
        raise InputError(f"{law.key} has {count} parameters; more speeds than that are needed", field="speeds",
                         value=len(qd))
    fitted = _fitted(law, qd, tau)
    residual = tau - fitted.torque(qd[:, None])[:, 0]
    J = np.column_stack([fitted.regressor(qd[:, None])[:, 0], _shape_derivative(fitted, qd)])
    sigma2 = float(residual @ residual) / (len(qd) - count)
    covariance = np.asarray(np.linalg.pinv(J.T @ J) * sigma2)
    return FrictionFit(fitted, covariance, float(np.sqrt(np.mean(residual**2))), _held_out(law, qd, tau))


def choose_law(qd: Array, tau: Array, laws: Sequence[type[FrictionModel]] = (CubeRoot, Arctan)) -> FrictionFit:
    """The law with the smallest mean square error on held-back speeds; [G] chooses between (2) and (3).

    Args:
        qd: constant velocities ``(N,)`` [rad/s].
        tau: friction torques ``(N,)`` [N m].
        laws: to choose from.
    """
    return min((fit_law(law, qd, tau) for law in laws), key=lambda fit: fit.held_out_rms)


def _fitted(law: type[FrictionModel], qd: Array, tau: Array) -> FrictionModel:
    def with_shape(values: np.ndarray) -> tuple[FrictionModel, float]:
        shape = np.asarray(values, dtype=float)[:, None]
        columns = law(np.ones((len(law.coefficient_names), 1)), shape).regressor(qd[:, None])[:, 0]
        c = np.asarray(np.linalg.lstsq(columns, tau, rcond=None)[0])
        return law(c[:, None], shape), float(np.sum((tau - columns @ c) ** 2))

    if not law.shape_names:
        return with_shape(np.empty(0))[0]
    low, high = np.log(np.array(law.shape_bounds)).T
    starts = [low + share * (high - low) for share in (0.1, 0.3, 0.5, 0.7, 0.9)]
    found = [optimize.minimize(lambda x: with_shape(np.exp(x))[1], start, method="Nelder-Mead",
                               bounds=list(zip(low, high, strict=True))) for start in starts]
    return with_shape(np.exp(min(found, key=lambda result: result.fun).x))[0]


def _shape_derivative(law: FrictionModel, qd: Array) -> Array:
    columns = []
    for i in range(len(law.shape)):
        step = np.zeros_like(law.shape)
        step[i] = 1e-5 * law.shape[i]
        up, down = (law.altered(shape=law.shape + sign * step).torque(qd[:, None])[:, 0] for sign in (1, -1))
        columns.append((up - down) / (2 * step[i, 0]))
    return np.column_stack(columns) if columns else np.empty((len(qd), 0))


def _held_out(law: type[FrictionModel], qd: Array, tau: Array) -> float:
    """Root mean square error at each fifth of the speeds, fitted to the others; both directions of a speed together."""
    order = np.argsort(np.argsort(np.round(np.abs(qd), 6), kind="stable"), kind="stable") // 2
    errors = []
    for fold in range(5):
        out = order % 5 == fold
        if not out.any() or (~out).sum() <= len(law.coefficient_names) + len(law.shape_names):
            continue
        errors.append(tau[out] - _fitted(law, qd[~out], tau[~out]).torque(qd[out][:, None])[:, 0])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else float("inf")
