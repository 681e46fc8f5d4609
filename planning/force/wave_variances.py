"""Which waves a surface has: variances of cosines and sines that make what was felt likelier."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array

BETTER = 0.1
"""Gain of log likelihood from which on a change of a variance is taken."""
MOST = 8
"""Variances that are changed at a time."""
ROUNDED = 1e-6
"""What is left of a wave that is known so well that rounding hides it; its variance is left as it is."""


def likelier_variances(gamma: Array, waves: Array, inverse: Array, weights: Array, largest: float) -> Array:
    r"""Changes one variance after another to its best value, always the one that gains most.

    That is Tipping and Faul's *fast marginal likelihood* (2003), with the cosine and the sine of a wavelength as a pair
    that shares a variance. With the covariance C of all but the wave U (m, 2), its gain of log likelihood is

    .. math:: \tfrac12 \left( -\ln|I + \gamma S| + \gamma\, q^T (I + \gamma S)^{-1} q \right),
              \quad S = U^T C^{-1} U,\ q = U^T C^{-1} y

    A change is one of rank two in the covariance, so S and q of all waves follow without inverting it again.

    Args:
        gamma: variances ``(n,)`` [m²].
        waves: cosines, then sines, at the places that were felt ``(m, 2 n)``.
        inverse: of the covariance of what was felt, with these variances in it ``(m, m)`` [1/m²].
        weights: ``inverse`` times what was felt ``(m,)`` [1/m].
        largest: bound of a variance [m²].
    """
    n, gamma = len(gamma), gamma.copy()
    solved = inverse @ waves
    # Of all waves, as with the present variances: S by its elements, and q.
    S = np.stack([_columns(waves[:, :n], solved[:, :n]), _columns(waves[:, :n], solved[:, n:]),
                  _columns(waves[:, n:], solved[:, n:])])
    q = (waves.T @ weights).reshape(2, n)
    for _ in range(MOST):
        # As if the wave were not in the covariance.
        left = np.stack([1.0 - gamma * S[0], -gamma * S[1], 1.0 - gamma * S[2]])
        size = left[0] * left[2] - left[1] ** 2
        sure = (left[0] > ROUNDED) & (size > ROUNDED**2)
        without = np.stack([left[2], -left[1], left[0]]) / np.where(sure, size, 1.0)
        alone = _times(without, S)
        seen = np.stack([without[0] * q[0] + without[1] * q[1], without[1] * q[0] + without[2] * q[1]])
        # The best variance of a pair whose S is a multiple of the identity, which it nearly is.
        spread, fit = 0.5 * (alone[0] + alone[2]), 0.5 * (seen**2).sum(axis=0)
        best = np.minimum(np.where(fit > spread, (fit - spread) / spread**2, 0.0), largest)
        best = np.where(sure, best, gamma)
        gain = np.where(sure, _gain(best, alone, seen) - _gain(gamma, alone, seen), 0.0)
        most = int(np.argmax(gain))
        if gain[most] <= BETTER:
            break
        change, gamma[most] = best[most] - gamma[most], best[most]
        pair = [most, n + most]
        core = np.linalg.inv(np.eye(2) / change + np.array([[S[0, most], S[1, most]], [S[1, most], S[2, most]]]))
        with_pair = waves.T @ solved[:, pair]
        gone = with_pair @ core
        q -= (gone @ q[:, most]).reshape(2, n)
        S -= np.stack([(gone[:n] * with_pair[:n]).sum(axis=1), (gone[:n] * with_pair[n:]).sum(axis=1),
                       (gone[n:] * with_pair[n:]).sum(axis=1)])
        solved -= solved[:, pair] @ gone.T
    return gamma


def _columns(a: Array, b: Array) -> Array:
    """Products of the columns of two matrices ``(n,)``."""
    return np.einsum("ij,ij->j", a, b)


def _times(left: Array, right: Array) -> Array:
    """Products ``(3, n)`` of symmetric matrices that commute."""
    return np.stack([left[0] * right[0] + left[1] * right[1], left[0] * right[1] + left[1] * right[2],
                     left[1] * right[1] + left[2] * right[2]])


def _gain(gamma: Array, S: Array, q: Array) -> Array:
    """Log likelihood that waves of these variances add, each for itself ``(n,)``."""
    a, b, c = 1.0 + gamma * S[0], gamma * S[1], 1.0 + gamma * S[2]
    size = np.maximum(a * c - b * b, ROUNDED**2)
    fit = gamma * (c * q[0] ** 2 - 2.0 * b * q[0] * q[1] + a * q[1] ** 2) / size
    return np.asarray(0.5 * (fit - np.log(size)))
