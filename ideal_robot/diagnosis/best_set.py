"""Searches the set of causes with the best score: log predictive density of blocks of time plus log prior.

    L(S) = Σ_b ln p(y_b | blocks before, S) + ln prior(S)

A cause outside a set need not be exactly zero: every model class has an error in each direction, a share of its
residual. So the columns of a cause are in both compared sets, with a wide prior where the set has it and a narrow one,
of that share, where it has not. Hence a cause is judged by its size relative to the model class's error, however long
the recording is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, optimize

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.causes import Candidate, Only, candidates
from ideal_robot.diagnosis.channels.blocks import Columns
from ideal_robot.diagnosis.channels.regression import spread
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms, time_period
from ideal_robot.diagnosis.statistics.problem import Estimate, Problem
from ideal_robot.diagnosis.system import System
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, TCP_POSITION, Effect
from ideal_robot.effects.base import Theta
from ideal_robot.effects.fitted import Unknown
from ideal_robot.effects.registry import find
from ideal_robot.errors import RaisedBy
from ideal_robot.estimate.gaussian import Joined, Posterior, joined, posterior, root_of
from ideal_robot.estimate.noise import ColouredNoise, Free
from ideal_robot.estimate.score import evidence
from ideal_robot.progress import Progress, silent

CLASS_ERROR = 0.05
"""Share of a channel's residual (RMS) by which a model class may be wrong in the direction of any one cause."""
CURVE_ERROR = 0.12
"""The same in the direction of a curve, which bends to whatever the class leaves."""
BESIDE = 0.05
"""Share of its contribution by which the form of a cause may be wrong, in the direction of another in its channels."""
SMALLEST = {"rad": 8e-6, "m": 12e-6}
"""What a cause makes of a measured angle or place at most [rad, m] where nobody would care about it; one of four times
that is seen."""
SMALLEST_SEEN = 25e-6
"""The same of a point that a camera sees [m]: a tenth of a millimetre is what it is bought for."""
SMALLEST_SHARE = 0.01
"""The same of a torque about a given model, of what was measured (RMS)."""
LARGEST = 5.0
"""Standard deviations of its size beforehand beyond which no cause is."""
WIDE = 1.0
"""What a cause makes beforehand, in units of what its channel measures (RMS)."""
FREE = 30.0
"""Of what a channel varies by, how far a parameter of which nothing is known may move it."""
ACCEPT = 3.0
"""Nats by which a set has to be better to be taken: odds of twenty to one."""
FINALISTS = 5
"""Candidates of a round that are refined and scored, at most."""
FIRST_STEP = 0.04
"""Of its range, by which a shape among several is moved first as it is refined."""
MOST = 16
"""Causes of a set, at most."""


@dataclass(frozen=True)
class Weighed:
    """A candidate with its gain in score in the present model.

    Attributes:
        candidate, joined: with its coefficients beside the others.
        nats: by which the set with it is better than without, priors and all.
    """

    candidate: Candidate
    joined: Joined
    nats: float


class BestSet:
    """The search for the best set of causes of one regression.

    Args:
        problem: the regression; its prior is that of the model's parameters.
        effects: candidate effects.
        absorbed: whether effects are tried that the model's own parameters could take over.
        only: names and joints of the effects that are permitted; then no curve is tried either.
        noise: of each channel, where it is given; from the residual if None.
        progress: called with the share done and a word.
    """

    def __init__(self, problem: Problem, effects: Sequence[Effect], *, absorbed: bool, only: Only | None = None,
                 noise: Sequence[ColouredNoise] | None = None, progress: Progress = silent) -> None:
        self.problem, self.progress, self.learns, self.fixed = problem, progress, only is None, noise
        self.absorbed = absorbed
        r = self.regression = problem.regression
        self.at_rows = r.decimated_signals()
        self.measured_std = np.maximum(spread(r.measured, r.use), 1e-150)
        self.always: list[Candidate] = []
        self.pool = [starts for starts in candidates(effects, r.signals, absorbed, only)
                     if not self._left_out(starts[0])]
        self.pool.sort(key=lambda starts: starts[0].joint)
        self.choices: list[Candidate] = []
        self.fitted: Posterior
        self._model_alone: Posterior
        self._free: list[Free | None] | None = None
        self.system = System(r.y, r.W, r.use, self._weak(r.W) if problem.root is None else problem.root)
        if r.domain == MOTOR_TORQUE and problem.root is None and r.signals.n > 1:
            self._with_what_every_arm_has()
        self._refresh()

    def _left_out(self, first: Candidate) -> bool:
        channel = self.regression.channel_of(first.joint)
        return channel is not None and not self.regression.use[:, channel].any()

    def _weak(self, base: Array) -> Array:
        """Parameters of which nothing is known, each as far as it moves a channel by ``FREE`` times its spread."""
        use = self.regression.use
        size = np.sqrt(np.einsum("ncp,nc->cp", base**2, use.astype(float)) / np.maximum(use.sum(axis=0), 1)[:, None])
        size = np.max(size / (FREE * self.measured_std[:, None]), axis=0)
        return np.diag(np.where(size > 0.0, 1.0 / np.maximum(size, 1e-300), 0.0))

    # Elasticity and presliding, which every arm has.

    def _with_what_every_arm_has(self) -> None:
        """Each joint's elasticity and presliding at its shortest distance: no cause, but never negative."""
        signals, found = self.regression.signals, []
        for j in range(1, signals.n + 1):
            if not self.regression.use[:, j - 1].any():
                continue
            elastic, presliding = find("joint_elasticity", "tau"), find("presliding_hysteresis", "tau")
            if elastic.usable(signals, j):
                found.append(Candidate(elastic, j))
            found.append(Candidate(presliding, j, (presliding.bounds(signals, j)[0][0],)))
        r = self.regression
        columns = np.zeros((*r.y.shape, len(found)))
        for i, candidate in enumerate(found):
            group = self.problem.columns(candidate)
            columns[:, list(group.channels), i] = group.values[:, :, 0]
        self.always, p = found, r.W.shape[2]
        self.pool = [starts for starts in self.pool if starts[0].effect.key != "joint_elasticity/tau"]
        while True:
            kept = [k for k, candidate in enumerate(found) if candidate in self.always]
            W = np.concatenate([r.W, columns[:, :, kept]], axis=2)
            self.system = System(r.y, W, r.use, self._weak(W))
            self._refresh()
            own = (self.system.root @ self.fitted.mean[: self.system.p])[p : p + len(kept)]
            negative = [self.always[i] for i in np.flatnonzero(own < 0.0)]
            if not negative:
                break
            self.always = [candidate for candidate in self.always if candidate not in negative]

    # The present model.

    @property
    def keys(self) -> list[str]:
        """Names of the column groups in the present fit."""
        return ["W", *[c.key for c in self.choices]]

    def _refresh(self) -> None:
        """Estimates the noise of each channel, its colour and its level, and fits the present set."""
        self._wide: dict[str, Array] = {}
        measured = self.regression.measured * self.regression.use
        self.system.add("measured", Columns(measured[:, :, None], tuple(range(self.system.c))))
        for choice in self.choices:
            self.add(choice)
        if self.fixed is not None:
            self.system.take_noise(self.fixed)
            self.fitted, self._model_alone = self.system.posterior(self.keys), self.system.posterior(["W"])
            return
        fitted = self.system.posterior(self.keys)
        for _ in range(1 if self._free is not None else 2):
            self.system.with_noise(self.system.residual(self.keys, fitted.mean), self._smooth())
            fitted = self.system.with_levels(self.keys)
        self.fitted, self._model_alone = fitted, self.system.posterior(["W"])

    def _smooth(self) -> list[Free | None]:
        """Smooth functions of each channel's own motion: what they explain may be a cause, so no noise."""
        if self._free is None:
            self._free = []
            for j in range(self.system.c):
                use = self.regression.use[:, j]
                self._free.append(Free.of(self._smooth_of(j, use)) if use.any() else None)
        return self._free

    def _smooth_of(self, j: int, use: np.ndarray) -> Array:
        """Orthonormal columns ``(N, k)`` of a channel."""
        signals = self.at_rows
        own = {f"{kind}_{j + 1}" for kind in ("q", "qd", "qdd", "load")} | {"t"} if j < signals.n else {"t"}
        columns = [np.ones((len(use), 1))]
        for term in terms(signals, min(j, signals.n - 1), False, self.regression.domain):
            if len(term.depends_on) == 1 and term.depends_on[0] in own:
                basis = term.basis(signals)
                columns.append(basis * signals.sliding_direction(j + 1)[:, None] if term.directed else basis)
        stacked = np.concatenate(columns, axis=1) * use[:, None]
        stacked = stacked / (np.linalg.norm(stacked, axis=0) + 1e-300)
        # At most a fifth as many functions as rows: otherwise noise would count as smooth.
        U, values, _ = np.linalg.svd(stacked, full_matrices=False)
        return np.asarray(U[:, (values > 1e-4 * values[0]) & (np.arange(len(values)) < use.sum() // 5)])

    def add(self, candidate: Candidate) -> None:
        """Adds a candidate's columns to the system if they are not yet part of it."""
        if candidate.key not in self.system.groups:
            self.system.add(candidate.key, self.problem.columns(candidate))

    def wide(self, candidate: Candidate) -> Array:
        """Root of the prior covariance of the coefficients of a cause in the set ``(m, m)``.

        The prior is the effect's own, or else the size of the channel's variation.
        """
        if candidate.key not in self._wide:
            spread = candidate.effect.spread(self.regression.signals, candidate.joint)
            if isinstance(candidate.effect, Unknown):
                # A curve is nowhere larger than what its channel varies by; not where the motion hardly gets either.
                level = float(self.measured_std[candidate.joint - 1])
                self._wide[candidate.key] = WIDE * level * np.eye(self.system.groups[candidate.key].m)
            elif spread is None:
                # Measured positions are relative to their mean, while a cause may add a constant.
                measured = np.array([max(channel.weight * float(self.system.total(j, key, key)[2].sum())
                                         for key in ("measured", "y")) if channel.weight else 0.0
                                     for j, channel in enumerate(self.system.channels)])
                self._wide[candidate.key] = _spread_of(self.system.beside(candidate.key, [])[1],
                                                       WIDE**2 * self._of_channels(candidate.key, measured))
            else:
                self._wide[candidate.key] = root_of(spread)
        return self._wide[candidate.key]

    def joined(self, candidate: Candidate, fitted: Posterior, keys: Sequence[str]) -> Joined:
        """The gain when the candidate is added to a fit of other groups.

        Args:
            candidate: with its shapes.
            fitted, keys: posterior of the others, and their names.
        """
        self.add(candidate)
        return joined(fitted, *self.system.beside(candidate.key, keys), self.wide(candidate))

    def plausible(self, candidate: Candidate, coefficients: Array) -> bool:
        """Whether the coefficients are physically possible and not of an implausible size."""
        signals = self.regression.signals
        spread = candidate.effect.spread(signals, candidate.joint)
        if spread is not None and np.any(np.abs(coefficients) > LARGEST * np.sqrt(np.diag(spread))):
            return False
        return bool(np.any(coefficients)) and candidate.effect.plausible(
            coefficients, candidate.theta, signals, candidate.joint)

    # The score.

    def narrow(self, candidate: Candidate, others: Sequence[Candidate], matters: bool = False) -> Array:
        """Root of the prior covariance of the coefficients of a cause outside the set ``(m, k)``: the class's error.

        Args:
            candidate, others: the cause, and all that is in the set or beside it.
            matters: whether it may besides be as large as nobody would care about.
        """
        self.add(candidate)
        keys = ["W", *[c.key for c in others if c.key != candidate.key]]
        fitted = self.system.posterior(keys)
        across, own, _ = self.system.beside(candidate.key, keys)
        # A share of the residual, and of other causes in the same channels, as no model form is exact.
        error = (CURVE_ERROR if candidate.effect.learned else CLASS_ERROR) * (1.0 + candidate.effect.usual)
        places, squares = self.system.places(keys), error**2 * self._of_channels(candidate.key, self.system.count)
        channels = set(self.system.groups[candidate.key].channels)
        for other in others:
            # An error in the form of a whole-arm cause appears in single joints.
            if other.key != candidate.key and (other.joint == candidate.joint or (candidate.joint and
                                               channels <= set(self.system.groups[other.key].channels))):
                squares += BESIDE**2 * self._squares_in(other.key, fitted.mean[places[other.key]], channels)
        if self.problem.root is not None:
            # The errors also affect the data from which parameters with a prior are estimated.
            level = 1.0 + squares
            fitted = posterior(self.system.gram_of_all(keys) / level, self.system.full_precision(keys))
            across, own, squares = across / level, own / level, squares / level
        taken = fitted.solve(across.T)
        known = (self.system.full_precision(keys) + np.diag(fitted.rounding)) @ taken
        root = _error_of(own - across @ taken, taken.T @ known, squares)
        return np.hstack([root, np.diag(self._nobody_cares(candidate.key))]) if matters else root

    def _nobody_cares(self, key: str) -> Array:
        """How large each coefficient of a group may be where nobody would care about it ``(m,)``."""
        r, group = self.regression, self.system.groups[key]
        count = np.maximum(r.use[:, list(group.channels)].sum(axis=0), 1)
        size = np.sqrt((group.values**2).sum(axis=0) / count[:, None])
        if r.domain == MOTOR_TORQUE:
            least = SMALLEST_SHARE * self.measured_std * self.absorbed
        else:
            least = np.array([(SMALLEST_SEEN if r.domain == SENSOR and unit == "m" else SMALLEST.get(unit, 0.0))
                              for unit in r.units])
        # For a column in several channels the one with its largest size decides.
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.min(np.where(size > 0.0, least[list(group.channels)][:, None] / size, np.inf), axis=0)
        return np.where(np.isfinite(spread), spread, 0.0) / np.sqrt(group.m)

    def _of_channels(self, key: str, values: Array) -> float:
        """The mean of values of channels ``(c,)``, by how much of a group is in each."""
        channels = list(self.system.groups[key].channels)
        shares = np.array([self.system.channels[j].weight * float(np.trace(self.system.total(j, key, key)[2]))
                           for j in channels])
        return float(shares @ values[channels] / max(float(shares.sum()), 1e-300))

    def _squares_in(self, key: str, mean: Array, channels: set[int]) -> float:
        """Weighted squares of what a group with coefficients ``(m,)`` makes of channels, and no parameter can."""
        of = {j: self.system.channels[j].weight * float(mean[left] @ own @ mean[left])
              for j in self.system.groups[key].channels if self.system.channels[j].weight
              for left, _, own in [self.system.total(j, key, key)]}
        here = sum(squares for j, squares in of.items() if j in channels)
        return float(mean @ self._own_products(key) @ mean) * here / max(sum(of.values()), 1e-300) if here else 0.0

    def _own_products(self, key: str) -> Array:
        """Weighted products of a group with itself, of what the model's parameters cannot make ``(m, m)``."""
        across, own, _ = self.system.beside(key, ["W"])
        return np.asarray(own - across @ self._model_alone.solve(across.T))

    def _beside(self, rest: Sequence[Candidate], wide: Sequence[Candidate], narrow: Sequence[Candidate],
                gram: Array | None = None, matters: bool = False) -> float:
        """Logarithm of the density of the rows with groups beside others, over that without these groups.

        Args:
            rest: the others, all wide.
            wide, narrow: groups that are in the set, and beside it.
            gram: products of all of them in that order, the model's parameters first; of all rows if None.
            matters: see ``narrow``.
        """
        every = [*rest, *wide, *narrow]
        for candidate in every:
            self.add(candidate)
        keys = ["W", *[c.key for c in every]]
        gram = self.system.gram_of_all(keys) if gram is None else gram
        places = self.system.places(keys)
        roots = [*map(self.wide, wide), *(self.narrow(c, [x for x in every if x is not c], matters) for c in narrow)]
        if not roots:
            return 0.0
        P = places["W" if not rest else rest[-1].key].stop
        known = np.append(np.arange(P), len(gram) - 1)
        beforehand = self.system.full_precision(["W", *[c.key for c in rest]], self._precisions(rest))
        present = posterior(gram[np.ix_(known, known)], beforehand)
        own = slice(P, len(gram) - 1)
        return joined(present, gram[own, :P], gram[own, own], gram[own, -1], linalg.block_diag(*roots)).evidence

    def _precisions(self, chosen: Sequence[Candidate]) -> dict[str, Array]:
        """Precision of each cause's coefficients before the data ``(m, m)``."""
        return {c.key: _inverse(self.wide(c)) for c in chosen}

    def cost(self, candidate: Candidate) -> float:
        """Cost in nats of naming the cause."""
        return float(np.log(max(len(self.pool), 1)) + candidate.cost)

    def better(self, chosen: Sequence[Candidate], than: Sequence[Candidate]) -> float:
        """Score of one set less that of another [nats], priors included."""
        common, ours, theirs = _apart(chosen, than)
        return (self._beside(common, ours, theirs) - self._beside(common, theirs, ours) +
                sum(map(self.cost, theirs)) - sum(map(self.cost, ours)))

    def matters(self, choice: Candidate) -> bool:
        """Whether the cause is large enough to be reported; otherwise it is fitted without a name."""
        rest = [c for c in self.choices if c is not choice]
        return self._beside(rest, [choice], []) - self._beside(rest, [], [choice], matters=True) > self.cost(choice)

    def better_by_block(self, chosen: Sequence[Candidate], than: Sequence[Candidate], step: int = 1) -> Array:
        """Shares of the blocks of time in ``better``, without the priors of names ``(B / step,)``.

        Args:
            chosen, than: two sets.
            step: blocks that are combined.
        """
        common, ours, theirs = _apart(chosen, than)
        either = []
        for a, b in ((ours, theirs), (theirs, ours)):
            for candidate in (*common, *a, *b):
                self.add(candidate)
            grams = np.cumsum(self.system.gram(["W", *[c.key for c in (*common, *a, *b)]]), axis=0)[step - 1 :: step]
            either.append(np.diff([0.0, *(self._beside(common, a, b, gram) for gram in grams)]))
        return np.asarray(either[0] - either[1])

    # The search.

    def run(self, start: Sequence[Candidate] = ()) -> list[Candidate]:
        """Searches the best set, starting from another one."""
        self.choices = list(start)
        self._refresh()
        if start:
            self._improve()
        seen: set[frozenset[str]] = set()
        for round_ in range(MOST):
            self.progress(round_ / (round_ + 4.0), f"round {round_ + 1}")
            best = self._best()
            # The noise and its level are computed for each set: a set that recurs ends the search.
            if best is None or (places := frozenset(c.place for c in self.choices)) in seen:
                break
            seen.add(places)
            self.take([*self.choices, best.candidate])
            self._improve()
        if self.learns:
            self._with_curves()
        return self.choices

    def take(self, choices: list[Candidate]) -> None:
        """Makes a set the present one; the colour and level of each channel's noise are estimated anew for it."""
        self.choices = choices
        self._refresh()

    def _best(self) -> Weighed | None:
        """The candidate with the best score; None where none is good enough to be accepted."""
        return next((w for w in self.ranked() if w.nats >= ACCEPT), None)

    def ranked(self, hole: Candidate | None = None, finalists: int = FINALISTS, *,
               anywhere: bool = False, least: float = 0.0) -> list[Weighed]:
        """Candidates added to the set, or replacing one of its causes, refined and scored, best first.

        Args:
            hole: the cause of the set to be replaced, at its joint or ``anywhere``.
            finalists: number of sets that are refined.
            anywhere: whether other joints are tried, too.
            least: nats below which a candidate is none.
        """
        rest = [c for c in self.choices if c is not hole]
        keys = ["W", *[c.key for c in rest]]
        fitted = self.fitted if hole is None else self.system.posterior(keys)
        residual, first = self.system.residual(keys, fitted.mean), []
        for starts in self.pool:
            if not (anywhere or hole is None or not hole.joint or starts[0].joint in (hole.joint, 0)):
                continue
            if not starts[0].effect.scanned and any(starts[0].one_at_most_with(c) for c in rest):
                continue
            with RaisedBy(f"effect {starts[0].effect.key} at joint {starts[0].joint}"):
                best = self._best_start(starts, fitted, keys, residual, least)
            if best is not None and (hole is None or best.candidate.place != hole.place):
                error = joined(fitted, *self.system.beside(best.candidate.key, keys), self.narrow(best.candidate, rest))
                first.append(replace(best, nats=best.nats - error.evidence))
        first.sort(key=lambda w: -w.nats)
        result: list[Weighed] = []
        for k, w in enumerate(first[:finalists]):
            if k >= 2 and w.nats < first[0].nats - 30.0 and w.nats < 0.5 * first[0].nats:
                break
            refined = self.refined(w.candidate, fitted, keys)
            own = self.joined(refined, fitted, keys)
            result.append(Weighed(refined, own, own.evidence - self.cost(refined)))
        # Sorted by the explained part; the size relative to the class's error decides about acceptance.
        result.sort(key=lambda w: -w.nats)
        beside = [] if hole is None else [hole]
        return [replace(w, nats=self._beside(rest, [w.candidate], beside) - self.cost(w.candidate)
                        - self._beside(rest, [], [w.candidate, *beside])) for w in result]

    def _best_start(self, starts: list[Candidate], fitted: Posterior, keys: Sequence[str],
                    residual: Array, least: float) -> Weighed | None:
        """The plausible start with most evidence; None where there is none."""
        first = starts[0]
        if first.effect.scanned:
            thetas, tries = first.effect.starts_from_residual(self.at_rows, first.joint, residual, self.regression.use)
            starts = [replace(first, theta=theta, tries=tries) for theta in thetas]
        best: Weighed | None = None
        for start in starts:
            own = self.joined(start, fitted, keys)
            if (best is None or own.evidence > best.nats) and own.evidence > least and self.plausible(start, own.mean):
                best = Weighed(start, own, own.evidence)
        return None if best is None else replace(best, nats=best.nats - self.cost(best.candidate))

    def refined(self, candidate: Candidate, fitted: Posterior, keys: Sequence[str]) -> Candidate:
        """The candidate with the shapes of largest evidence, given a fit of others.

        Args:
            candidate: with shapes to begin with.
            fitted, keys: posterior of the others, and their names.
        """
        effect, signals = candidate.effect, self.regression.signals
        if not effect.theta_is_physical:
            def coefficients(theta: Theta) -> Array | None:
                other = replace(candidate, theta=theta)
                own = self.joined(other, fitted, keys).mean
                return own if self.plausible(other, own) else None

            return replace(candidate, theta=effect.settled(coefficients, candidate.theta))
        bounds = effect.bounds_near(signals, candidate.joint, candidate.theta)
        if not bounds:
            return candidate
        kept = {candidate.key, *keys}

        def at(theta: Array | float) -> Candidate:
            return replace(candidate, theta=tuple(np.atleast_1d(theta).tolist()))

        def loss(theta: Array | float) -> float:
            other = at(theta)
            own = self.joined(other, fitted, keys)
            if other.key not in kept:
                self.system.drop(other.key)
            return -own.evidence if self.plausible(other, own.mean) else 0.0

        if len(bounds) == 1:
            (low, high), = bounds
            optimum = optimize.minimize_scalar(loss, bounds=(low, high), method="bounded",
                                               options={"maxiter": 14, "xatol": 1e-3 * (high - low)})
        else:
            # Steps are relative to the bounds, not to the start, which may be zero; at a bound they go inwards.
            low, high = np.array(bounds).T
            start = np.clip(np.array(candidate.theta), low, high)
            steps = np.where(start < 0.5 * (low + high), FIRST_STEP, -FIRST_STEP) * (high - low)
            optimum = optimize.minimize(loss, start, method="Nelder-Mead", bounds=bounds, options={
                "maxfev": 60, "xatol": 1e-3, "fatol": 1e-2,
                "initial_simplex": np.vstack([start, start + np.diag(steps)])})
        return at(optimum.x) if optimum.fun < loss(np.array(candidate.theta)) else candidate

    def _improve(self) -> None:
        """Refines shapes, exchanges and removes, while the score rises."""
        for choice in list(self.choices):
            if choice.theta:
                rest = [c for c in self.choices if c is not choice]
                keys = ["W", *[c.key for c in rest]]
                other = self.refined(choice, self.system.posterior(keys), keys)
                if other.key != choice.key and self._beside(rest, [other], []) > self._beside(rest, [choice], []):
                    self.choices = [other if c is choice else c for c in self.choices]
        self._refresh()
        for _ in range(3):
            if not (self._removed() or self._exchanged()):
                break

    def _removed(self) -> bool:
        if len(self.choices) < 2:
            return False
        gone = self.taken_out(lambda rests: [self.better(self.choices, rest) for rest in rests], 0.5 * ACCEPT)
        return gone is not None

    def taken_out(self, gains: Callable[[list[list[Candidate]]], Sequence[float]], least: float) -> Candidate | None:
        """Removes the cause with the least gain from the set and returns it; None if every gain is at least ``least``.

        Args:
            gains: by how much the set is better than each of the sets without one of its causes.
            least: gain that every cause of the set should have [nats].
        """
        rests = [[c for c in self.choices if c is not choice] for choice in self.choices]
        gained = gains(rests)
        worst = int(np.argmin(gained))
        if gained[worst] >= least:
            return None
        choice = self.choices[worst]
        self.take(rests[worst])
        return choice

    def _exchanged(self) -> bool:
        for choice in self.choices:
            rest = [c for c in self.choices if c is not choice]
            for other in self.ranked(choice, 3):
                before = self.choices
                if self.better([*rest, other.candidate], before) > 1.0:
                    self.take([*rest, other.candidate])
                    # Each set has its own noise: the exchange has to be better with that of either.
                    if self.better(self.choices, before) > 0.0:
                        return True
                    self.take(before)
        return False

    # Curves without a cause.

    def _with_curves(self) -> None:
        """Takes curves, beside a joint's causes or in the place of one or all, while the score rises."""
        for _ in range(3):
            best: tuple[float, list[Candidate]] | None = None
            for j in range(self.system.c):
                here = [c for c in self.choices if c.joint == j + 1 and not c.effect.learned]
                for holes in [(), *((c,) for c in here), *([tuple(here)] if len(here) > 1 else [])]:
                    for curve in self.curves_of(j, holes):
                        other = [*[c for c in self.choices if c not in holes], curve]
                        nats = self.better(other, self.choices)
                        if nats > ACCEPT and (best is None or nats > best[0]):
                            best = nats, other
            if best is None:
                break
            self.take(best[1])
            self._improve()

    def curves_of(self, j: int, holes: Sequence[Candidate]) -> list[Candidate]:
        """The three best curves of one channel, from 0, replacing causes of the set or added to all."""
        r, domain = self.regression, self.regression.domain
        use = r.use[:, j]
        if not use.any() or any(c.effect.learned and c.joint == j + 1 for c in self.choices):
            return []
        if j >= r.signals.n and domain != TCP_POSITION:
            return []
        keys = ["W", *[c.key for c in self.choices if c not in holes]]
        residual = self.system.residual(keys, self.system.posterior(keys).mean)
        period = time_period(residual[:, j], use, self.at_rows.t, domain)
        curves = [*terms(self.at_rows, j, not holes, domain), *([] if period is None else [period])]
        tests = sorted(self._dependence.tests(residual[:, j], j, curves),
                       key=lambda d: (d.expected - d.share) / max(1.0 - d.expected, 1e-12))
        found = [Candidate(d.term, j + 1, (), len(tests) * self.system.c) for d in tests[:3] if d.p_value < 0.01]
        for curve in found:
            self.add(curve)
        return found

    @property
    def _dependence(self) -> DependenceTest:
        if not hasattr(self, "_tests"):
            self._tests = DependenceTest(self.at_rows, self.regression.use, self.problem.blocks)
        return self._tests

    def total(self, others: Sequence[Candidate]) -> float:
        """Total score of the best set with its prior, to compare sets under other priors of parameters.

        Args:
            others: causes of the sets that it is compared with; those that it does not contain are counted as its
                alternatives.
        """
        own, narrow = {c.place for c in self.choices}, {c.place: c for c in others}
        alone = evidence(self.system.gram_of_all(["W"]), self.system.precision)
        return (alone + self._beside([], self.choices, [c for place, c in narrow.items() if place not in own])
                - sum(map(self.cost, self.choices)))

    @property
    def noise(self) -> Sequence[ColouredNoise]:
        """Noise of each channel, with its level."""
        return self.fixed or [channel.noise.scaled(channel.weight**-0.5) if channel.weight else channel.noise
                              for channel in self.system.channels]

    @property
    def rows(self) -> np.ndarray:
        """Rows from which the noise is computed ``(N, c)``: used, and no outliers."""
        return np.column_stack([channel.use for channel in self.system.channels])

    def about(self, problem: Problem) -> BestSet:
        """A copy of the best set, with its present noise, for the regression of another model.

        Args:
            problem: the regression of the other model; only coefficients are fitted again, without a search.
        """
        other = BestSet(problem, [], absorbed=self.absorbed, noise=self.noise)
        other.pool, other.learns, other.choices = self.pool, self.learns, list(self.choices)
        other._refresh()
        return other

    # Coefficients of a set, their uncertainty, and what they predict.

    def fit_of(self, choices: Sequence[Candidate]) -> Estimate:
        """Coefficients of a set fitted together with the model's parameters, without their uncertainty."""
        for candidate in choices:
            self.add(candidate)
        return self.problem.numbers(self.system, choices, uncertainty=False, more=self._precisions(choices))

    def estimate(self) -> Estimate:
        """Coefficients of the best set, fitted together with the model's parameters, with their uncertainty.

        The noise is that of the set's residual; shapes are linearised in the fit.
        """
        if self.fixed is None:
            fitted = self.system.posterior(self.keys)
            for _ in range(2):
                self.system.with_noise(self.system.residual(self.keys, fitted.mean))
                fitted = self.system.with_levels(self.keys)
        # A noise that is given is not reduced by a small residual of one recording.
        return self.problem.numbers(self.system, self.choices, inflate=self.fixed is not None,
                                    more=self._precisions(self.choices))

    def predicted_by_others(self, choices: Sequence[Candidate]) -> Array:
        """Residual of each row with a set fitted to all other blocks of time ``(N, c)``."""
        for candidate in choices:
            self.add(candidate)
        keys = ["W", *[c.key for c in choices]]
        products, precision = self.system.gram(keys), self.system.full_precision(keys, self._precisions(choices))
        total = products.sum(axis=0)
        means = np.array([posterior(total - own, precision).mean for own in products])
        return self.system.residual(keys, means[self.system.block_of_row])


def _apart(ours: Sequence[Candidate], theirs: Sequence[Candidate]) -> tuple[list[Candidate], ...]:
    """What two sets share, and what either has alone."""
    keys, other = {c.key for c in ours}, {c.key for c in theirs}
    return ([c for c in ours if c.key in other], [c for c in ours if c.key not in other],
            [c for c in theirs if c.key not in keys])


def _spread_of(own: Array, squares: float) -> Array:
    """Root of the prior covariance ``(m, m)`` with which columns of these products have ``squares`` on average."""
    values, vectors = np.linalg.eigh(0.5 * (own + own.T))
    # Directions that other columns reproduce up to rounding have no direction of their own.
    values = np.maximum(values, 1e-6 * max(float(values[-1]), 1e-290))
    return np.asarray(vectors * np.sqrt(max(squares, 0.0) / (len(own) * values)))


def _error_of(own: Array, known: Array, squares: float) -> Array:
    """Root of the covariance ``(m, m)`` of coefficients estimated from rows whose error has ``squares``.

    What the rows are off by is along no direction more than along another, and reaches the coefficients as noise does:
    by the estimator's gain, with covariance ``A⁻¹ B A⁻¹``, ``A = C'S⁻¹C``, ``B = C'S⁻²C``, for columns ``C`` beside
    noise and parameters with a prior, whose covariance is ``S`` in units of the noise.

    Args:
        own: ``A``.
        known: ``A - B``, what the parameters' prior says.
        squares: on average.
    """
    values, vectors = np.linalg.eigh(0.5 * (own + own.T))
    # Directions that other columns reproduce up to rounding have no direction of their own.
    values = np.maximum(values, 1e-6 * max(float(values[-1]), 1e-290))
    middle = vectors.T @ (own - known) @ vectors
    size, ways = np.linalg.eigh(0.5 * (middle + middle.T))
    root = (vectors / values) @ (ways * np.sqrt(np.maximum(size, 0.0)))
    return np.asarray(root * np.sqrt(max(squares, 0.0) / len(own)))


def _inverse(root: Array) -> Array:
    """Precision ``(m, m)`` of a covariance ``R R'`` of full rank."""
    inverse = np.linalg.inv(root)
    return np.asarray(inverse.T @ inverse)
