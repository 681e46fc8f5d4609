"""The estimation problem of a diagnosis and its solution.

A problem is a regression with a prior of its parameters; a solution is the numbers of a joint fit, and effects with
their numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.blocks import Blocks, Columns
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.system import System
from ideal_robot.dynamics.consistent_inertias import consistent_parameters
from ideal_robot.effects import FittedEffect
from ideal_robot.effects.kinematics import GeometryChange
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places
from ideal_robot.robots.robot import sliding_unit
from ideal_robot.signals.filters import decimated_columns

FORM_ERROR = 0.025
"""Share of a size to which the form of a cause is right, at best: sizes of causes in four engines of others scatter by
two to three per cent more than their noise explains."""


@dataclass(frozen=True)
class Estimate:
    """Coefficients and parameters of a joint fit.

    Attributes:
        effects: the effects that were fitted, with their theta.
        change: of the model's parameters ``(p,)``.
        covariance: of the model's parameters ``(p, p)``.
        coefficients, std, theta_std: of each effect.
    """

    effects: tuple[Candidate, ...]
    change: Array
    covariance: Array
    coefficients: tuple[Array, ...]
    std: tuple[Array, ...]
    theta_std: tuple[Array, ...]

    def of_model(self, count: int) -> Estimate:
        """The estimate of the first ``count`` parameters, those of the model, without daily changes."""
        return replace(self, change=self.change[:count], covariance=self.covariance[:count, :count])

    def residual(self, regression: Regression) -> Array:
        """Residual of a regression with this estimate ``(N, c)``."""
        return np.asarray(regression.y - regression.W @ self.change - sum(self.contributions(regression)))

    def contributions(self, regression: Regression) -> list[Array]:
        """Contribution of each effect at the rows of a regression ``(N, c)``."""
        return [regression.columns_of(c.effect, c.joint, c.theta) @ own
                for c, own in zip(self.effects, self.coefficients, strict=True)]

    def fitted(self, k: int, prismatic: Sequence[bool], *, evidence: Mapping[str, Any] | None = None) -> FittedEffect:
        """Effect ``k`` with its numbers, ready for a model file; of a fit with uncertainty.

        Args:
            k: its place among the effects.
            prismatic: which joints slide, so that parameters of theirs are in metres and newtons ``(n,)``.
            evidence: for ``FittedEffect``.
        """
        candidate, effect = self.effects[k], self.effects[k].effect
        own, std, theta, theta_std = (tuple(map(float, values)) for values in (
            self.coefficients[k], self.std[k], candidate.theta, self.theta_std[k]))
        parameters = effect.parameters(self.coefficients[k], self.std[k], theta, theta_std)
        # Geometry and curves have units of their own, all else those of its joint.
        of_joint = candidate.joint > 0 and not (isinstance(effect, GeometryChange) or effect.learned)
        if of_joint and prismatic[candidate.joint - 1]:
            parameters = [replace(p, unit=sliding_unit(p.unit)) for p in parameters]
        return FittedEffect(effect.name, candidate.joint, effect.channel(candidate.joint), own, std, theta, theta_std,
                            effect.to_data(), tuple(parameters), evidence or {})

    def all_fitted(self, prismatic: Sequence[bool]) -> tuple[FittedEffect, ...]:
        """All effects with their numbers, in their order, ready for a model file; see ``fitted``."""
        return tuple(self.fitted(k, prismatic) for k in range(len(self.effects)))


def with_parameters(model: Model, change: Array, covariance: Array | None = None) -> Model:
    """The model with its parameter vector changed.

    Args:
        model: the model that is changed.
        change: to be added to the parameter vector ``(P,)`` (``ideal_robot.model.parametrisation``).
        covariance: of the new vector ``(P, P)``; that of the model if None.
    """
    base_values = model.base_values + change[: model.base.count]
    places, new = friction_places(model.base, model.friction), []
    start = places[-1].stop
    for law, place in zip(model.friction.laws, places, strict=True):
        # Shapes are positive; a linear step is limited to a factor of three.
        shape = np.clip(law.shape + change[start : start + len(law.shape), None], law.shape / 3.0, 3.0 * law.shape)
        new.append(type(law)(law.coefficients + change[place, None], shape, presliding=law.presliding,
                             loaded=law.loaded))
        start += len(law.shape)
    # The full parameters that have these base parameters and lie closest to those of before.
    full = model.base.nearest_full(base_values, model.consistent)
    return replace(model, base_values=base_values, friction=PerJointFriction(new), consistent=full,
                   covariance=model.covariance if covariance is None else covariance)


def with_possible_inertias(model: Model, near: Array) -> Model:
    """The model with physically possible inertias, nearest to its base parameters.

    Poorly determined parameters of a fit may be physically impossible, so that the arm cannot be simulated. Predicted
    torques do not change, as they use the base parameters. Undetermined parameters stay near to the possible full
    parameters ``near (p,)``.

    Raises:
        IdealRobotError: there are none near.
    """
    b = model.base.count
    possible = consistent_parameters(model.base, model.base_values, model.covariance[:b, :b], near)
    return replace(model, consistent=possible.full)


@dataclass(frozen=True)
class Problem:
    """The data that every fit, score and report of a domain share.

    Attributes:
        regression: measured values, expected values, and what may change.
        root: matrix ``R (P, k)``, the prior covariance of the model's parameters about zero being ``R R'``; None where
            they are free.
        recent: cached columns of the last candidates.
    """

    regression: Regression
    root: Array | None = None
    recent: dict[str, Columns] = field(default_factory=dict, repr=False, compare=False)

    def with_regression(self, regression: Regression) -> Problem:
        """The same problem about another model."""
        return self if regression is self.regression else replace(self, regression=regression, recent={})

    def with_root(self, root: Array | None) -> Problem:
        """The same problem with another prior of its parameters."""
        return replace(self, root=root)

    @cached_property
    def blocks(self) -> Blocks:
        """Blocks of time of the rows."""
        return self.regression.blocks()

    def prepared(self, columns: Array) -> Columns:
        """Raw columns ``(N_raw, c, m)`` filtered, decimated and masked; zero channels are skipped."""
        live, rows = decimated_columns(columns, self.regression.filtered.factor)
        live, rows = live.reshape(columns.shape[1:]), rows[:, self.regression.filtered.keep]
        channels = np.flatnonzero(live.any(axis=1))
        values = np.zeros((rows.shape[1], len(channels), columns.shape[2]))
        values[:, live[channels]] = rows.T
        return Columns(values * self.regression.use[:, channels, None], tuple(int(j) for j in channels))

    def columns(self, candidate: Candidate) -> Columns:
        """A candidate's columns at the rows of the regression, cached from round to round."""
        key = candidate.key
        self.recent[key] = self.recent.pop(key) if key in self.recent else self._columns(candidate)
        if len(self.recent) > 256:
            del self.recent[next(iter(self.recent))]
        return self.recent[key]

    def _columns(self, candidate: Candidate) -> Columns:
        signals, effect = self.regression.signals, candidate.effect
        columns, m = effect.columns(signals, candidate.joint, candidate.theta), len(effect.coefficient_names)
        # A recording may determine only the first coefficients of some causes; a curve has as many as knots.
        if np.ndim(columns) != 3 or len(columns) != len(signals.t) or (columns.shape[2] > m and not effect.learned):
            raise InputError(f"columns of {type(effect).__name__} have to be ({len(signals.t)}, c, {m}): samples, "
                             "channels, coefficients; Signals.on_joint makes them", field="effects",
                             value=np.shape(columns))
        group = self.prepared(columns)
        if not np.isfinite(group.values).all():
            raise InputError(f"columns of {type(effect).__name__} hold values that are not finite, of "
                             f"joint {candidate.joint}", field="effects", value=effect.name)
        return group

    def system(self, effects: Sequence[Candidate] = ()) -> System:
        """The whitened rows, with the noise of the residual of the model's parameters and these effects."""
        r = self.regression
        system = System(r.y, r.W, r.use, self.root)
        keys = ["W", *[c.key for c in effects]]
        for candidate in effects:
            system.add(candidate.key, self.columns(candidate))
        fitted = system.posterior(keys)
        for _ in range(2):
            system.with_noise(system.residual(keys, fitted.mean))
            fitted = system.with_levels(keys)
        return system

    def fit(self, effects: Sequence[Candidate] = (), *, uncertainty: bool = False) -> Estimate:
        """Fits the model's parameters and effects together.

        Args:
            effects: with their theta.
            uncertainty: whether standard deviations are wanted; theta's derivative columns then join the fit.
        """
        return self.numbers(self.system(effects), effects, uncertainty)

    def numbers(self, system: System, effects: Sequence[Candidate], uncertainty: bool = True,
                inflate: bool = False, more: dict[str, Array] | None = None) -> Estimate:
        """Coefficients of effects in a system of known noise, fitted together with the model's parameters.

        Args:
            system, effects: rows in units of their noise, with the effects' columns.
            uncertainty: whether standard deviations are wanted; theta's derivative columns then join the fit.
            inflate: whether a residual that is larger than its noise widens them.
            more: prior precision of each effect's coefficients ``(m, m)``, by the name of its group.
        """
        keys = ["W", *[c.key for c in effects]]
        fitted, places, p = system.posterior(keys, more), system.places(keys), self.regression.W.shape[2]
        own, change = [fitted.mean[places[c.key]] for c in effects], (system.root @ fitted.mean[: system.p])[:p]
        if not uncertainty:
            return Estimate(tuple(effects), change, np.zeros((p, p)), tuple(own), (), ())
        moved = [self._theta_columns(system, c, values) for c, values in zip(effects, own, strict=True)]
        extra = [key for keys_of in moved for key in keys_of if key]
        whole, where = system.posterior([*keys, *extra], more), system.places([*keys, *extra])
        rows = float(system.count.sum())
        free = max(rows - len(whole.mean), 1.0)
        covariance = whole.covariance * (max(whole.squares / free, 1.0) if inflate else rows / free)
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        # No model form is more accurate than this.
        std = [np.hypot(sigma[places[c.key]], FORM_ERROR * np.abs(values))
               for c, values in zip(effects, own, strict=True)]
        # Periodic effects are accurate to their noise, as their periods can be counted.
        theta_std = [np.array([np.hypot(sigma[where[key].start], FORM_ERROR * abs(value) * (not c.effect.scanned))
                               if key else 0.0 for key, value in zip(keys_of, c.theta, strict=True)])
                     for c, keys_of in zip(effects, moved, strict=True)]
        for key in extra:
            system.drop(key)
        own_covariance = (system.root @ covariance[: system.p, : system.p] @ system.root.T)[:p, :p]
        return Estimate(tuple(effects), change, own_covariance, tuple(own), tuple(std), tuple(theta_std))

    def _theta_columns(self, system: System, candidate: Candidate, coefficients: Array) -> list[str]:
        """Adds, for each physical theta, what moving it changes in the prediction; names of groups, empty for none."""
        effect, signals, joint, theta = candidate.effect, self.regression.signals, candidate.joint, candidate.theta
        physical = effect.theta_is_physical and bool(effect.bounds(signals, joint))
        names = []
        for i, value in enumerate(theta):
            if not (physical and value != 0.0):
                names.append("")
                continue
            step = 1e-3 * max(abs(value), 1e-6)
            after, before = (effect.columns(signals, joint, (*theta[:i], value + side, *theta[i + 1 :]))
                             for side in (step, -step))
            group = self.prepared((after - before) / (2.0 * step))
            name = f"d{i}:{candidate.key}"
            system.add(name, Columns((group.values @ coefficients)[:, :, None], group.channels))
            names.append(name)
        return names
