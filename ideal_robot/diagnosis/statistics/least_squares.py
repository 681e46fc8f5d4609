"""Weighted least squares on blocks of time, and how far one more group reduces the residual of blocks left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import linalg, stats

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import BlockProducts, Columns

_SMOOTH = 3e-3
"""Ridge for the pieces of a curve, relative to their mean size, as a fold hardly shows some. A body's ten columns are
in units of their own: next to what a mass weighs, an inertia shows little and would be held at none."""
ROUNDING = 1e-9
"""Size of a column over the largest, or share of its squares, below which it is rounding. As a ridge towards the model
as it is, relative to each column's squares, it decides what a fold leaves open. Its inverse, times what is known of
parameters, holds them while their changes are effects."""
TOLD = 2.0
"""Standard deviations from which on two things are told from each other, a number from none: 95 % of a normal
distribution. What takes away less than its square in weighted squares is not looked at closer."""
CLEAR = 3.0
"""The same where no more is claimed than what is beyond doubt, 99.7 %: a lag of all channels, a change of a model's
parameter (the recording that the model was made of bent its parameters no less than this one), a parameter or a torque
that refitting alone moves; and over the noise floor, an error."""
LEFT_OUT = 0.05
"""Weight of a fold in the fit that leaves it out. Working cycles go to some places and speeds once: what other folds
leave open would else be anything, and which of two candidates mends that says nothing of which is true."""


class Design:
    """Named groups of columns and their cross-products, each computed once."""

    def __init__(self, data: BlockProducts) -> None:
        self.data = data
        self.groups: dict[str, Columns] = {"W": data.W, "y": data.y}
        self._cross = {key: dict(products) for key, products in data.of_rows.items()}
        self._total: dict[str, dict[str, Array]] = {}
        self._gram: tuple[list[str], Array] = [], np.empty(0)

    def add(self, key: str, columns: Columns) -> None:
        """Adds or replaces a group."""
        self.forget_products(key)
        self.groups[key] = columns

    def drop(self, key: str) -> None:
        """Forgets a group."""
        self.forget_products(key)
        self.groups.pop(key, None)

    def forget_products(self, key: str) -> None:
        """Forgets the cross-products of a group that is hardly asked for again; they are made anew where it is."""
        self._total.pop(key, None)
        for other in self._cross.pop(key, {}):
            for products in (self._cross, self._total):
                products.get(other, {}).pop(key, None)
        if key in self._gram[0]:
            self._gram = [], np.empty(0)

    def cross(self, a: str, b: str) -> Array:
        """``a' b`` for each block and channel ``(B, c, m_a, m_b)``."""
        known = self._cross.setdefault(a, {})
        if b not in known:
            known[b] = self.data.cross(self.groups[a], self.groups[b])
            if a != b:
                self._cross.setdefault(b, {})[a] = np.swapaxes(known[b], 2, 3)
        return known[b]

    def total(self, a: str, b: str) -> Array:
        """``a' b`` of all selecting blocks together, for each channel ``(c, m_a, m_b)``."""
        known = self._total.setdefault(a, {})
        if b not in known:
            products = self.cross(a, b)
            known[b] = (self.data.blocks.selecting @ products.reshape(len(products), -1)).reshape(products.shape[1:])
        return known[b]

    def gram(self, keys: list[str]) -> Array:
        """Cross-products of several groups side by side with each other ``(B, c, m, m)``."""
        if self._gram[0] != keys:
            ends = np.cumsum([0, *(self.groups[key].m for key in keys)])
            places = [slice(a, b) for a, b in pairwise(ends)]
            products = np.empty((self.data.blocks.count, self.data.c, ends[-1], ends[-1]))
            for a, left in zip(keys, places, strict=True):
                for b, right in zip(keys, places, strict=True):
                    products[:, :, left, right] = self.cross(a, b)
            self._gram = keys, products
        return self._gram[1]


@dataclass(frozen=True)
class HeldOutTest:
    """How much a candidate reduces the residual.

    Attributes:
        gain: weighted squares it takes away in sample, after everything else is refitted.
        coefficients: its coefficients on all selecting blocks ``(m,)``.
        reduction: weighted squares taken away from each block left out of the fit ``(B,)``; nan where none was tried.
        reduction_by_channel: their sum for each channel ``(c,)``.
        p_value: one-sided, of the alignment of what it predicts with the residual of blocks it has not seen.
    """

    gain: float = 0.0
    coefficients: Array = field(default_factory=lambda: np.zeros(0))
    reduction: Array = field(default_factory=lambda: np.zeros(0))
    reduction_by_channel: Array = field(default_factory=lambda: np.zeros(0))
    p_value: float = 1.0

    @property
    def total(self) -> float:
        """Reduction of the weighted squares over all held-out folds."""
        return float(np.nansum(self.reduction))


class Fit:
    """Least squares of ``y`` on the groups ``keys`` over the selecting blocks, with one refit for each fold left out.

    Args:
        design: groups and cross-products.
        keys: the groups that are fitted, ``W`` first.
        weights: 1/σ² of each channel ``(c,)``.
        prior: precision of the parameters ``(P,)`` about zero, in the same weighted units; padded with zeros.
    """

    def __init__(self, design: Design, keys: list[str], weights: Array, prior: Array | None = None) -> None:
        self.design, self.keys, self.weights = design, keys, weights
        blocks = design.data.blocks
        self.fold, self.folds = blocks.fold, blocks.folds
        self.G = design.gram([*keys, "y"])
        self.P = self.G.shape[2] - 1
        self._weighted = np.einsum("c,bcij->bij", weights, self.G)
        precision = np.zeros((self.P, self.P))
        if prior is not None:
            q = len(prior)
            precision[:q, :q] = prior if prior.ndim == 2 else np.diag(prior)
        self._precision = precision
        self._training = np.array([np.where(self.fold == k, LEFT_OUT, 1.0) * (self.fold >= 0)
                                   for k in range(-1, self.folds)])
        self.inverse, self.beta = self._solved(self._training[0])

    def _solved(self, training: Array) -> tuple[Array, Array]:
        """Inverse of the normal equations' matrix ``(P, P)`` and parameters ``(P,)``; blocks are weighted ``(B,)``."""
        H = np.tensordot(training, self._weighted, 1)
        A = H[: self.P, : self.P] + self._precision
        A = A + ROUNDING * np.diag(np.maximum(np.diag(A), 1e-12 * (np.max(np.diag(A)) + 1e-300)))
        # Zero throughout where no sample is left to train on: nothing is known then, and nothing found.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
        inverse = _inverse(A * np.outer(scale, scale)) * np.outer(scale, scale)
        return inverse, inverse @ H[: self.P, self.P]

    @cached_property
    def _solutions(self) -> list[tuple[Array, Array]]:
        """Inverse and parameters on all selecting blocks, then without each fold."""
        return [(self.inverse, self.beta), *(self._solved(row) for row in self._training[1:])]

    @property
    def betas(self) -> Array:
        """Parameters fitted on all selecting blocks, then without each fold ``(1 + folds, P)``."""
        return np.array([beta for _, beta in self._solutions])

    def squares(self, beta: Array | None = None) -> Array:
        """Squares of the residual per block and channel ``(B, c)``, unweighted."""
        v = np.append(-(self.beta if beta is None else beta), 1.0)
        return np.maximum(_quadratic(self.G, v), 0.0)

    @cached_property
    def held_out_squares(self) -> Array:
        """As ``squares``, each block predicted by the fit without its fold; report blocks by the fit on all others."""
        result = self.squares()
        for k in range(self.folds):
            mine = self.fold == k
            result[mine] = np.maximum(_quadratic(self.G[mine], np.append(-self._solutions[k + 1][1], 1.0)), 0.0)
        return result

    @cached_property
    def _left_out(self) -> list[tuple[np.ndarray, Array, Array, Array, Array]]:
        """For each fold its blocks, their cross-products ``G`` summed over the weighted channels, and over the blocks.

        With each ``G v``, where ``v = [-beta, 1]`` of the fit without the fold.
        """
        made = []
        for k in range(self.folds):
            mine, v = self.fold == k, np.append(-self._solutions[k + 1][1], 1.0)
            blocks, sums = self._weighted[mine], self.G[mine].sum(axis=0)
            made.append((mine, blocks, blocks @ v, sums, sums @ v))
        return made

    def refitted_weights(self) -> Array:
        """1/σ² of each channel from the squares that this fit leaves ``(c,)``; zero for an empty channel."""
        return _inverse_variance(self.squares(), self.design.data.count)

    def covariance(self) -> Array:
        """Covariance of ``beta (P, P)`` from the scatter of the blocks' scores, so that coloured noise counts."""
        selecting = self.fold >= 0
        v = np.append(-self.beta, 1.0)
        scores = self._weighted[selecting][:, : self.P] @ v
        B = len(scores)
        middle = scores.T @ scores * (B / max(B - 1, 1))
        bread = self.inverse
        # Few blocks cannot fill a large matrix; the model-based covariance is the floor.
        dof = max(float(self.design.data.count[selecting].sum()) - self.P, 1.0)
        plain = bread * float(np.sum(self.squares()[selecting] * self.weights)) / dof
        robust = bread @ middle @ bread
        inflation = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(plain), 1e-300), 1.0))
        return plain * np.outer(inflation, inflation)

    def misfit_variance(self, noise: Array) -> Array:
        """Variance of ``beta (P,)`` from what the residual holds beyond noise ``(c,)``.

        What a model class leaves follows the motion: it averages out over stretches of motion, not over samples, and
        where stretches are alike their scatter does not show it.
        """
        estimating = self.fold >= 0
        count = self.design.data.count[estimating].sum(axis=0)
        mean = self.squares()[estimating].sum(axis=0) / np.maximum(count, 1.0)
        share = np.maximum(1.0 - noise**2 / np.maximum(mean, 1e-300), 0.0) * count / max(float(estimating.sum()), 1.0)
        middle = np.einsum("c,bcij->ij", self.weights * share, self.G[estimating][:, :, : self.P, : self.P])
        return np.asarray(np.einsum("ij,jk,ik->i", self.inverse, middle, self.inverse))

    @property
    def inflation(self) -> float:
        """Ratio of the parameters' scatter over blocks to that of white noise, one at least: samples are coloured."""
        return max(float(np.median(np.diag(self.covariance()) / np.maximum(np.diag(self.inverse), 1e-300))), 1.0)

    def p_value(self, key: str) -> float:
        """Of one more group that the prior may absorb, by the likelihood ratio in sample."""
        gain, coefficients = self.gain(key)
        return float(stats.chi2.sf(gain / self.inflation, len(coefficients)))

    def share_with_prior(self, key: str) -> float:
        """Share that one more group takes away, in sample, of the squares of the residual and of the prior together.

        What is known of parameters is a measurement like others: a fit that moves them far leaves squares there.
        """
        left = float((self.squares()[self.fold >= 0] * self.weights).sum())
        left += float(self.beta @ self._precision @ self.beta)
        return self.gain(key)[0] / max(left, 1e-300)

    def gain(self, key: str) -> tuple[float, Array]:
        """In-sample gain and coefficients of one more group."""
        group = self.design.groups[key]
        channels, total = list(group.channels), self.design.total
        CX = np.concatenate([total(key, other)[channels] for other in self.keys], axis=2)
        parts = (np.tensordot(self.weights[channels], part, 1)
                 for part in (CX, total(key, "y")[channels], total(key, key)[channels]))
        return self._joined(0, tuple(parts), group)[:2]

    def held_out_test(self, key: str) -> HeldOutTest:
        """Held-out gain of one more group, everything refitted without each fold in turn."""
        group = self.design.groups[key]
        channels, B = list(group.channels), len(self.fold)
        # Outside its channels a candidate is zero; most have one of many.
        of_channels = [np.concatenate([self.design.cross(key, other)[:, channels] for other in self.keys], axis=3),
                       self.design.cross(key, "y")[:, channels], self.design.cross(key, key)[:, channels]]
        of_blocks = [np.einsum("c,bcij->bij", self.weights[channels], part) for part in of_channels]
        folds = [np.tensordot(self._training, part, 1) for part in of_blocks]
        gain, coefficients = self._joined(0, tuple(part[0] for part in folds), group)[:2]
        reduction, score, left = np.full(B, np.nan), np.full(B, np.nan), np.full(B, np.nan)
        by_channel = np.zeros(len(self.weights))
        for k, (mine, blocks, before, sums, summed) in enumerate(self._left_out):
            _, gamma, beta = self._joined(k + 1, tuple(part[k + 1] for part in folds), group)
            # after = [-beta, 1] holds the sign of the subtraction: y - X beta - C gamma.
            after, step = np.append(-beta, 1.0), np.append(beta - self._solutions[k + 1][1], 0.0)
            own, moved = [part[mine] for part in of_blocks], blocks @ step
            fewer = (2.0 * before - moved) @ step - _added(own, after, gamma)
            size = moved @ step + _added(own, step, -gamma)
            reduction[mine] = fewer
            # With d the change of the prediction: d'r before and d'(r - d) after, r being the held-out residual.
            score[mine], left[mine] = (fewer + size) / 2.0, (fewer - size) / 2.0
            by_channel += self.weights * ((2.0 * summed - sums @ step) @ step)
            by_channel[channels] -= self.weights[channels] * _added([part[mine].sum(axis=0) for part in of_channels],
                                                                    after, gamma)
        return HeldOutTest(gain, coefficients, reduction, by_channel, _one_sided(score, left))

    def _joined(self, k: int, products: tuple[Array, ...], group: Columns) -> tuple[float, Array, Array]:
        """Schur complement: gain, coefficients of the group, and the refitted other parameters.

        Args:
            k: 0 for the fit to all blocks, then the fold that is left out, from 1.
            products: of the group with the groups fitted, ``y`` and itself, weighted and summed over the blocks of k.
            group: that joins.
        """
        CX, Cy, CC = products[0], products[1][:, 0], products[2]
        inverse, present = self._solutions[k] if k else (self.inverse, self.beta)
        Z = CX @ inverse
        S = CC - Z @ CX.T
        part = 1.0 if group.own is None else group.own
        # A column that the others explain all but what is rounding of has nothing of its own. What of it is of the form
        # of the model's own parameters does not count.
        size = CC.diagonal()
        own = (S.diagonal() > ROUNDING * part * size) & (size > ROUNDING**2 * np.max(size, initial=0.0))
        if group.alike and len(Cy) > 6:
            S = S + _SMOOTH * float(np.mean(size)) * np.eye(len(Cy))
        m = len(Cy)
        gamma = np.zeros(m)
        right = Cy - CX @ present
        if own.any():
            index = np.flatnonzero(own)
            scale = 1.0 / np.sqrt(S.diagonal()[index])
            inner = S[np.ix_(index, index)] * np.outer(scale, scale)
            # Most candidates have one column, which is scaled to one.
            inverse = linalg.pinvh(inner, rtol=1e-6) if len(index) > 1 else 1.0 / inner
            gamma[index] = scale * (inverse @ (scale * right[index]))
        return float(right @ gamma), gamma, present - Z.T @ gamma


def _inverse(A: Array) -> Array:
    """Inverse of normal equations scaled to a diagonal of one; of singular ones the pseudo-inverse.

    Cholesky's is several times faster. It fails where eigenvalues are lost in rounding; the ridge keeps others away
    from what a pseudo-inverse takes for zero.
    """
    factor, failed = linalg.lapack.dpotrf(A, lower=1)
    if not failed and np.min(np.diag(factor)) > 1e-6:
        lower, failed = linalg.lapack.dpotri(factor, lower=1)
        if not failed:
            lower = np.tril(lower)
            return np.asarray(lower + np.tril(lower, -1).T)
    return np.asarray(linalg.pinvh(A, atol=1e-12, rtol=1e-11))


def _quadratic(G: Array, v: Array) -> Array:
    """``v' G v`` for stacked matrices ``(…, m, m)``."""
    return np.asarray((G @ v) @ v)


def _added(products: Sequence[Array], v: Array, gamma: Array) -> Array:
    """What ``- C gamma`` adds to the squares of ``[X, y] v``, from the stacked products of C with X, y and itself."""
    CX, Cy, CC = products
    across = CX @ v[:-1] + Cy[..., 0] * v[-1]
    return np.asarray(_quadratic(CC, gamma) - 2.0 * across @ gamma)


def _one_sided(score: Array, left: Array) -> float:
    """p-value of a positive sum of ``score`` over blocks, by Student's t.

    The scatter is that of ``left``, the same products with the residual that remains, so that an effect that shows in
    few blocks only is not taken for scatter; under the null hypothesis the two scatter alike, coloured noise included.
    """
    values, rest = score[np.isfinite(score)], left[np.isfinite(score)]
    B = len(values)
    spread = float(np.sqrt(np.sum((rest - rest.mean()) ** 2) * B / max(B - 1, 1)))
    if B < 4 or spread == 0.0:
        return 1.0
    return float(stats.t.sf(float(values.sum()) / spread, B - 1))


def weights_of_channels(design: Design, keys: list[str], prior: Array | None, rounds: int = 2) -> Array:
    """1/σ² of each channel ``(c,)`` from the residual of a fit, found by refitting.

    The first weights are those that the model's own parameters leave, so that no channel's misfit weighs on another.

    Args:
        design: groups and cross-products.
        keys: the groups of the fit, ``W`` first.
        prior: precision of the parameters ``(P, P)``, or None.
        rounds: refits with ``keys``; after two the weights have settled.
    """
    weights = Fit(design, ["W"], np.ones(design.data.c), prior).refitted_weights()
    for _ in range(rounds):
        weights = Fit(design, keys, weights, prior).refitted_weights()
    return weights


def _inverse_variance(squares: Array, count: Array) -> Array:
    """1/σ² of each channel from squares ``(B, c)`` over as many samples ``(B, c)``; zero for an empty channel."""
    total, number = squares.sum(axis=0), count.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where((number > 0) & (total > 0), number / np.maximum(total, 1e-300), 0.0)
    return np.asarray(weights)
