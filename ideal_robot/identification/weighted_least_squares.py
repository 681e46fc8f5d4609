"""Weighted least squares with the statistics of [J] 3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array

_RANK = 1e-8
"""Directions of the scaled regressor weaker than this share of the strongest count as not excited."""

_BLOCKS = 10


@dataclass(frozen=True)
class Solution:
    """Result of a weighted least-squares fit of ``n`` channels with ``P`` common parameters.

    Attributes:
        value: estimate ``(P,)``.
        covariance: ``(P, P)``; its standard deviations are never below ``std_white``.
        std_white: standard deviations by [J] (15), (16), which take residuals as white ``(P,)``.
        noise_std: standard deviation of each channel's residual ``(n,)``.
        condition_number: of the weighted observation matrix.
        condition_number_scaled: of the same with columns scaled to unit length.
        unexcited: mask ``(P,)`` of parameters that the data say nothing about; they keep their starting value.
        residual: ``(M, n)``.
    """

    value: Array
    covariance: Array
    std_white: Array
    noise_std: Array
    condition_number: float
    condition_number_scaled: float
    unexcited: np.ndarray
    residual: Array


def weighted_least_squares(W: Array, y: Array, start: Array, *, iterations: int = 4,
                           segments: Array | None = None) -> Solution:
    """Solves ``y = W p + e`` with one noise level per channel, estimated from the residual (IDIM-WLS).

    Args:
        W: ``(M, n, P)`` observation matrix per sample.
        y: ``(M, n)`` measurements.
        start: ``(P,)`` values that directions without excitation keep.
        iterations: re-estimations of the weights.
        segments: ``(M,)`` number of the recording each sample comes from, so that correlation of residuals is not
            counted across recordings.
    """
    count, n, size = W.shape
    scale_y = np.maximum(np.std(y, axis=0), 1e-12)
    noise = scale_y
    for _ in range(iterations):
        value, inverse, conditions, unexcited = _solve(W / noise[:, None], (y - W @ start) / noise)
        value = value + start
        residual = y - W @ value
        # [J] (15) channel by channel; each channel is charged its share of the parameters.
        freedom = max(1.0, count - (size - unexcited.sum()) / n)
        noise = np.maximum(np.sqrt(np.sum(residual**2, axis=0) / freedom), 1e-9 * scale_y)
    std_white = np.sqrt(np.diag(inverse))
    inflation = _correlation_inflation(W / noise[:, None], residual / noise, inverse, segments)
    covariance = inverse * np.outer(inflation, inflation)
    return Solution(value, covariance, std_white, noise, *conditions, unexcited, residual)


def _solve(W: Array, y: Array) -> tuple[Array, Array, tuple[float, float], np.ndarray]:
    """Minimum-norm solution over scaled columns, ``(WᵀW)⁻¹`` on what is excited, condition numbers."""
    flat = W.reshape(-1, W.shape[2])
    size = np.linalg.norm(flat, axis=0)
    seen = size > 1e-10 * size.max()
    # R of the QR decomposition has the singular values of W but only P rows.
    R, rhs = _triangular(flat[:, seen] / size[seen], y.reshape(-1))
    u, s, vt = np.linalg.svd(R)
    strong = s > _RANK * s[0]
    inverse_s = np.where(strong, 1.0 / np.where(strong, s, 1.0), 0.0)
    value = np.zeros(W.shape[2])
    value[seen] = (vt.T @ (inverse_s * (u.T @ rhs))) / size[seen]
    inverse = np.zeros((W.shape[2],) * 2)
    scaled = (vt.T * inverse_s**2) @ vt / np.outer(size[seen], size[seen])
    inverse[np.ix_(seen, seen)] = scaled
    unexcited = ~seen
    # A parameter with a visible share of a dropped direction cannot be told.
    unexcited[np.flatnonzero(seen)[np.sum(vt[~strong] ** 2, axis=0) > 1e-3]] = True
    raw = np.linalg.svd(R * size[seen], compute_uv=False)
    return value, inverse, (float(raw[0] / max(raw[-1], 1e-300)), float(s[0] / max(s[-1], 1e-300))), unexcited


def _triangular(W: Array, y: Array) -> tuple[Array, Array]:
    joined = np.asarray(np.linalg.qr(np.column_stack([W, y]), mode="r"))
    P = W.shape[1]
    return joined[:P, :P], joined[:P, P]


def _correlation_inflation(W: Array, residual: Array, inverse: Array, segments: Array | None) -> Array:
    """Factor ``(P,)`` ≥ 1 by which correlated residuals widen the standard deviations (Newey and West 1987).

    Unmodelled friction and elasticity leave residuals that stay alike over many samples; [J] (16) would count each of
    them as news.
    """
    count = len(W)
    scores = np.einsum("knp,kn->kp", W, residual) @ inverse
    blocks = [scores] if segments is None else [scores[segments == s] for s in np.unique(segments)]
    lags = min(max(4, round(4.0 * (count / 100.0) ** (2.0 / 9.0)) * 3), count // 10)
    variance = np.zeros(scores.shape[1])
    for block in blocks:
        variance += np.sum(block**2, axis=0)
        for lag in range(1, min(lags, len(block) - 1) + 1):
            variance += 2.0 * (1.0 - lag / (lags + 1.0)) * np.sum(block[lag:] * block[:-lag], axis=0)
    white = np.diag(inverse)
    variance = np.maximum(variance * count / max(1, count - scores.shape[1]), _jackknife(W, residual, inverse))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.sqrt(np.maximum(variance, 0.0) / white)
    return np.maximum(1.0, np.nan_to_num(ratio, nan=1.0, posinf=1.0))


def _jackknife(W: Array, residual: Array, inverse: Array) -> Array:
    """Variances ``(P,)`` from leaving out one of ten blocks of time after the other.

    A model that is not quite right fits different stretches with different parameters, however long its residual stays
    alike; what the blocks disagree about, the whole cannot know either.
    """
    blocks = np.array_split(np.arange(len(W)), _BLOCKS)
    information = np.linalg.pinv(inverse, hermitian=True)
    steps = []
    for rows in blocks:
        A = W[rows].reshape(-1, W.shape[2])
        # Without these rows the normal equations lose AᵀA and Aᵀe: the estimate moves by minus what they had added.
        left = information - A.T @ A
        steps.append(-np.linalg.pinv(left, rcond=1e-12, hermitian=True) @ (A.T @ residual[rows].reshape(-1)))
    deviation = np.array(steps) - np.mean(steps, axis=0)
    return np.asarray((_BLOCKS - 1) / _BLOCKS * np.sum(deviation**2, axis=0))
