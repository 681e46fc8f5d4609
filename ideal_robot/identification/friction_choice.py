"""Chooses friction law and shape of each joint: jointly with the rigid body.

For one joint at a time all other parameters are eliminated (variable projection), the shape parameters are found by a
coarse search and a bounded optimiser, and the law is chosen by its error on held-out intervals of the recordings.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import optimize

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.friction import FrictionModel, PerJointFriction, law_of
from ideal_robot.identification.friction_runs import FoldEquations, FrictionProjection
from ideal_robot.signals.preprocess import FilteredSignals

_FOLDS = 6
"""Stretches of the recordings, each held back once."""
_WORTH = 0.02
"""A law with more parameters must lower the held-out error by this share."""
_PRESLIDING = (1e-5, 0.1)
"""Presliding distances that are tried [rad or m]: from an encoder's step to more than any gear gives."""
_CLEARLY = 0.9
"""Once presliding lowers the held-out error to this share, laws without it are not tried any more; a spring of a cable
has to."""
_VARIES = 0.1
"""Least share of its size by which a load must vary; else its friction is dry friction by another name."""


@dataclass(frozen=True)
class Candidate:
    """A law with its refinements, before its parameters are known."""

    law: type[FrictionModel]
    presliding: bool
    loaded: bool

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the shape parameters."""
        return [*self.law.shape_bounds, *[_PRESLIDING] * self.presliding]

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.law.coefficient_names) + self.loaded + len(self.bounds)

    @cached_property
    def braking(self) -> np.ndarray:
        """Mask of the coefficients that must not be negative, as they would drive the joint instead of braking it."""
        return self.make([1.0] * len(self.bounds)).nonnegative

    def make(self, shape: Sequence[float], coefficients: Array | None = None) -> FrictionModel:
        """A law of one joint; unit coefficients unless given."""
        rows = len(self.law.coefficient_names) + self.loaded
        c = np.ones(rows) if coefficients is None else coefficients
        return self.law(c[:, None], np.array(shape, dtype=float)[:, None], presliding=self.presliding,
                        loaded=self.loaded)


def brakes(law: FrictionModel, fastest: float) -> bool:
    """Whether a one-joint law dissipates energy at all speeds up to a little above ``fastest``."""
    speed = np.linspace(0.02, 1.2, 60) * fastest
    speed = np.concatenate([-speed, speed])[:, None]
    return bool(np.all(law.torque(speed) * speed >= 0.0))


def candidates(laws: Sequence[type[FrictionModel]], refine: bool) -> list[Candidate]:
    """The laws with every combination of refinements, if permitted; the simplest first."""
    options = [(False, False), (True, False), (False, True), (True, True)] if refine else [(False, False)]
    return sorted((Candidate(law, p, load) for law in laws for p, load in options), key=lambda c: c.size)


class FrictionChoice:
    """Decimated data of all recordings, ready for fitting friction laws joint by joint.

    Args:
        signals: one per recording.
        rigid: decimated regressor of everything but friction ``(M, n, b)``, recordings one after another.
        y: decimated torque ``(M, n)``.
        load: torque the gears transmit, per recording ``(N, n)``; input of laws with load dependence.
        noise: noise level per joint ``(n,)`` for the weights.
        information: prior of the rigid parameters, as an inverse covariance ``(b, b)``; the prior means are subtracted
            from ``y``.
        barred: joints, counted from 0, whose load is too uncertain for load-dependent friction.
    """

    def __init__(self, signals: Sequence[FilteredSignals], rigid: Array, y: Array, load: Sequence[Array],
                 noise: Array, information: Array, barred: frozenset[int] = frozenset()) -> None:
        self._signals, self._load = signals, load
        self._live = np.asarray(~np.isnan(y).all(axis=0))
        noise = np.where(self._live, noise, 1.0)
        self._rigid, self._noise = rigid * self._live[:, None] / noise[:, None], noise
        self._y = np.where(self._live, y, 0.0) / noise
        self._fastest = np.max([np.max(np.abs(s.qd), axis=0) for s in signals], axis=0)
        size = np.abs(np.concatenate(load))
        self._load_varies = np.std(size, axis=0) > _VARIES * np.sqrt(np.mean(size**2, axis=0))
        self._load_varies[list(barred)] = False
        ends = [-(-len(y) * fold // _FOLDS) for fold in range(_FOLDS + 1)]
        self._folds = [slice(first, last) for first, last in itertools.pairwise(ends)]
        self._motions: dict[int, list[tuple[Array, Array, Array]]] = {}
        self._filtered: dict[tuple[int, float, int], Array] = {}
        self._cache: dict[tuple[int, Candidate, tuple[float, ...]], Array] = {}
        self._size = np.maximum(np.linalg.norm(self._rigid.reshape(-1, rigid.shape[2]), axis=0), 1e-12)
        self._rigid /= self._size
        self._information = information / np.outer(self._size, self._size)
        self._equations = [self._equations_of(rows) for rows in self._folds]

    def columns(self, joint: int, candidate: Candidate, shape: tuple[float, ...]) -> Array:
        """Decimated, weighted regressor ``(M, m)`` of a law at a joint.

        Args:
            joint: from 0.
            candidate, shape: law with its refinements, and its shape parameters.
        """
        key = (joint, candidate, shape)
        if key not in self._cache:
            law, motion = candidate.make(shape), self._motion(joint)
            parts = [self._decimated(i, law.regressor(*values)[:, 0]) for i, values in enumerate(motion)]
            self._cache[key] = np.concatenate(parts) / self._noise[joint]
        return self._cache[key]

    def _motion(self, joint: int) -> list[tuple[Array, Array, Array]]:
        """Velocity, load and position of one joint in each recording ``(N, 1)``, copied out once."""
        if joint not in self._motions:
            self._motions[joint] = [(s.qd[:, [joint]], load[:, [joint]], s.q[:, [joint]])
                                    for s, load in zip(self._signals, self._load, strict=True)]
        return self._motions[joint]

    def _decimated(self, recording: int, columns: Array) -> Array:
        """Decimated columns; most laws share most of theirs, so each is filtered once."""
        result = []
        for column in np.ascontiguousarray(columns.T):
            # Columns with the same sum that are the same at many samples are the same.
            key = recording, float(column.sum()), hash(column[:: 1 + len(column) // 500].tobytes())
            if key not in self._filtered:
                self._filtered[key] = self._signals[recording].decimate(column)
            result.append(self._filtered[key])
        return np.column_stack(result)

    def pulled(self, springs: Array) -> np.ndarray:
        """Mask ``(n,)`` of joints with a spring: with one, the held-out prediction is clearly better.

        A hose or cable along the arm is one. Without it, direction-dependent friction would be fitted instead.

        Args:
            springs: decimated torques of a spring of 1 N m/rad on each joint ``(M, n)`` [N m].
        """
        simplest = Candidate(law_of("viscous_coulomb"), presliding=True, loaded=False)
        chosen = [(simplest, self._start(simplest))] * self._y.shape[1]
        mask = np.zeros(len(chosen), dtype=bool)
        for j in np.flatnonzero(self._live).tolist():
            projection = self._projection(chosen, j)
            columns = self.columns(j, simplest, self._shape(projection, j, simplest, {}, polish=False))
            both = np.column_stack([columns, springs[:, j] / self._noise[j]])
            with_spring = projection.held_out(both, np.append(simplest.braking, True))
            mask[j] = with_spring < _CLEARLY * projection.held_out(columns, simplest.braking)
        return mask

    def choose(self, options: Sequence[Candidate]) -> tuple[list[FrictionModel], list[dict[str, float]]]:
        """The best option for each joint with its shape (coefficients still ones), and the held-out errors of all.

        The errors are standard deviations per joint and option, in units of the noise.
        """
        n = self._y.shape[1]
        chosen = [(options[0], self._start(options[0])) for _ in range(n)]
        scores: list[dict[str, float]] = [{} for _ in range(n)]
        for sweep, j in itertools.product(range(2), np.flatnonzero(self._live).tolist()):
            projection = self._projection(chosen, j)
            known: dict[str, float] = {}
            best: tuple[float, Candidate] | None = None
            rigid = np.inf
            # The second pass over a joint, with the others fitted better, only compares the best candidates.
            for option in options if sweep == 0 else _leaders(options, scores[j]):
                if option.loaded and not self._load_varies[j]:
                    continue
                if best is not None and best[1].presliding and not option.presliding and best[0] < _CLEARLY * rigid:
                    continue
                shape = self._shape(projection, j, option, known, polish=False)
                columns = self.columns(j, option, shape)
                if not brakes(option.make(shape, projection.coefficients(columns, option.braking)), self._fastest[j]):
                    continue
                score = projection.held_out(columns, option.braking)
                scores[j][option.make(shape).label] = score
                if not option.presliding:
                    rigid = min(rigid, score)
                if best is None or score < best[0] * (1.0 - _WORTH * (option.size > best[1].size)):
                    best = (score, option)
            # In short recordings none of the leaders may brake; the simplest law, with braking terms only, does.
            law = options[0] if best is None else best[1]
            chosen[j] = law, self._shape(projection, j, law, known, polish=True)
        return [option.make(shape) for option, shape in chosen], scores

    def _start(self, option: Candidate) -> tuple[float, ...]:
        return tuple(float(np.sqrt(low * high)) for low, high in option.bounds)

    def _shape(self, projection: FrictionProjection, joint: int, option: Candidate, known: dict[str, float],
               polish: bool) -> tuple[float, ...]:
        """Bounded search for the shape parameters in logarithmic scale: each from a grid, then Nelder and Mead.

        What another law of the same joint has found already (``known``) is taken over and not searched again, except
        when polishing the law that was chosen.
        """
        if not option.bounds:
            return ()
        low, high = np.log10(np.array(option.bounds)).T
        # The presliding distance hardly depends on the law; the law's own shape does once there is presliding.
        names = [name if name == "presliding" else f"{option.law.key} {name} {option.presliding}"
                 for name, _ in option.make(self._start(option)).names_of_shape]

        def error(x: Array) -> float:
            shape = tuple(float(v) for v in 10.0 ** np.clip(x, low, high))
            return projection.error(self.columns(joint, option, shape), option.braking)

        log = np.log10([known.get(name, start) for name, start in zip(names, self._start(option), strict=True)])
        for i, name in enumerate(names):
            if name not in known:
                log = min((np.where(np.arange(len(log)) == i, x, log) for x in np.linspace(low[i], high[i], 10)[1:-1]),
                          key=error)
        free = len(log) if polish else sum(name not in known for name in names)
        if free:
            optimum = optimize.minimize(error, log, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)),
                                        options={"xatol": 0.03, "fatol": 1e-5, "maxfev": 12 * free})
            log = optimum.x
        shape = tuple(float(v) for v in 10.0 ** np.clip(log, low, high))
        for name, value in zip(names, shape, strict=True):
            known.setdefault(name, value)
        return shape

    def _equations_of(self, rows: slice) -> FoldEquations:
        W = self._rigid[rows].reshape(-1, self._rigid.shape[2])
        y = self._y[rows].reshape(-1)
        return FoldEquations(W.T @ W, W.T @ y, float(y @ y))

    def _projection(self, chosen: Sequence[tuple[Candidate, tuple[float, ...]]], joint: int) -> FrictionProjection:
        """Everything but this joint's friction, as normal equations of each fold."""
        other_columns = [(j, self.columns(j, *chosen[j])) for j in range(self._y.shape[1]) if j != joint]
        b = self._rigid.shape[2]
        total = b + sum(columns.shape[1] for _, columns in other_columns)
        known = np.zeros((total, total))
        known[:b, :b] = self._information
        folds = []
        for rows, own in zip(self._folds, self._equations, strict=True):
            full, side = np.zeros((total, total)), np.zeros(total)
            full[:b, :b], side[:b] = own.gram, own.side
            column = b
            for j, columns in other_columns:
                F = columns[rows]
                span = slice(column, column + F.shape[1])
                full[span, span] = F.T @ F
                full[:b, span] = self._rigid[rows, j].T @ F
                full[span, :b] = full[:b, span].T
                side[span] = F.T @ self._y[rows, j]
                column = span.stop
            folds.append(FoldEquations(full, side, own.square))
        return FrictionProjection(folds, self._folds, known, self._rigid[:, joint], self._y[:, joint])


def _leaders(options: Sequence[Candidate], scores: dict[str, float]) -> list[Candidate]:
    """The options within two per cent of the best held-out error; all of them where none has braked."""
    if not scores:
        return list(options)
    best = min(scores.values())
    near = {label for label, score in scores.items() if score < 1.02 * best}
    return [o for o in options if o.make([1.0] * len(o.bounds)).label in near] or [options[0]]


def with_coefficients(laws: Sequence[FrictionModel], coefficients: Array) -> PerJointFriction:
    """The chosen laws with their fitted coefficients, which are stacked joint after joint in one vector."""
    parts = np.split(coefficients, np.cumsum([len(law.coefficients) for law in laws]))
    return PerJointFriction([law.altered(part[:, None]) for law, part in zip(laws, parts, strict=False)])


# Friction that falls while a gear warms up, [G] Figs 3 and 12: a law multiplied by ``1 + α (T_ref - T) / 10 K``.

@dataclass(frozen=True)
class WarmUp:
    """Change of one joint's friction with gear temperature.

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

    Raises InputError for a law with shape parameters, or too little change to see anything.

    Args:
        law: without shape parameters, e.g. ``CubeRoot``.
        qd, tau, temperature: velocities [rad/s], friction torques [N m], gear temperatures [°C], ``(N,)`` each.
    """
    if law.shape_names:
        raise InputError("a law without shape parameters is needed (viscous_coulomb, cube_root, asymmetric)",
                         field="law", value=law.key)
    if np.ptp(temperature) < 1.0:
        raise InputError("the gear's temperature hardly changes in these data; record from cold to warm",
                         field="temperature",
                         value=float(np.ptp(temperature)))
    columns = law(np.ones((len(law.coefficient_names), 1))).regressor(np.asarray(qd, dtype=float)[:, None])[:, 0]
    reference = float(np.max(temperature))

    def solved(alpha: float) -> tuple[Array, Array]:
        scaled = columns * (1.0 + alpha * (reference - temperature) / 10.0)[:, None]
        c = np.asarray(np.linalg.lstsq(scaled, tau, rcond=None)[0])
        return c, tau - scaled @ c

    fit = optimize.least_squares(lambda x: solved(float(x[0]))[1], [0.2])
    alpha = float(fit.x[0])
    (c, residual), constant = solved(alpha), solved(0.0)[1]
    sigma2 = float(residual @ residual) / max(1, len(tau) - len(c) - 1)
    std = float(np.sqrt(np.linalg.pinv(fit.jac.T @ fit.jac)[0, 0] * sigma2))
    return WarmUp(law(c[:, None]), alpha, std, reference, float(np.sqrt(np.mean(residual**2))),
                  float(np.sqrt(np.mean(constant**2))))
