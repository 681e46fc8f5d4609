"""Friction from motions at constant velocity; gravity cancels in the mean of both directions, [G] 3.1.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg, optimize
from scipy.signal import butter, filtfilt

from ideal_robot.arrays import Array
from ideal_robot.effects import EffectParameter, FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.friction import Arctan, CubeRoot, FrictionModel
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import shape_columns
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


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

    Raises InputError for fewer points than parameters.

    Args:
        law: one of ``ideal_robot.friction.LAWS``.
        qd, tau: velocities of both signs [rad/s], and friction torques [N m], ``(N,)`` each.
    """
    qd, tau = np.asarray(qd, dtype=float), np.asarray(tau, dtype=float)
    count = len(law.coefficient_names) + len(law.shape_names)
    if len(qd) <= count:
        raise InputError(f"{law.key} has {count} parameters; more speeds than that are needed", field="speeds",
                         value=len(qd))
    fitted = _fitted(law, qd, tau)
    residual = tau - fitted.torque(qd[:, None])[:, 0]
    J = np.column_stack([fitted.regressor(qd[:, None])[:, 0], shape_columns(fitted, qd[:, None], None, None)])
    sigma2 = float(residual @ residual) / (len(qd) - count)
    covariance = np.asarray(np.linalg.pinv(J.T @ J) * sigma2)
    return FrictionFit(fitted, covariance, float(np.sqrt(np.mean(residual**2))), _held_out(law, qd, tau))


def choose_law(qd: Array, tau: Array, laws: Sequence[type[FrictionModel]] = (CubeRoot, Arctan)) -> FrictionFit:
    """The law with the least mean square error on held-out speeds; [G] chooses between (2) and (3). See ``fit_law``."""
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
    optima = [optimize.minimize(lambda x: with_shape(np.exp(x))[1], start, method="Nelder-Mead",
                                bounds=list(zip(low, high, strict=True))) for start in starts]
    return with_shape(np.exp(min(optima, key=lambda result: result.fun).x))[0]


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


# Fits one joint's friction together with all other parameters, which are eliminated.
#
# Candidates for a joint's friction change few columns in the rows of that joint alone. All other parameters are
# eliminated once by Cholesky's decomposition, those without columns in the joint's rows first; a candidate's normal
# equations then have only its own few columns (Schur complement).

_RIDGE = 1e-9
"""Of a normal matrix's diagonal: what no row moves stays zero instead of singular."""


@dataclass(frozen=True)
class FoldEquations:
    """Weighted normal equations of one interval of time, without the friction of the fitted joint.

    Attributes:
        gram: ``WᵀW`` ``(P, P)``.
        side: ``Wᵀy`` ``(P,)``.
        square: ``yᵀy``.
    """

    gram: Array
    side: Array
    square: float


@dataclass(frozen=True)
class _Moments:
    """Products of a candidate's columns F over some rows: with those of the joint, with each other, with the torque."""

    own: Array
    gram: Array
    side: Array

    def less(self, other: _Moments) -> _Moments:
        return _Moments(self.own - other.own, self.gram - other.gram, self.side - other.side)


@dataclass(frozen=True)
class _Eliminated:
    """What is left when all but a candidate's coefficients are eliminated.

    Attributes:
        root: Cholesky's factor of the joint's own parameters, all others eliminated before ``(b, b)``.
        side: right-hand side of these, divided by the factor ``(b,)``.
        rest: sum of squares that is left without the candidate.
    """

    root: Array
    side: Array
    rest: float

    @classmethod
    def of(cls, gram: Array, side: Array, square: float, own: int) -> _Eliminated:
        """Eliminates all parameters; the joint's ``own`` come last."""
        gram = gram.copy()
        gram.flat[:: len(gram) + 1] += _RIDGE * np.maximum(np.diag(gram), 1e-9)
        root = linalg.cholesky(gram, lower=True)
        z = linalg.solve_triangular(root, side, lower=True)
        first = len(side) - own
        return cls(np.asfortranarray(root[first:, first:]), z[first:], square - float(z @ z))

    def solved(self, moments: _Moments, bounded: np.ndarray) -> tuple[Array, Array, float]:
        """A candidate's coefficients ``(m,)``, the joint's own parameters ``(b,)`` and the sum of squares left.

        Bounded coefficients that want to be negative are zero, worst first.
        """
        passed, _ = linalg.lapack.dtrtrs(self.root, moments.own, lower=1)
        gram = moments.gram - passed.T @ passed
        gram.flat[:: len(gram) + 1] += _RIDGE * np.maximum(np.diag(moments.gram), 1e-9)
        side = moments.side - passed.T @ self.side
        free = np.ones(len(side), dtype=bool)
        p = np.linalg.solve(gram, side)
        while np.any(p[bounded] < 0.0):
            free[np.argmin(np.where(bounded, p, 0.0))] = False
            p = np.zeros(len(side))
            p[free] = np.linalg.solve(gram[np.ix_(free, free)], side[free])
        own, _ = linalg.lapack.dtrtrs(self.root, self.side - passed @ p, lower=1, trans=1)
        return p, own, self.rest - float(side @ p)


class FrictionProjection:
    """Normal equations, by folds, of everything but one joint's friction, and that joint's own rows.

    Args:
        folds: normal equations of each stretch; in the parameters' order of ``own``.
        rows: of each stretch.
        known: prior of the parameters, as an inverse covariance ``(P, P)``.
        own: the joint's rows of the rigid parameters, which are the first of all ``(M, b)``.
        y: the joint's torque ``(M,)``.
    """

    def __init__(self, folds: Sequence[FoldEquations], rows: Sequence[slice], known: Array, own: Array,
                 y: Array) -> None:
        felt = own.any(axis=0)
        self._own, self._y, self._rows = np.ascontiguousarray(own[:, felt].T), np.ascontiguousarray(y), rows
        places = np.flatnonzero(felt)
        order = np.concatenate([np.setdiff1d(np.arange(len(known)), places), places])
        self._folds = [FoldEquations(fold.gram[np.ix_(order, order)], fold.side[order], fold.square) for fold in folds]
        self._known = known[np.ix_(order, order)]

    def _eliminated(self, folds: Sequence[FoldEquations]) -> _Eliminated:
        return _Eliminated.of(self._known + np.sum([fold.gram for fold in folds], axis=0),
                              np.sum([fold.side for fold in folds], axis=0), sum(fold.square for fold in folds),
                              len(self._own))

    @cached_property
    def _all(self) -> _Eliminated:
        return self._eliminated(self._folds)

    @cached_property
    def _without(self) -> list[_Eliminated]:
        """The eliminated problem with each of the folds left out."""
        return [self._eliminated([*self._folds[:k], *self._folds[k + 1 :]]) for k in range(len(self._folds))]

    def _moments(self, F: Array, rows: slice) -> _Moments:
        F = F[rows]
        return _Moments(self._own[:, rows] @ F, F.T @ F, F.T @ self._y[rows])

    def error(self, F: Array, bounded: np.ndarray) -> float:
        """Sum of squares of the full fit with this friction regressor ``(M, m)``; ``bounded (m,)`` not negative."""
        F, _ = _scaled(F)
        return self._all.solved(self._moments(F, slice(None)), bounded)[2]

    def coefficients(self, F: Array, bounded: np.ndarray) -> Array:
        """Coefficients of this joint's law ``(m,)`` in the full fit."""
        F, size = _scaled(F)
        return self._all.solved(self._moments(F, slice(None)), bounded)[0] / size

    def held_out(self, F: Array, bounded: np.ndarray) -> float:
        """Standard deviation of the joint's residual on held-out folds."""
        F, _ = _scaled(F)
        every, total = self._moments(F, slice(None)), 0.0
        for rows, eliminated in zip(self._rows, self._without, strict=True):
            p, own, _ = eliminated.solved(every.less(self._moments(F, rows)), bounded)
            residual = self._y[rows] - own @ self._own[:, rows] - F[rows] @ p
            total += float(residual @ residual)
        return float(np.sqrt(total / len(self._y)))


def _scaled(F: Array) -> tuple[Array, Array]:
    """Columns of unit length, and what they were."""
    size = np.maximum(np.sqrt(np.einsum("km,km->m", F, F)), 1e-12)
    return F / size, size


# Torque ripple of the motors, from the slow parts of a recording.
#
# Cogging and gear meshing repeat a whole number of times per motor turn, so with known gear ratios only amplitude and
# phase of a few orders are unknown, which is linear:
#
# τ - τ_model = Σ_o a_o cos(o i q) + b_o sin(o i q) + error of friction ,   i gear ratio, o = 1, 2, …
#
# Only slow motion is used: there the controller compensates the ripple completely, so that the current shows it.

_ORDERS = tuple(range(1, 9))
"""Periods in a turn of the motor that are looked for."""
_FREQUENCY = (0.3, 6.0)
"""Ripple frequencies that count [Hz]: slower is friction's, faster is not answered by the controller."""
_CUTOFF = 25.0
"""Low-pass of angles before they are differentiated [Hz]."""
_EDGE = 50
"""Samples at both ends in which the low-pass swings in."""
_SIGNIFICANT = 8.0
"""A ripple counts when it is this many standard deviations large."""


def fit_ripple(recordings: Sequence[Recording], model: Model, robot: Robot) -> tuple[FittedEffect, ...]:
    """Ripple of every joint that has one, the strongest order first, as effects ``torque_ripple``.

    Raises InputError where the model is of another arm.

    Args:
        recordings, model: with ``q_i`` and ``tau_i`` every few milliseconds, including slow motion; the model of the
            other torques.
        robot: gear ratios; joints with ratio 1 (unknown) are passed over.
    """
    model.require_arm(robot)
    parts = [_residual(recording, model) for recording in recordings]
    ripples = (_ripples(parts, i, order, float(robot.gear_ratio[i]), robot.units("N m")[i])
               for i in range(model.n) if robot.gear_ratio[i] > 1.0 for order in _ORDERS)
    return tuple(effect for effect in ripples if effect is not None)


def _residual(recording: Recording, model: Model) -> tuple[Array, Array, Array]:
    """Angles, velocities and unexplained torques ``(N, n)``."""
    cycle = float(np.median(np.diff(recording.t)))
    low_pass = butter(4, min(0.9, 2 * _CUTOFF * cycle))
    q, tau = (np.asarray(filtfilt(*low_pass, recording.joints(name), axis=0)) for name in ("q", "tau"))
    qd = np.gradient(q, cycle, axis=0)
    residual = tau - model.inverse_dynamics(q, qd, np.gradient(qd, cycle, axis=0), t=recording.t - recording.t[0])
    inner = slice(_EDGE, -_EDGE)
    return q[inner], qd[inner], residual[inner]


def _ripples(parts: Sequence[tuple[Array, Array, Array]], i: int, order: int, ratio: float, unit: str
             ) -> FittedEffect | None:
    k = order * ratio
    rows, values = [], []
    for q, qd, residual in parts:
        frequency = k * np.abs(qd[:, i]) / (2 * np.pi)
        slow = (frequency > _FREQUENCY[0]) & (frequency < _FREQUENCY[1])
        v = qd[slow, i]
        rows.append(np.column_stack([np.cos(k * q[slow, i]), np.sin(k * q[slow, i]), np.sign(v), v, np.ones(len(v))]))
        values.append(residual[slow, i])
    H, y = np.concatenate(rows), np.concatenate(values)
    if len(y) < 500:
        return None
    x, _, rank, _ = np.linalg.lstsq(H, y, rcond=None)
    if rank < H.shape[1]:
        return None
    rest = y - H @ x
    # Filtered samples are not independent: their number is that of the band.
    independent = max(len(y) * 0.1, 10.0)
    std = np.sqrt(np.diag(np.linalg.inv(H.T @ H / len(y))) * float(rest @ rest) / len(y) / independent)
    size, sigma = float(np.hypot(x[0], x[1])), float(np.hypot(std[0], std[1]))
    if size < _SIGNIFICANT * sigma:
        return None
    return FittedEffect(
        "torque_ripple", i + 1, f"tau_{i + 1}", (float(x[0]), float(x[1])), (float(std[0]), float(std[1])), (k,),
        theta_std=(0.0,),
        parameters=(EffectParameter("amplitude", size, sigma, unit),
                    EffectParameter("order", float(order), 0.0, "1 / motor turn")),
        evidence={"standard_deviations": size / sigma, "how": "regression on slow motion"})
