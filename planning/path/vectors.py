"""Products of a few 3-vectors at a time, without the overhead of NumPy's general ones, for the real-time part."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array


def dot(a: Array, b: Array) -> Array:
    """Scalar products over the last axis: ``(…, 3)`` and ``(…, 3)`` to ``(…)``."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def unit(vectors: Array) -> Array:
    """Vectors ``(…, 3)`` scaled to length 1."""
    return np.asarray(vectors / np.sqrt(dot(vectors, vectors))[..., None])


def cross(a: Array, b: Array) -> Array:
    """Vector products over the last axis, ``(…, 3)`` each, of equal shape."""
    out = np.empty_like(a)
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def exp(w: Array) -> Array:
    """Rotation matrices ``(…, 3, 3)`` of rotation vectors ``(…, 3)``: Rodrigues' formula for many at once."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = np.zeros((*np.shape(w)[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    # sin(x)/x and (1 - cos x)/x², both well behaved at 0.
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * K + second * (K @ K))
