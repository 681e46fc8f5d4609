r"""Friction, and what stands beside it in a torque: one linear basis, one prior, one noise, one set of equations.

What the model of an arm lacks shows in the torque of its joint i as

.. math::

    \tau_i - \tau_{i,model} = F_i \Big( \theta_{i1} z_i + \theta_{i2} \sqrt{|s_i|} \, \mathrm{sign}\, s_i
        + \sum_k c_{ik} \big(\phi_k(0) z_i + (\phi_k(|s_i|) - \phi_k(0))\, \mathrm{sign}\, s_i\big) + o_i \Big)
        + \sum_j J_{ij} \ddot q_j + m\, y_i + \sum_r (a_{ir} \cos k_r q_i + b_{ir} \sin k_r q_i)
        + Y_i \Delta p + \varepsilon_i

with F the dry friction, z how far it has turned to the direction of motion (-1 to 1), s the velocity over the largest
speed, o an offset, J inertia, y the torque of 1 kg at the tool, k the orders of the ripple, and Y the regressor of
links and rotors [G] (6). The first three are friction's terms: dry, rising with speed, and a curve that is smooth over
the logarithm of speed; its :math:`\phi_k` are the principal components of curves whose values at two speeds correlate
as ``likeness`` says. Each use asks for friction's terms and for a part of the rest:

=======================  ====================================  =================================================
use                      what it measures                      beside friction
=======================  ====================================  =================================================
``friction_adaptation``  motor torques while the arm works     inertia that torques show, mass at the tool
``friction_curve``       following errors while the arm works  offset, inertia
``friction_at_work``     torques of a motion beforehand        offset
``arm_of_its_type``      torques of a motion beforehand        offset, links and rotors, ripple, mass at the tool
=======================  ====================================  =================================================

Every parameter is counted in its standard deviation before anything was measured, so that the **prior** is
:math:`x \sim N(0, 1)`; the **noise** is :math:`\varepsilon \sim N(0, R)`. In batch (``solved``) the normal
equations are

.. math:: (1 + S)\, x = b, \qquad S = \sum h R^{-1} h^T, \qquad b = \sum h R^{-1} y.

On the way (``counted``) the same is solved measurement by measurement, by Kalman's equations, of parameters that
wander as temperature does (``aged``),

.. math:: x \leftarrow a\, x + w, \qquad w \sim N(0, 1 - a^2), \qquad a = e^{-t / WARMING},

which keeps their prior: whatever was learned long ago, they are as uncertain as at first, never more. A measurement
counts if it is within four standard deviations of what the prior expects, :math:`y^2 < 16 (R + h^T h)`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array, G
from ideal_robot.friction.table import Friction, largest_speeds
from ideal_robot.jit import jit
from ideal_robot.loop.loop import Loop

SPEEDS = np.array([0.0, 0.002, 0.005, 0.01, 0.015, 0.022, 0.035, 0.06, 0.12, 0.25, 0.5, 1.0])
"""Between these shares of the largest speed the curve is linear."""
KNEE, LENGTH = 0.005, 1.2
"""Share of the largest speed below which speeds are alike; logarithm of speed over which the curve becomes another."""
SHARED, OWN = np.array([0.1, 0.3]), np.array([0.12, 0.15])
"""Standard deviations of the dry and the rising term: of what all joints share, which are cold or warm together, and of
what is a joint's own. Oil changes with temperature more than what runs dry ([G] Figs 3 and 12)."""
ALONE = np.hypot(SHARED, OWN)
"""The same of a joint that is looked at by itself."""
SHAPE = 0.15
"""Standard deviation of the curve."""
WEIGHT = 0.2
"""Of weight that the model does not know, over dry friction: of a tool a metre away, or as an offset."""
NOISE, INTERVAL = 0.15, 0.05
"""Standard deviation of a torque over dry friction where one is taken every so often [s]. What the model lacks besides
is alike in neighbouring samples: more of them in that time say no more."""
FAR = 4.0
"""Standard deviations within which measurements count and parameters stay; by chance one in 16,000 is beyond."""
SLIDES, SLOWEST = 0.9, 0.002
"""How far friction must have turned, and share of the largest speed, from which on a joint tells its friction."""
WARMING = 600.0
"""Time over which friction becomes another [s]: after half an hour little changes ([G] Fig. 12), which is three time
constants."""


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
_DRY = np.array([1.0, 0.0, *_CURVE[0]])
"""What they count at speed 0."""


@jit()
def terms_at(share: float, h: Array) -> None:
    """What friction's terms count over dry friction at one speed over the largest, written to ``h[:TERMS]``."""
    h[0], h[1] = 1.0, np.sqrt(share)
    last = len(SPEEDS) - 1
    share, k = min(share, SPEEDS[last]), 0
    while k < last - 1 and share >= SPEEDS[k + 1]:
        k += 1
    above = (share - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k])
    for j in range(TERMS - 2):
        h[2 + j] = (1.0 - above) * _CURVE[k, j] + above * _CURVE[k + 1, j]


@jit()
def terms_along(share: float, z: float, h: Array) -> None:
    """The same of torque, written to ``h[:TERMS]``: what is dry acts with the direction of sliding z, the rest at once.

    Args:
        share: velocity over the largest speed.
        z, h: see above.
    """
    terms_at(abs(share), h)
    for k in range(TERMS):
        h[k] = z * _DRY[k] + np.sign(share) * (h[k] - _DRY[k])


def friction_terms(share: Array, z: Array | None = None) -> Array:
    """What friction's terms count of torque over dry friction ``(m, TERMS)``: see ``terms_along``.

    Args:
        share, z: velocities over the largest speed, and directions of sliding ``(m,)``; 1 if not given.
    """
    return np.asarray(_terms(share, np.ones(len(share)) if z is None else z))


@jit()
def _terms(share: Array, z: Array) -> Array:
    terms = np.empty((len(share), TERMS))
    for k in range(len(share)):
        terms_along(share[k], z[k], terms[k])
    return terms


def dry_friction(loop: Loop) -> Array:
    """Dry friction of a loop, mean of both directions ``(n,)`` [N m]."""
    return np.asarray(np.maximum(loop.friction.dry, 1e-6))


def noise_variance(dry: Array, spacing: float, noise_std: Array | None = None) -> Array:
    """Variance of a torque ``(n,)`` [(N m)²].

    Args:
        dry, spacing: dry friction ``(n,)`` [N m], and the time from one torque to the next [s].
        noise_std: what the model left of the torques that it was identified from ``(n,)`` [N m]. A torque is at least
            as uncertain: where friction is small, it is not what torques are wrong by.
    """
    std = np.maximum(NOISE * dry, 0.0 if noise_std is None else noise_std)
    return np.asarray(std**2 * max(1.0, INTERVAL / spacing))


def unknown_mass(dry: Array) -> float:
    """How heavy a tool may be beyond the model's: standard deviation [kg], by dry friction ``(n,)`` [N m]."""
    return float(WEIGHT * dry.max() / G)


class Solved(NamedTuple):
    """Solution of the normal equations.

    Attributes:
        x: parameters ``(P,)``.
        covariance: of them ``(P, P)``.
        evidence: logarithm of the probability of what was measured, less what is the same for all bases.
    """

    x: Array
    covariance: Array
    evidence: float


def solved(columns: Array, left: Array) -> Solved:
    """The normal equations in batch, of columns ``(M, P)`` that parameters count and what the model ``left (M,)``.

    Both are over the noise's standard deviation.
    """
    curvature = np.eye(columns.shape[1]) + columns.T @ columns
    covariance = np.asarray(np.linalg.inv(curvature))
    x = covariance @ (columns.T @ left)
    logarithm = float(np.linalg.slogdet(curvature)[1])
    return Solved(x, covariance, -0.5 * (float(left @ (left - columns @ x)) + logarithm))


def wandered(spacing: float) -> float:
    """a, what is left of parameters after ``spacing`` [s]."""
    return float(np.exp(-spacing / WARMING))


@jit()
def aged(x: Array, covariance: Array, left: float) -> None:
    """Parameters some time later.

    Args:
        x, covariance: parameters ``(p,)`` and ``(p, p)``, both written to.
        left: a, see ``wandered``.
    """
    for a in range(len(x)):
        x[a] *= left
        for b in range(len(x)):
            covariance[a, b] *= left * left
        covariance[a, a] += 1.0 - left * left


@jit()
def counted(x: Array, covariance: Array, h: Array, left: float, variance: float) -> bool:
    """Counts one measurement; False, and nothing changes, where it is too far from what the prior expects.

    Args:
        x, covariance: parameters ``(p,)``, within ``FAR``, and ``(p, p)``; both are written to.
        h: what the parameters count ``(p,)``.
        left, variance: what the model left, and the variance of its noise.
    """
    expected, missed, spread, gain = variance, left, variance, np.zeros(len(h))
    for a in range(len(h)):
        expected += h[a] * h[a]
    if not left * left < FAR * FAR * expected:
        return False
    for b in range(len(h)):
        if h[b] != 0.0:  # a joint's own parameters and the common ones: few of all
            missed -= h[b] * x[b]
            for a in range(len(h)):
                gain[a] += covariance[b, a] * h[b]
    for a in range(len(h)):
        spread += h[a] * gain[a]
    for a in range(len(h)):
        x[a] = min(max(x[a] + gain[a] * missed / spread, -FAR), FAR)
        for b in range(len(h)):
            covariance[a, b] -= gain[a] * gain[b] / spread
    return True


def remembered(x: Array, covariance: Array, places: Array) -> tuple[Array, Array]:
    """What is known of some parameters alone; of the others nothing is known.

    Args:
        x, covariance: parameters ``(n, p)`` and ``(n, p, p)``.
        places: of the parameters that are kept ``(k,)``.
    """
    values, uncertain = np.zeros_like(x), np.tile(np.eye(x.shape[1]), (len(x), 1, 1))
    values[:, places] = x[:, places]
    uncertain[:, places[:, None], places] = covariance[:, places[:, None], places]
    return values, uncertain


def table_terms(loop: Loop) -> Array:
    """What a unit of each of friction's terms adds to dry and fluid friction over speed ``(n, TERMS, m, 2)`` [N m]."""
    shares = loop.friction.speeds / largest_speeds(loop.path.v_max)[:, None]
    dry, terms = dry_friction(loop), np.stack([friction_terms(share).T for share in shares])
    sizes = np.stack([np.broadcast_to(_DRY[None, :, None], terms.shape), terms - _DRY[None, :, None]], axis=3)
    return np.ascontiguousarray(dry[:, None, None, None] * sizes)


@jit()
def with_terms(friction: Friction, terms: Array, values: Array) -> Friction:
    """Friction with its terms; what would drive in place of braking is none.

    Args:
        friction: without.
        terms: of ``table_terms``.
        values: of the terms ``(n, TERMS)``; the dry one is a factor of friction by load as well.
    """
    sizes, per_load = friction.sizes.copy(), friction.per_load.copy()
    for i in range(len(values)):
        for k in range(sizes.shape[2]):
            dry, fluid = 0.0, 0.0
            for term in range(TERMS):
                dry += values[i, term] * terms[i, term, k, 0]
                fluid += values[i, term] * terms[i, term, k, 1]
            for side in range(2):
                sizes[i, side, k, 0] = max(sizes[i, side, k, 0] + dry, 0.0)
                sizes[i, side, k, 1] = max(sizes[i, side, k, 1] + fluid, -sizes[i, side, k, 0])
        for which in range(2):
            per_load[i, which] *= 1.0 + values[i, 0]
    return Friction(friction.speeds, sizes, per_load, friction.sigma_0)
