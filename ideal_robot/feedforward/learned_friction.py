r"""The linear model of adaptation: four choices of columns with one prior and one noise.

The torque of joint i beyond its model is

.. math::

    \tau_i - \tau_{i,model} = F_i \big( f_i^T x_i + o_i \big)
        + \sum_j J_{ij} \ddot q_j + m\, y_i + \sum_r (a_{ir} \cos k_r q_i + b_{ir} \sin k_r q_i)
        + Y_i \Delta p + \varepsilon_i

with F the dry friction, f friction's terms (``ideal_robot.friction.terms``), o an offset, J inertia, y the torque of
1 kg at the tool, k the orders of the ripple, and Y the regressor of links and rotors [G] (6). Each use has friction's
terms and a part of the rest as its columns:

=======================  ====================================  =================================================
use                      what it measures                      beside friction
=======================  ====================================  =================================================
``friction_adaptation``  motor torques while the arm works     inertia that torques show, mass at the tool
``friction_curve``       following errors while the arm works  offset, inertia
``friction_at_work``     torques of a motion beforehand        offset
``arm_of_its_type``      torques of a motion beforehand        offset, links and rotors, ripple, mass at the tool
=======================  ====================================  =================================================

The **prior** is one: every parameter is in units of its standard deviation, :math:`x \sim N(0, 1)`. The **noise** is
one: ``noise_variance``. Motions beforehand are estimated in batch (``ideal_robot.estimate.gaussian``), the others
recursively (``ideal_robot.estimate.recursive``), with process noise as friction changes with temperature.

**Process noise.** Oil warms steadily, a random walk goes to and fro: one that changes as much in half an hour changes
far more in ten seconds. What follows a change of rate c as a random walk of variance q in a second, and is told r (the
inverse of a variance) in a second, is off in the mean square by

.. math:: \tfrac12 \sqrt{q / r} + \frac{c^2}{q\, r},
          \qquad \text{least at} \quad q = (4 c^2)^{2/3}\, r^{-1/3},

the noise that it lets through and the way that it lags behind. That is three quarters of the variance that it reckons
with, :math:`\sqrt{q/r}`; of a faster walk it is half. The rate is that of two draws from the prior in the time constant
of warming, :math:`c = \sqrt 2 / T`; r is what torques tell of the dry term alone.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array, G
from ideal_robot.estimate.gaussian import Posterior, posterior
from ideal_robot.estimate.recursive import correlation
from ideal_robot.friction.terms import ALONE

WEIGHT = 0.2
"""Of weight that the model does not know, over dry friction: of a tool a metre away, or as an offset."""
NOISE, INTERVAL = 0.15, 0.05
"""Standard deviation of a torque over dry friction where one is taken every so often [s]. What the model lacks besides
is alike in neighbouring samples: more of them in that time say no more."""
SLIDES, SLOWEST = 0.9, 0.002
"""Direction of sliding, and share of the largest speed, from which on a joint shows its friction."""
WARMING = 600.0
"""Time constant with which friction warms [s]: after half an hour little changes ([G] Fig. 12), which is three."""


def noise_variance(dry: Array, spacing: float, noise_std: Array | None = None) -> Array:
    """Variance of a torque ``(n,)`` [(N m)²].

    Args:
        dry, spacing: dry friction ``(n,)`` [N m], and the time from one torque to the next [s].
        noise_std: the model's torque residual in the identification ``(n,)`` [N m]. It is a lower bound, as the noise
            does not vanish with small friction.
    """
    std = np.maximum(NOISE * dry, 0.0 if noise_std is None else noise_std)
    return np.asarray(std**2 * max(1.0, INTERVAL / spacing))


def process_correlation(spacing: float) -> float:
    """Correlation of a parameter with itself after ``spacing``, by the process noise derived in this module.

    Args:
        spacing: time from one torque to the next [s].
    """
    rate = np.sqrt(2.0) / WARMING
    told = (ALONE[0] / NOISE) ** 2 / INTERVAL
    walk = (4.0 * rate**2) ** (2.0 / 3.0) * told ** (-1.0 / 3.0)
    # A random walk that preserves the prior: for small steps 1 - a² = 2 t / T_a.
    return correlation(spacing, 2.0 / walk)


def unknown_mass(dry: Array) -> float:
    """Prior standard deviation of the tool's mass beyond the model's [kg], from dry friction ``(n,)`` [N m]."""
    return float(WEIGHT * dry.max() / G)


def estimated(columns: Array, residual: Array) -> Posterior:
    """Posterior of the parameters from all rows, with the prior ``N(0, 1)``.

    Args:
        columns, residual: columns of the parameters ``(M, P)`` and the model's residual ``(M,)``, in units of the
            noise.
    """
    rows = np.column_stack([columns, residual])
    return posterior(rows.T @ rows, np.eye(columns.shape[1]))


def evidence(estimate: Posterior) -> float:
    """Log marginal likelihood of the rows of ``estimated``, up to a constant."""
    return -0.5 * (estimate.squares + float(estimate.mean @ estimate.mean) + estimate.logarithm)
