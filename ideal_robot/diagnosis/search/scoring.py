"""How candidates are judged: scored on time blocks left out, refined over theta, compared with their rivals."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import optimize

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import Columns
from ideal_robot.diagnosis.channels.regression import spread
from ideal_robot.diagnosis.search.choice import FINALISTS, NEARLY, Options, PresentModel
from ideal_robot.diagnosis.statistics.dependence import DependenceTest, terms, time_period
from ideal_robot.diagnosis.statistics.least_squares import TOLD, Fit, standard_errors
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem
from ideal_robot.effects import TCP_POSITION
from ideal_robot.effects.base import Theta
from ideal_robot.effects.drive import DeadTime
from ideal_robot.effects.kinematics import GeometryChange
from ideal_robot.errors import RaisedBy


class Scoring:
    """Judges candidates against the present model.

    Args:
        model: the present model.
        options: thresholds.
    """

    def __init__(self, model: PresentModel, options: Options) -> None:
        self.model, self.options = model, options
        self.signals = model.problem.regression.signals
        self.at_rows = model.problem.regression.decimated_signals()
        measured, use = model.problem.regression.measured, model.problem.products.use
        self.measured_std = np.maximum(spread(measured, use), 1e-150)

    def plausible_gain(self, fit: Fit, candidate: Candidate) -> float | None:
        """Weighted squares that a candidate takes away in sample; None where its coefficients are not plausible."""
        self.model.add_columns(candidate)
        gain, coefficients = fit.gain(candidate.key)
        return gain if self._plausible(candidate, coefficients) else None

    def _plausible(self, candidate: Candidate, coefficients: Array) -> bool:
        return bool(np.any(coefficients)) and candidate.effect.plausible(coefficients, candidate.theta, self.signals,
                                                                         candidate.joint)

    def tested(self, fit: Fit, candidate: Candidate) -> Candidate:
        """A candidate, whose columns are part of the design, with its test on blocks left out by a fit without it."""
        test = fit.held_out_test(candidate.key)
        selecting = self.model.problem.blocks.selecting
        squares = (fit.held_out_squares[selecting] * self.model.weights).sum(axis=0)
        share = float(np.max(test.reduction_by_channel / np.maximum(squares, 1e-300)))
        return replace(candidate, p_value=min(1.0, test.p_value * candidate.tries), share=share, test=test)

    def smallest_share(self, candidate: Candidate, own: Candidate | None = None) -> float:
        """Share of the residual's squares that is asked of a candidate; ``own`` is its choice if it was taken."""
        if candidate.effect.learned:
            occupied = any(c.joint == candidate.joint for c in self.model.choices if c is not own)
            return self.options.smallest_learned * (2.0 if occupied else 1.0)
        # The only joint of an arm has its clock for itself.
        caution = candidate.effect.caution if self.signals.n > 1 else 1.0
        return caution * self.options.smallest

    def is_large(self, s: Candidate, replaced: Candidate | None = None) -> bool:
        """Whether a candidate reduces enough, in a choice's place if ``replaced``, in all of the band or slowly."""
        return self._is_large_here(s, replaced) or self.share_slowly(s, replaced) > 0.0

    def share_slowly(self, s: Candidate, replaced: Candidate | None = None) -> float:
        """Share that a law of speed takes away in the lower half of the band; zero where that is not enough there.

        Another cause sets elastic arms swinging, and that may be most of what a joint's residual is. Friction over
        speed has next to nothing at those frequencies, so they say nothing of how much it explains.
        """
        if not s.effect.of_slow_motion or self.model.problem.band < 1.0 \
                or s.p_value > self.options.learned_discovery:
            return 0.0
        slow, choices = self._in_slow_band, self.model.choices
        prior = self.model.problem.prior
        if prior is not None and slow.model.problem.prior is not prior:
            slow.model.with_prior(prior)
        if slow.model.choices != choices:
            slow.model.replace(list(choices))
        fit = slow.model.fit(*[c for c in choices if c.place == s.place or c is replaced])
        if slow.plausible_gain(fit, s) is None:
            return 0.0
        tested = slow.tested(fit, s)
        certain = tested.p_value < self.options.learned_discovery
        return tested.share if certain and slow._is_large_here(tested, replaced) else 0.0

    @cached_property
    def _in_slow_band(self) -> Scoring:
        # A cause that is looked for a second time has to be as large as a curve.
        return Scoring(PresentModel(self.model.problem.slow()),
                       replace(self.options, smallest=self.options.smallest_learned))

    def share_asked(self, s: Candidate, own: Candidate | None = None) -> float:
        """Share of the whole band's squares that is asked of a large candidate; ``own`` is its choice if taken."""
        least, slowly = self.smallest_share(s, own), 0.0
        if s.share < least:
            slowly = self.share_slowly(s, own)
        # Vibrations may hide a slow effect. It is measured in the lower half of the band, and the share that is asked
        # for there is scaled to the whole band.
        return least if slowly == 0.0 else s.share * self._in_slow_band.smallest_share(s, own) / slowly

    def _is_large_here(self, s: Candidate, replaced: Candidate | None) -> bool:
        """Whether a candidate reduces enough, and is no combination that the other parameters nearly cancel."""
        if s.share < self.smallest_share(s, replaced):
            return False
        columns = self.model.design.groups[s.key]
        channels = list(columns.channels)
        own = columns.values @ s.test.coefficients
        # What the other parameters cancel almost wholly is no cause but a way of bending a curve; of columns that are
        # parameters of the model by their form nothing else is expected.
        form = self.model.problem.form_of_model(s)
        if form is not None and form.channels == columns.channels:
            own = Columns(own[:, :, None], columns.channels).without(form)[:, :, 0]
        weighted = float(((own**2).sum(axis=0) * self.model.weights[channels]).sum())
        if s.test.gain < self.options.smallest_own * weighted:
            return False
        # What counts is what it takes away, not what the other parameters would have taken as well.
        problem = self.model.problem
        squares = self.model.weights * problem.products.count[problem.blocks.selecting].sum(axis=0)
        size = np.sqrt(np.maximum(s.test.reduction_by_channel, 0.0) / np.maximum(squares, 1e-300))[channels]
        if np.max(size / self.measured_std[channels]) <= self.options.smallest_torque:
            return False
        # Beside a far larger effect of the same joint it is the form of that one, which is never quite the right one.
        return bool(np.any(size > self.options.smallest_beside * self._sizes_at(s.joint, replaced)[channels]))

    def holds_everywhere(self, fit: Fit, s: Candidate) -> bool:
        """Whether what repeats over the angle is in all parts of the range, half as large as in the whole at least.

        Parts hold a period or more, and are no more than the parts of the time that are left out in turn. An odd shape
        at one place, or what a curve leaves of it, has a spectrum over the angle as well, but no torque elsewhere.
        ``fit`` is without the candidate.
        """
        if not s.effect.scanned:
            return True
        group = self.model.design.groups[s.key]
        fit = Fit(self.model.design, [*fit.keys, s.key], self.model.weights, self.model.problem.prior)
        channels, blocks = list(group.channels), self.model.problem.blocks
        use = self.model.problem.products.use[:, channels] & blocks.selecting_samples[:, None]
        wave = group.values @ fit.beta[-group.m :] * use
        residual = self.model.residual(fit)[:, channels] * use
        rows = np.flatnonzero(use.any(axis=1))
        q = self.at_rows.q[rows, s.joint - 1]
        parts = int(np.clip(s.effect.periods(self.signals, s.joint, s.theta), 1, blocks.folds))
        return all(np.sum(residual[part] * wave[part]) > -0.5 * np.sum(wave[part] ** 2)
                   for part in np.array_split(rows[np.argsort(q)], parts))

    def holds_slowly(self, s: Candidate) -> bool:
        """Whether a cause that is the same at all frequencies is so: no less than half as large in half of the band.

        Vibrations of elastic arms turn phases as well, but ever less the slower the motion.
        """
        if not s.effect.at_all_frequencies:
            return True
        problem = self.model.problem
        effects = [*(c for c in self.model.choices if c.place != s.place), s]
        whole, slow = (variant.fit(effects).coefficients[-1] for variant in (problem, problem.slow()))
        return bool(np.all(slow * np.sign(whole) > 0.5 * np.abs(whole)))

    def _sizes_at(self, joint: int, without: Candidate | None) -> Array:
        """RMS of the largest effect but one that was taken at a joint in each channel ``(c,)``."""
        result = np.zeros(self.model.problem.products.c)
        fit = self.model.fit()
        _, *own = self.model.parts(fit)
        for choice, (group, place) in zip(self.model.choices, own, strict=True):
            if choice.joint == joint and choice is not without:
                channels = list(group.channels)
                size = np.sqrt(np.mean((group.values @ fit.beta[place]) ** 2, axis=0))
                result[channels] = np.maximum(result[channels], size)
        return result

    def refined(self, fit: Fit, s: Candidate) -> Candidate:
        """Theta by bounded search from the best start, all linear parameters eliminated; ``fit`` is without it."""
        if not s.effect.theta_is_physical:
            return self._made_consistent(fit, s)
        bounds, present = s.effect.bounds_near(self.signals, s.joint, s.theta), self.model.keys()
        if not bounds:
            return s

        def at(theta: Array | float) -> Candidate:
            return replace(s, theta=tuple(np.atleast_1d(theta).tolist()))

        def loss(theta: Array | float) -> float:
            candidate = at(theta)
            gain = self.plausible_gain(fit, candidate)
            if candidate.key != s.key and candidate.key not in present:
                self.model.design.drop(candidate.key)
            return -gain if gain is not None else 0.0

        if len(bounds) == 1:
            (low, high), = bounds
            optimum = optimize.minimize_scalar(loss, bounds=(low, high), method="bounded",
                                               options={"maxiter": 14, "xatol": 1e-3 * (high - low)})
        else:
            optimum = optimize.minimize(loss, np.array(s.theta), method="Nelder-Mead", bounds=bounds,
                                        options={"maxfev": 40, "xatol": 1e-3, "fatol": 1e-2})
        better = at(optimum.x)
        if self.plausible_gain(fit, better) is None:
            return s
        tried = self.tested(fit, better)
        # None of a theta is the law without it, which stays unless the data tell.
        threshold = TOLD if s.theta == (0.0,) else 0.0
        return tried if standard_errors(tried.test.reduction - s.test.reduction) > threshold else s

    def _made_consistent(self, fit: Fit, s: Candidate) -> Candidate:
        """Theta that agrees with the coefficients."""
        def coefficients(theta: Theta) -> Array | None:
            candidate = replace(s, theta=theta)
            self.model.add_columns(candidate)
            own = fit.gain(candidate.key)[1]
            return own if self._plausible(candidate, own) else None

        better = replace(s, theta=s.effect.settled(coefficients, s.theta))
        return s if better.theta == s.theta else self.tested(fit, better)

    def scored(self, fit: Fit, pool: list[list[Candidate]]) -> list[Candidate]:
        """The best of the starts of every effect at every joint, tested on blocks left out by a fit without it."""
        residual, scored = self.model.residual(fit), []
        chosen = [c for c in self.model.choices if c.key in fit.keys]
        for starts in pool:
            first = starts[0]
            if not first.effect.scanned and any(_forms_of_one(first, other) for other in chosen):
                continue
            with RaisedBy(f"effect {first.effect.key} at joint {first.joint}"):
                if first.effect.scanned:
                    thetas, tries = first.effect.starts_from_residual(self.at_rows, first.joint, residual,
                                                                      self.model.problem.products.use)
                    starts = [replace(first, theta=theta, tries=tries) for theta in thetas]
                best = self._best_start(fit, starts)
                if best is not None:
                    scored.append(self.tested(fit, best))
        return scored

    def _best_start(self, fit: Fit, starts: list[Candidate]) -> Candidate | None:
        """The plausible one that takes most away in sample; None if that is hardly anything."""
        if not starts:
            return None
        key = self.model.add_starts(starts)
        gains, coefficients = fit.gains(key, len(starts))
        # Of all starts the products are kept, which every round asks for; rows block by block are as large as columns.
        self.model.design.groups[key].in_blocks.clear()
        for i in np.argsort(-gains, kind="stable"):
            if gains[i] <= TOLD**2:
                break
            if self._plausible(starts[i], coefficients[i]):
                if starts[i].key not in self.model.design.groups:
                    self.model.design.add(starts[i].key, self.model.design.groups[key].part(int(i), len(starts)))
                return starts[i]
        return None


    def best_curve(self, fit: Fit, best: Candidate | None) -> Candidate | None:
        """A curve that reduces what a fit leaves clearly more than the best effect of the library of this round."""
        least = 0.0 if best is None else self.options.unknown_margin * best.test.total
        problem, residual = self.model.problem, self.model.residual(fit)
        scored = [s for j in range(problem.products.c)
                  if j + 1 not in problem.regression.undecided or problem.regression.domain == TCP_POSITION
                  for s in self.curves_in(fit, residual, j, best is None, least)]
        chosen = {c.key for c in self.model.choices}
        scored = [s for s in scored if s.p_value < self.options.learned_discovery and s.test.total > least
                  and s.key not in chosen and self.is_large(s)]
        curve = max(scored, key=lambda s: s.test.total, default=None)
        return None if curve is None else replace(curve, asked=self.smallest_share(curve))

    def curves_over_angle(self, fit: Fit, joint: int) -> list[Candidate]:
        """The curve over a joint's own angle, from 1, tested; none where the joint hardly moves."""
        curves = [Candidate(term, joint) for term in terms(self.at_rows, joint - 1, False)
                  if term.depends_on == (f"q_{joint}",) and not term.directed]
        for curve in curves:
            self.model.add_columns(curve)
        return [self.tested(fit, curve) for curve in curves]

    def curves_in(self, fit: Fit, residual: Array, j: int, pairs: bool = False, least: float = 0.0) -> list[Candidate]:
        """Curves of one channel tested on blocks left out, whether they are large or not.

        Args:
            fit, residual: without them, and what it leaves ``(N, c)``.
            j, pairs: channel, from 0, and whether curves over two signals are looked at as well.
            least: what they have to take away to be promising.
        """
        domain, use = self.model.problem.regression.domain, self._dependence.use[:, j]
        squares = float(np.sum(residual[use, j] ** 2) * self.model.weights[j])
        period = time_period(residual[:, j], use, self.at_rows.t, domain)
        curves = [*terms(self.at_rows, j, pairs, domain), *([] if period is None else [period])]
        # By the share explained of what would not be by chance: many curves follow a residual that is in few places.
        tests = sorted(self._dependence.tests(residual[:, j], j, curves),
                       key=lambda d: (d.expected - d.share) / max(1.0 - d.expected, 1e-12))
        # Only a first choice: what is promising is tested on blocks left out, corrected for all curves looked at.
        promising = [d for d in tests if d.p_value < 0.05 and 3.0 * d.share * squares > least]
        scored = []
        for d in promising[:FINALISTS]:
            candidate = Candidate(d.term, j + 1, (), len(tests) * self.model.problem.products.c)
            self.model.add_columns(candidate)
            scored.append(self.tested(fit, candidate))
            # A curve has many columns, and every round has other curves.
            self.model.design.forget_products(candidate.key)
        return scored

    @cached_property
    def _dependence(self) -> DependenceTest:
        problem = self.model.problem
        return DependenceTest(self.at_rows, problem.products.use & problem.blocks.selecting_samples[:, None],
                              problem.blocks)


def _forms_of_one(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates are forms of one cause at one joint, of which it has one at most: it is late once."""
    late = isinstance(a.effect, DeadTime) and isinstance(b.effect, DeadTime)
    return a.joint == b.joint and (a.effect.name == b.effect.name or late)


def with_equivalents(problem: Problem, choices: list[Candidate]) -> list[Candidate]:
    """The choices with what other joints' geometry could do as well: links of parallel axes are one length."""
    if not any(isinstance(choice.effect, GeometryChange) for choice in choices):
        return choices
    regression, estimate, result = problem.regression, problem.fit(choices), []
    for choice, coefficients in zip(choices, estimate.coefficients, strict=True):
        effect, joint, theta = choice.effect, choice.joint, choice.theta
        more: list[tuple[str, int, float]] = []
        if isinstance(effect, GeometryChange):
            own = (regression.columns_of(effect, joint, theta) @ coefficients).reshape(-1)
            W = regression.W.reshape(len(own), -1)
            alone = float(np.sum(_without(W, own) ** 2))
            for other in effect.joints(regression.signals):
                if other != joint and effect.usable(regression.signals, other):
                    theirs = regression.columns_of(effect, other, theta).reshape(len(own), -1)
                    remaining = float(np.sum(_without(np.column_stack([W, theirs]), own) ** 2))
                    if remaining < (1.0 - NEARLY) * alone:
                        more.append((f"{effect.name} of joint {other}", other, 1.0 - remaining / alone))
        result.append(replace(choice, rivals=choice.rivals + tuple(more)))
    return result


def _without(columns: Array, values: Array) -> Array:
    """What of values ``(N,)`` the columns ``(N, m)`` cannot make."""
    size = np.linalg.norm(columns, axis=0) + 1e-300
    return np.asarray(values - columns / size @ np.linalg.lstsq(columns / size, values, rcond=1e-9)[0])
