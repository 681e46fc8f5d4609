"""Direction of sliding with memory: what takes the place of ``sign(qd)`` near a reversal and at rest.

Before a contact slides it bends. Dahl's model of that (P. R. Dahl 1968), ``dz/dt = (qd - |qd| z) / x_s``, solved for
one step of position, is ::

    z(k) = s + (z(k-1) - s) exp(-|q(k) - q(k-1)| / x_s) ,   s = sign(q(k) - q(k-1))

with the presliding distance x_s: ±1 in gross sliding, in between after a reversal, unchanged at rest. It needs no
time and no velocity. Position noise would still wear it down at rest, step by step; so in a law only what leaves a band
of a twentieth of x_s about the last position counts as motion.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.jit import jit

_BEFORE = 0.1
"""How long a motion is taken to have lasted before its first sample [s]."""

_BAND = 0.05
"""Half width of the band within which the position may be noisy, in presliding distances."""


def sliding_direction(q: Array, qd: Array, distance: Array) -> Array:
    """Direction of sliding along a motion, each within [-1, 1].

    Args:
        q: positions ``(N, n)`` [rad or m], consecutive in time.
        qd: velocities ``(N, n)``; only the first row counts. The joint is taken to have moved like that for a tenth
            of a second before; at rest the direction starts at zero, for nobody knows it.
        distance: presliding distance ``(n,)`` [rad or m].
    """
    q = np.ascontiguousarray(q, dtype=float)
    distance = np.asarray(distance, dtype=float)
    v = np.asarray(qd, dtype=float)[0]
    # Squared, so that the noise of a velocity at rest counts for nothing.
    start = np.sign(v) * -np.expm1(-((v * _BEFORE / distance) ** 2))
    return np.asarray(_follow(q, start, distance))


@jit()
def dahl(q: Array, distance: float) -> Array:
    """Direction of sliding ``(N,)`` along exact positions ``(N,)`` of one joint, unbent at first: without the band."""
    z = np.zeros(len(q))
    for k in range(1, len(q)):
        z[k] = turned(z[k - 1], q[k] - q[k - 1], distance)
    return z


@jit()
def _follow(q: Array, start: Array, distance: Array) -> Array:
    count, n = q.shape
    z = np.empty((count, n))
    for j in range(n):
        z[0, j] = start[j]
        band = _BAND * distance[j]
        last = q[0, j]
        for k in range(1, count):
            away = q[k, j] - last
            step = max(away - band, 0.0) + min(away + band, 0.0)
            z[k, j] = z[k - 1, j]
            if step != 0.0:
                last += step
                z[k, j] = turned(z[k - 1, j], step, distance[j])
    return z


@jit()
def turned(z: float, step: float, distance: float) -> float:
    """Dahl's model over one step of position: the direction of sliding, -1 to 1.

    Args:
        z, step: direction before, and how far it goes [rad or m].
        distance: presliding distance [rad or m]; 0 where the direction jumps.
    """
    if step == 0.0:
        return z
    s = 1.0 if step > 0.0 else -1.0
    behind = z - s
    # In gross sliding nothing is behind, and the exponential is what costs time.
    return s + behind * np.exp(-abs(step) / distance) if behind != 0.0 and distance > 0.0 else s
