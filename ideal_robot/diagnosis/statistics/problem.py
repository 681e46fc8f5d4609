"""The problem of a diagnosis and its solution.

A problem is a regression, its blocks of time, and what is known of its parameters beforehand; a solution is the numbers
of a joint fit, and effects with their numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import Blocks, Columns, Design
from ideal_robot.diagnosis.channels.regression import FEWEST, Regression
from ideal_robot.diagnosis.statistics.least_squares import ROUNDING, Fit, HeldOutTest, weights_of_channels
from ideal_robot.dynamics.base_parameters import consistent_parameters
from ideal_robot.effects import Effect, FittedEffect
from ideal_robot.effects.kinematics import GeometryChange
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places, parameter_vector
from ideal_robot.robots.robot import sliding_unit
from ideal_robot.signals.filters import decimated_columns


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint with fixed theta, and the evidence for it: as it was tested last, or when it was taken.

    Attributes:
        effect, joint, theta: see ``Effect``.
        tries: how many values of theta were looked at to arrive here; p-values are corrected for them.
        p_value: of its held-out score, corrected for the values of theta that were tried.
        share: share of the most affected channel's squares that it takes away on held-out blocks.
        asked: share that was asked of it, once it is taken.
        rivals: names and joints of candidates that the data cannot tell from it, with the share of its reduction that
            they reach; once it is taken.
        test: how much it reduces the residual.
    """

    effect: Effect
    joint: int
    theta: tuple[float, ...] = ()
    tries: int = 1
    p_value: float = field(default=1.0, compare=False)
    share: float = field(default=0.0, compare=False)
    asked: float = field(default=0.0, compare=False)
    rivals: tuple[tuple[str, int, float], ...] = field(default=(), compare=False)
    test: HeldOutTest = field(default=HeldOutTest(), compare=False, repr=False)

    @property
    def key(self) -> str:
        """Name of its group of columns."""
        return f"{self.place}@{','.join(f'{value:.9g}' for value in self.theta)}"

    @property
    def place(self) -> str:
        """Effect, channel and joint without theta: what competes with itself over theta."""
        return f"{self.effect.name}:{self.effect.channel(self.joint)}:{self.joint}:{hash(self.effect)}"

    @property
    def parameter_count(self) -> int:
        """Number of parameters, theta included."""
        return len(self.test.coefficients) + len(self.theta)


@dataclass(frozen=True)
class Estimate:
    """Numbers of a joint fit.

    Attributes:
        effects: that were fitted, with their theta.
        change: of the model's parameters ``(p,)``.
        covariance: of the model's parameters ``(p, p)``.
        coefficients, std, theta_std: of each effect.
        theta_step: by how much each theta would still move, to first order.
    """

    effects: tuple[Candidate, ...]
    change: Array
    covariance: Array
    coefficients: tuple[Array, ...]
    std: tuple[Array, ...]
    theta_std: tuple[Array, ...]
    theta_step: tuple[Array, ...] = ()

    def residual(self, regression: Regression) -> Array:
        """What a regression leaves with these numbers ``(N, c)``."""
        return np.asarray(regression.y - regression.W @ self.change - sum(self.contributions(regression)))

    def contributions(self, regression: Regression) -> list[Array]:
        """What each effect adds at the rows of a regression ``(N, c)``."""
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
        # Geometry and curves are in units of their own, all else in those of its joint.
        of_joint = candidate.joint > 0 and not (isinstance(effect, GeometryChange) or effect.learned)
        if of_joint and prismatic[candidate.joint - 1]:
            parameters = [replace(p, unit=sliding_unit(p.unit)) for p in parameters]
        return FittedEffect(effect.name, candidate.joint, effect.channel(candidate.joint), own, std, theta, theta_std,
                            effect.to_data(), tuple(parameters), evidence or {})

    def all_fitted(self, prismatic: Sequence[bool]) -> tuple[FittedEffect, ...]:
        """See ``fitted``. All effects, in their order."""
        return tuple(self.fitted(k, prismatic) for k in range(len(self.effects)))


def with_parameters(model: Model, change: Array, covariance: Array | None = None) -> Model:
    """The model with its parameter vector changed.

    Args:
        model: where to start.
        change: to be added to the parameter vector ``(P,)`` (``ideal_robot.model.parametrisation``).
        covariance: of the new vector ``(P, P)``; that of the model if None.
    """
    base_values = model.base_values + change[: model.base.count]
    places, new = friction_places(model.base, model.friction), []
    start = places[-1].stop
    for law, place in zip(model.friction.laws, places, strict=True):
        # Shapes are positive; a linear step may go to a third or to three times of what they were.
        shape = np.clip(law.shape + change[start : start + len(law.shape), None], law.shape / 3.0, 3.0 * law.shape)
        new.append(type(law)(law.coefficients + change[place, None], shape, presliding=law.presliding,
                             loaded=law.loaded))
        start += len(law.shape)
    # The full parameters that have these base parameters and lie closest to those of before.
    full = model.base.nearest_full(base_values, model.consistent)
    return replace(model, base_values=base_values, friction=PerJointFriction(new), consistent=full,
                   covariance=model.covariance if covariance is None else covariance)


def with_possible_inertias(model: Model, near: Array) -> Model:
    """The model with inertias that bodies can have, nearest to its base parameters.

    A fit of all parameters leaves what the data hardly tell anywhere within its uncertainty, also where no body could
    have it; such an arm cannot be simulated. Predicted torques do not change, they come from the base parameters. What
    cannot be seen keeps near to the possible full parameters ``near (p,)``.

    Raises:
        IdealRobotError: there are none near.
    """
    b = model.base.count
    possible = consistent_parameters(model.base, model.base_values, model.covariance[:b, :b], near)
    return replace(model, consistent=possible.full)


@dataclass(frozen=True)
class Problem:
    """What every fit, test and report of a domain starts from.

    Attributes:
        regression: what was measured, what is expected, what may change.
        blocks: of its rows.
        prior: precision of the model's parameters about zero ``(P, P)``, in the units of the weighted squares; None
            where they are free.
        band: share of the regression's band that is looked at.
        made: what was made of the regression so far, which is the same for all blocks and priors.
    """

    regression: Regression
    blocks: Blocks
    prior: Array | None = None
    band: float = 1.0
    made: dict[object, Any] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, regression: Regression, held_out: bool) -> Problem:
        """The problem of a regression in its blocks of time, of which every fourth may only report."""
        return cls(regression, regression.blocks(held_out))

    @cached_property
    def products(self) -> Design:
        """The parameters of the model alone: rows that are masked and ready for cross-products of blocks."""
        r = self.regression
        if self.band not in self.made:
            self.made[self.band] = Design(self._in_band(r.y), self._in_band(r.W), r.use, self.blocks)
        bare: Design = self.made[self.band].bare(self.blocks)
        return bare

    def with_regression(self, regression: Regression) -> Problem:
        """The same problem about another model."""
        return self if regression is self.regression else replace(self, regression=regression, made={})

    def with_prior(self, prior: Array | None) -> Problem:
        """The same problem with other knowledge of its parameters."""
        return replace(self, prior=prior)

    def slow(self) -> Problem:
        """The same problem in the lower half of its band."""
        return replace(self, band=0.5 * self.band)

    def held(self) -> Problem:
        """The same problem with parameters as the prior has them, so that changes have to be said as effects."""
        return self if self.prior is None else self.with_prior(self.prior / ROUNDING)

    def on_all_blocks(self) -> Problem:
        """The same problem where all blocks estimate: for numbers that are reported, not for selection."""
        return replace(self, blocks=self.blocks.without_folds())

    def prepared(self, columns: Array) -> Columns:
        """Raw columns ``(N_raw, c, m)`` filtered, decimated and masked; channels that are zero are not touched."""
        live, rows = decimated_columns(columns, self.regression.filtered.factor)
        live, rows = live.reshape(columns.shape[1:]), rows[:, self.regression.filtered.keep]
        channels = np.flatnonzero(live.any(axis=1))
        values = np.zeros((rows.shape[1], len(channels), columns.shape[2]))
        values[:, live[channels]] = rows.T
        return Columns(self._in_band(values) * self.regression.use[:, channels, None], tuple(int(j) for j in channels))

    def _in_band(self, values: Array) -> Array:
        """Rows ``(N, …)`` without what is above the band."""
        if self.band >= 1.0 or len(values) < FEWEST:
            return values
        return np.asarray(signal.sosfiltfilt(signal.butter(4, self.band, output="sos"), values, axis=0))

    def columns(self, candidate: Candidate) -> Columns:
        """A candidate's columns at the rows of the regression; each round asks for many of the round before."""
        recent: dict[Any, Columns] = self.made.setdefault("recent", {})
        key = candidate.key, self.band
        recent[key] = recent.pop(key) if key in recent else self._columns(candidate)
        if len(recent) > 256:
            del recent[next(iter(recent))]
        return recent[key]

    def _columns(self, candidate: Candidate) -> Columns:
        signals, effect = self.regression.signals, candidate.effect
        columns, m = effect.columns(signals, candidate.joint, candidate.theta), len(effect.coefficient_names)
        # Of some causes a recording shows the first coefficients only; a curve has as many as it has knots.
        if np.ndim(columns) != 3 or len(columns) != len(signals.t) or (columns.shape[2] > m and not effect.learned):
            raise InputError(f"columns of {type(effect).__name__} have to be ({len(signals.t)}, c, {m}): samples, "
                             "channels, coefficients; Signals.on_joint makes them", field="effects",
                             value=np.shape(columns))
        group = replace(self.prepared(columns), alike=effect.learned)
        if not np.isfinite(group.values).all():
            raise InputError(f"columns of {type(effect).__name__} hold values that are not finite, of "
                             f"joint {candidate.joint}", field="effects", value=effect.name)
        form = self.form_of_model(candidate)
        if form is None or form.channels != group.channels:
            return group
        remaining, whole = ((values**2).sum(axis=(0, 1)) for values in (group.without(form), group.values))
        share = remaining / np.maximum(whole, 1e-300)
        # A column that is all of that form is judged as any other.
        return replace(group, own=np.where(share > ROUNDING, share, 1.0))

    def form_of_model(self, candidate: Candidate) -> Columns | None:
        """Columns that the model's own parameters make and that a candidate is partly like; None where it is not."""
        place = candidate.effect.name, candidate.joint, self.band
        if place not in self.made:
            columns = candidate.effect.like_the_model(self.regression.signals, candidate.joint)
            self.made[place] = None if columns is None else self.prepared(columns)
        form: Columns | None = self.made[place]
        return form

    def design(self, effects: Sequence[Candidate] = ()) -> Design:
        """Parameters of the model and columns of effects, with their cross-products."""
        design = self.products.bare(self.blocks)
        for candidate in effects:
            design.add(candidate.key, self.columns(candidate))
        return design

    def fit(self, effects: Sequence[Candidate] = (), *, uncertainty: bool = False,
            misfit: bool = False) -> Estimate:
        """Fits the model's parameters and effects together on the estimating blocks.

        Args:
            effects: with their theta.
            uncertainty: whether standard deviations are wanted; theta's derivative columns then join the fit.
            misfit: whether those of the effects hold what the model class leaves, for the report.
        """
        design, keys = self.design(effects), ["W", *[c.key for c in effects]]
        fit = Fit(design, keys, weights_of_channels(design, keys, self.prior), self.prior)
        p = self.products.W.m
        *firsts, end = np.cumsum([p, *(design.groups[c.key].m for c in effects)])
        change, *coefficients = np.split(fit.beta, firsts)
        if not uncertainty:
            return Estimate(tuple(effects), change, np.zeros((p, p)), tuple(coefficients), (), ())
        moved = [self._add_theta_columns(design, c, own) for c, own in zip(effects, coefficients, strict=True)]
        extra = [key for keys_of in moved for key in keys_of if key is not None]
        whole = Fit(design, [*keys, *extra], fit.refitted_weights(), self.prior)
        covariance = whole.covariance()
        variance = np.maximum(np.diag(covariance), 0.0)
        # Of white noise a part of the band holds its share.
        noise = np.sqrt(self.band) * self.regression.noise_floor
        sigma = np.sqrt(variance + whole.misfit_variance(noise) if misfit else variance)
        where = {key: end + i for i, key in enumerate(extra)}
        theta_std, step = ([np.array([0.0 if key is None else values[where[key]] for key in keys_of])
                            for keys_of in moved] for values in (sigma, whole.beta))
        return Estimate(tuple(effects), change, covariance[:p, :p], tuple(coefficients),
                        tuple(np.split(sigma[:end], firsts)[1:]), tuple(theta_std), tuple(step))

    def _add_theta_columns(self, design: Design, candidate: Candidate, coefficients: Array) -> list[str | None]:
        """Adds, for each physical theta, what moving it changes in the prediction, ``dC/dtheta c``; names of groups."""
        effect, signals, joint, theta = candidate.effect, self.regression.signals, candidate.joint, candidate.theta
        physical = effect.theta_is_physical and bool(effect.bounds(signals, joint))
        names = [f"d{i}:{candidate.key}" if physical and value != 0.0 else None for i, value in enumerate(theta)]
        for i, (name, value) in enumerate(zip(names, theta, strict=True)):
            if name is None:
                continue
            if (name, self.band) not in self.made:
                step = 1e-3 * max(abs(value), 1e-6)
                after, before = (effect.columns(signals, joint, (*theta[:i], value + side, *theta[i + 1 :]))
                                 for side in (step, -step))
                self.made[name, self.band] = self.prepared((after - before) / (2.0 * step))
            by_theta = self.made[name, self.band]
            design.add(name, Columns((by_theta.values @ coefficients)[:, :, None], by_theta.channels))
        return names


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
    squares = np.zeros((products.c, products.W.m))
    for j, gram in problem.design().cross("W", "W").items():
        squares[j, products.acting(products.W, j)[0]] = np.einsum("bii->i", gram[problem.blocks.selecting])
    torque = (problem.regression.measured**2 * products.use).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        moves = 0.002 * np.sqrt(torque[:, None] / squares)
        visible = np.min(np.where(squares > 0, moves, np.inf), axis=0)
    # Friction changes from day to day, bodies do not.
    values = parameter_vector(np.zeros(model.base.count), model.friction)
    size = len(values)
    floor = np.where(np.isfinite(visible[:size]), np.hypot(0.02 * values, visible[:size]), 1.0)
    return np.asarray(model.covariance + np.diag(floor**2))


def torque_left_open(model: Model, problem: Problem) -> Array:
    """Standard deviation of each joint's torque, as what is not known of the parameters makes it ``(n,)`` [N m]."""
    covariance, regression = prior_covariance(model, problem), problem.regression
    result = np.full(len(regression.channels), np.inf)
    for j in range(len(result)):
        rows = regression.W[regression.use[:, j], j]
        moves = np.any(rows != 0.0, axis=0)
        rows, own = rows[:, moves], covariance[np.ix_(moves, moves)]
        if len(rows) and np.isfinite(own).all():
            result[j] = np.sqrt(np.mean(np.sum(rows @ own * rows, axis=1)))
    return result
