r"""Basis of friction's deviations from an identified law: linear terms with a prior.

The friction of a joint beyond the identified one, divided by its dry friction F, is

.. math::

    \theta_1 z + \theta_2 \sqrt{s}\,\mathrm{sign}\,\dot q
        + \sum_k c_k \big(\phi_k(0) z + (\phi_k(s) - \phi_k(0))\, \mathrm{sign}\,\dot q\big)

with z the direction of sliding and s the speed over the largest one: a dry term, one that rises with speed, and a curve
that is smooth over the logarithm of speed; its :math:`\phi_k` are the principal components of curves whose values at
two speeds correlate as ``likeness`` says. The value of a term at standstill is dry friction with presliding, the rest
acts at once. The dry term is a factor of friction by load as well.

Every parameter is in units of its prior standard deviation.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.friction.table import Friction, braking, distance_with, largest_speeds
from ideal_robot.jit import jit

SPEEDS = np.array([0.0, 0.002, 0.005, 0.01, 0.015, 0.022, 0.035, 0.06, 0.12, 0.25, 0.5, 1.0])
"""Between these shares of the largest speed the curve is linear."""
KNEE, LENGTH = 0.005, 1.2
"""Share of the largest speed below which speeds are alike; logarithm of speed over which the curve becomes another."""
SHAPE = 0.15
"""Prior standard deviation of the curve."""


def likeness() -> Array:
    """Correlation of a curve's values at ``SPEEDS`` ``(K, K)``: it is smooth over the logarithm of speed."""
    place = np.log1p(SPEEDS / KNEE)
    return np.asarray(np.exp(-0.5 * ((place[:, None] - place) / LENGTH) ** 2))


def _components() -> Array:
    """The curve's principal components at ``SPEEDS`` ``(K, 6)``, each as large as it usually is.

    Six of them leave 0.3 % of the variance at any speed.
    """
    variance, directions = np.linalg.eigh(likeness())
    return np.ascontiguousarray(SHAPE * (directions * np.sqrt(np.maximum(variance, 0.0)))[:, : -7 : -1])


_CURVE = _components()
TERMS = 2 + _CURVE.shape[1]
"""Of friction: dry, rising, the curve's components."""
SHARED = np.array([0.1, 0.3])
"""Prior standard deviations of what all joints share of the dry and the rising term: they are cold or warm together.
Oil changes with temperature more than what runs dry ([G] Figs 3 and 12)."""
OWN = np.array([0.12, 0.15, *np.ones(TERMS - 2)])
"""Prior standard deviations of what is a joint's own of each term ``(TERMS,)``."""
ALONE = np.array([*np.hypot(SHARED, OWN[:2]), *OWN[2:]])
"""The same of a joint that is looked at by itself."""
_DRY = np.array([1.0, 0.0, *_CURVE[0]])
"""What they are at standstill."""


@jit()
def terms_along(share: float, z: float, h: Array) -> None:
    """Writes the columns of friction's terms, relative to dry friction, at one instant to ``h[:TERMS]``.

    Args:
        share: velocity over the largest speed.
        z: direction of sliding, -1 to 1.
        h: see above.
    """
    h[0], h[1] = 1.0, np.sqrt(abs(share))
    last = len(SPEEDS) - 1
    speed, k = min(abs(share), SPEEDS[last]), 0
    while k < last - 1 and speed >= SPEEDS[k + 1]:
        k += 1
    above = (speed - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k])
    for j in range(TERMS - 2):
        h[2 + j] = (1.0 - above) * _CURVE[k, j] + above * _CURVE[k + 1, j]
    for k in range(TERMS):
        h[k] = z * _DRY[k] + np.sign(share) * (h[k] - _DRY[k])


@jit()
def friction_terms(share: Array, z: Array) -> Array:
    """Columns ``(m, TERMS)`` of friction's terms, relative to dry friction.

    Args:
        share, z: velocities over the largest speed, and directions of sliding ``(m,)``.
    """
    terms = np.empty((len(share), TERMS))
    for k in range(len(share)):
        terms_along(share[k], z[k], terms[k])
    return terms


def dry_sizes(friction: Friction) -> Array:
    """Dry friction of each joint, the unit of the terms ``(n,)`` [N m]; never zero."""
    return np.asarray(np.maximum(friction.dry, 1e-6))


def table_terms(friction: Friction, v_max: Array) -> Array:
    """Dry and fluid friction over speed that a unit of each term adds ``(n, TERMS, m, 2)`` [N m].

    Args:
        friction, v_max: as identified, and speed limits ``(n,)`` [rad/s].
    """
    shares = friction.speeds / largest_speeds(v_max)[:, None]
    terms = np.stack([friction_terms(share, np.ones(len(share))).T for share in shares])
    sizes = np.stack([np.broadcast_to(_DRY[None, :, None], terms.shape), terms - _DRY[None, :, None]], axis=3)
    return np.ascontiguousarray(dry_sizes(friction)[:, None, None, None] * sizes)


@jit()
def with_terms(friction: Friction, terms: Array, values: Array) -> Friction:
    """The table of friction with its terms added; parts that would drive instead of brake are set to zero.

    Args:
        friction: without.
        terms: of ``table_terms``.
        values: of the terms ``(n, TERMS)``.
    """
    sizes, per_load = friction.sizes.copy(), friction.per_load.copy()
    for i in range(len(values)):
        for k in range(sizes.shape[2]):
            dry, fluid = 0.0, 0.0
            for term in range(TERMS):
                dry += values[i, term] * terms[i, term, k, 0]
                fluid += values[i, term] * terms[i, term, k, 1]
            for side in range(2):
                sizes[i, side, k, 0] += dry
                sizes[i, side, k, 1] += fluid
        for which in range(2):
            per_load[i, which] *= 1.0 + values[i, 0]
    braking(sizes)
    return Friction(friction.speeds, sizes, per_load, distance_with(friction, sizes))
