"""Weighted least squares on blocks of time, and how far one more group reduces the residual of blocks left out."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import linalg, special

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import Columns, Design, quadratic, times

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
that refitting alone moves; and over the noise floor, an error. A pair of causes that a motion tells so many times over
need not be told better, and at so many widths of its change of sign dry friction has all but half a percent of its
size."""
LEFT_OUT = 0.05
"""Weight of a fold in the fit that leaves it out. Working cycles go to some places and speeds once: what other folds
leave open would else be anything, and which of two candidates mends that says nothing of which is true."""


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
        blocks = design.blocks
        self.fold, self.folds = blocks.fold, blocks.folds
        self.G = design.gram(keys)
        self.P = self.G.size - 1
        precision = np.zeros((self.P, self.P))
        if prior is not None:
            q = len(prior)
            precision[:q, :q] = prior if prior.ndim == 2 else np.diag(prior)
        self._precision = precision
        self._training = np.array([np.where(self.fold == k, LEFT_OUT, 1.0) * (self.fold >= 0)
                                   for k in range(-1, self.folds)])
        self.inverse, self.beta = self._solved(self.G.summed(weights, self._training[0]))

    def _solved(self, H: Array) -> tuple[Array, Array]:
        """Inverse of the normal equations' matrix ``(P, P)`` and parameters ``(P,)`` from all products with ``y``."""
        A = H[: self.P, : self.P] + self._precision
        A = A + ROUNDING * np.diag(np.maximum(np.diag(A), 1e-12 * (np.max(np.diag(A)) + 1e-300)))
        # Zero throughout where no sample is left to train on: nothing is known then, and nothing found.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
        inverse = _inverse(A * np.outer(scale, scale)) * np.outer(scale, scale)
        return inverse, inverse @ H[: self.P, self.P]

    @cached_property
    def _solutions(self) -> tuple[Array, Array]:
        """Inverses ``(1 + folds, P, P)`` and parameters ``(1 + folds, P)`` on all selecting blocks and without each."""
        solved = [(self.inverse, self.beta), *map(self._solved, self.G.summed(self.weights, self._training[1:]))]
        return np.array([inverse for inverse, _ in solved]), np.array([beta for _, beta in solved])

    @property
    def betas(self) -> Array:
        """Parameters fitted on all selecting blocks, then without each fold ``(1 + folds, P)``."""
        return self._solutions[1]

    def squares(self) -> Array:
        """Squares of the residual per block and channel ``(B, c)``, unweighted."""
        return self.G.squares(np.append(-self.beta, 1.0))

    @cached_property
    def _left_out(self) -> Array:
        """``[-beta, 1]`` of the fit without each block's fold; of report blocks of the fit to all others ``(B, m)``."""
        return np.column_stack([-self.betas, np.ones(1 + self.folds)])[1 + self.fold]

    @cached_property
    def held_out_squares(self) -> Array:
        """As ``squares``, each block predicted by the fit without its fold; report blocks by the fit on all others."""
        return self.G.squares(self._left_out)

    @cached_property
    def _along(self) -> list[Array]:
        """Products of each channel's columns with the residuals left out ``(B, k)``."""
        return [times(G, self._left_out[:, index]) for index, G in self.G.parts]

    def refitted_weights(self) -> Array:
        """1/σ² of each channel from the squares that this fit leaves ``(c,)``; zero for an empty channel."""
        total, number = self.squares().sum(axis=0), self.design.count.sum(axis=0)
        return np.where((number > 0) & (total > 0), number / np.maximum(total, 1e-300), 0.0)

    def covariance(self) -> Array:
        """Covariance of ``beta (P, P)`` from the scatter of the blocks' scores, so that coloured noise counts."""
        selecting, v = self.fold >= 0, np.append(-self.beta, 1.0)
        scores = np.zeros((int(selecting.sum()), self.P + 1))
        for weight, (index, G) in zip(self.weights, self.G.parts, strict=True):
            scores[:, index] += weight * times(G[selecting], v[index])
        scores = scores[:, : self.P]
        B = len(scores)
        middle = scores.T @ scores * (B / max(B - 1, 1))
        bread = self.inverse
        # Few blocks cannot fill a large matrix; the model-based covariance is the floor.
        dof = max(float(self.design.count[selecting].sum()) - self.P, 1.0)
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
        count = self.design.count[estimating].sum(axis=0)
        mean = self.squares()[estimating].sum(axis=0) / np.maximum(count, 1.0)
        share = np.maximum(1.0 - noise**2 / np.maximum(mean, 1e-300), 0.0) * count / max(float(estimating.sum()), 1.0)
        middle = self.G.summed(self.weights * share, estimating.astype(float))[: self.P, : self.P]
        return np.asarray(np.einsum("ij,jk,ik->i", self.inverse, middle, self.inverse))

    @property
    def inflation(self) -> float:
        """Ratio of the parameters' scatter over blocks to that of white noise, one at least: samples are coloured."""
        return max(float(np.median(np.diag(self.covariance()) / np.maximum(np.diag(self.inverse), 1e-300))), 1.0)

    def p_value(self, key: str) -> float:
        """Of one more group that the prior may absorb, by the likelihood ratio in sample."""
        gain, coefficients = self.gain(key)
        return float(special.chdtrc(len(coefficients), gain / self.inflation))

    def share_with_prior(self, key: str) -> float:
        """Share that one more group takes away, in sample, of the squares of the residual and of the prior together.

        What is known of parameters is a measurement like others: a fit that moves them far leaves squares there.
        """
        squares = float((self.squares()[self.fold >= 0] * self.weights).sum())
        squares += float(self.beta @ self._precision @ self.beta)
        return self.gain(key)[0] / max(squares, 1e-300)

    def gain(self, key: str) -> tuple[float, Array]:
        """In-sample gain and coefficients of one more group."""
        gains, coefficients = self.gains(key, 1)
        return float(gains[0]), coefficients[0]

    def gains(self, key: str, count: int) -> tuple[Array, Array]:
        """In-sample gains ``(count,)`` and coefficients ``(count, m)`` of so many equal parts of one more group."""
        group, total = self.design.groups[key], self.design.total
        weights, m = self.weights[list(group.channels)], group.m // count
        CG = np.tensordot(weights, np.concatenate([total(key, other) for other in (*self.keys, "y")], axis=2), 1)
        CC = np.tensordot(weights, total(key, key), 1).reshape(count, m, count, m)
        own = np.arange(count)
        return self._joined(group, CG.reshape(count, m, -1), CC[own, :, own], self.inverse, self.beta)[:2]

    def held_out_test(self, key: str) -> HeldOutTest:
        """Held-out gain of one more group, everything refitted without each fold in turn."""
        group = self.design.groups[key]
        products = {j: self.design.beside(key, self.keys, j) for j in group.channels}
        CG, CC = np.zeros((1 + self.folds, group.m, self.P + 1)), np.zeros((1 + self.folds, group.m, group.m))
        for j, (with_others, with_itself) in products.items():
            CG[:, :, self.G.parts[j][0]] += self.weights[j] * np.tensordot(self._training, with_others, 1)
            CC += self.weights[j] * np.tensordot(self._training, with_itself, 1)
        gains, gammas, moved = self._joined(group, CG, CC, *self._solutions)
        rows = 1 + self.fold
        v, step, gamma = self._left_out, np.column_stack([moved, np.zeros(len(moved))])[rows], gammas[rows]
        # What a candidate changes, e = [X, y] step - C gamma, times the residual r that is left out; and its squares.
        across, size = np.empty((2, len(rows), len(self.weights)))
        for j, (index, G) in enumerate(self.G.parts):
            across[:, j] = np.sum(self._along[j] * step[:, index], axis=1)
            size[:, j] = quadratic(G, step[:, index])
            if j in products:
                with_others, with_itself = products[j]
                across[:, j] -= np.sum(times(with_others, v[:, index]) * gamma, axis=1)
                size[:, j] += quadratic(with_itself, gamma) - 2.0 * np.sum(
                    times(with_others, step[:, index]) * gamma, axis=1)
        selecting, reduction = self.fold >= 0, np.full(len(rows), np.nan)
        by_channel = -self.weights * (2.0 * across + size)[selecting].sum(axis=0)
        across, size = across[selecting] @ self.weights, size[selecting] @ self.weights
        reduction[selecting] = -2.0 * across - size
        return HeldOutTest(float(gains[0]), gammas[0], reduction, by_channel, _one_sided(-across, -across - size))

    def _joined(self, group: Columns, CG: Array, CC: Array, inverse: Array,
                present: Array) -> tuple[Array, Array, Array]:
        """Schur complements: gains ``(…,)``, coefficients ``(…, m)``, and by what all others fall ``(…, P)``.

        ``CG (…, m, P + 1)`` are the weighted products of the group that joins with the groups fitted and ``y``, ``CC
        (…, m, m)`` those with itself, ``present`` the parameters without it.
        """
        CX = CG[..., :-1]
        Z = CX @ inverse
        S = CC - Z @ np.swapaxes(CX, -1, -2)
        m = CC.shape[-1]
        part = 1.0 if group.own is None else group.own.reshape(-1, m)
        # A column that the others explain all but what is rounding of has nothing of its own. What of it is of the form
        # of the model's own parameters does not count.
        size, remaining = (np.diagonal(matrix, axis1=-2, axis2=-1) for matrix in (CC, S))
        own = (remaining > ROUNDING * part * size) & (size > ROUNDING**2 * np.max(size, axis=-1, keepdims=True))
        if group.alike and m > 6:
            S = S + _SMOOTH * np.mean(size, axis=-1)[..., None, None] * np.eye(m)
            remaining = np.diagonal(S, axis1=-2, axis2=-1)
        scale = np.where(own, 1.0 / np.sqrt(np.where(own, remaining, 1.0)), 0.0)
        right = scale * (CG[..., -1] - times(CX, present))
        inner = S * scale[..., :, None] * scale[..., None, :] + np.eye(m) * (~own[..., None] + 1e-6)
        gamma = scale * np.linalg.solve(inner, right[..., None])[..., 0]
        return np.sum(right / np.where(own, scale, 1.0) * gamma, axis=-1), gamma, times(np.swapaxes(Z, -1, -2), gamma)


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
    return float(special.stdtr(B - 1, -float(values.sum()) / spread))


def standard_errors(difference: Array) -> float:
    """A sum over blocks of time ``(B,)`` in units of its own standard error; blocks that are not known are left out."""
    known = difference[np.isfinite(difference)]
    return float(known.sum() / max(np.std(known, ddof=1) * np.sqrt(len(known)), 1e-300))


def weights_of_channels(design: Design, keys: list[str], prior: Array | None, rounds: int = 2) -> Array:
    """1/σ² of each channel ``(c,)`` from the residual of a fit, found by refitting.

    The first weights are those that the model's own parameters leave, so that no channel's misfit weighs on another.

    Args:
        design, keys, prior: see ``Fit``.
        rounds: refits with ``keys``; after two the weights have settled.
    """
    known, key = design.of_model, (design.blocks.folds, id(prior))
    if key not in known:
        known[key] = Fit(design, ["W"], np.ones(design.c), prior).refitted_weights(), prior
    weights = known[key][0]
    for _ in range(rounds):
        weights = Fit(design, keys, weights, prior).refitted_weights()
    return weights
