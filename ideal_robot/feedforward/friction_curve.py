r"""Estimates friction and inertia from following errors of the motors.

A law of few coefficients has not the shape of a gear's friction where it moves slowly: there friction falls with speed
before it rises. The missing friction causes a following error. If the motors are not at the planned :math:`q_m`, the
joint controller [G] (16), (17) gives a torque beyond the planned one,

.. math:: \Delta\tau = k_p \Delta u + k_i \int \Delta u\, dt, \qquad
          \Delta u = -\left(\frac{d}{dt} + k_v\right) (q - q_m),

which the plan did not contain. No measured torque is used, so its noise does not matter. It is fitted in the basis of
``friction.terms`` by the unknown parameters less those used in the plan, primed:

.. math::

    \Delta\tau_i = F_i \Big( z_i f_i^T (x_i - x_i') + o_i \Big) + \sum_j (J_{ij} - J_{ij}') \ddot q_{m,j}

with F the dry friction, z the direction of sliding, between -1 and 1 after a reversal, f friction's terms, J the
inertia that the drive feels beyond the model's, its own and that of links which other joints accelerate, and an offset
o: weight, load, what was planned wrong besides.

The torque for acceleration is planned wrong where rotors and links were identified wrong, and where the gain
:math:`k_p` was, by which the plan turns it into a command. It is the same on any motion about the path and does not
change; friction's shape does, and is learned anew on each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.estimate.recursive import marginal, predict, update
from ideal_robot.feedforward.inverse import InverseState
from ideal_robot.feedforward.learned_friction import (
    INTERVAL,
    SLIDES,
    SLOWEST,
    WEIGHT,
    noise_variance,
    process_correlation,
)
from ideal_robot.friction.table import largest_speeds
from ideal_robot.friction.terms import ALONE, TERMS, dry_sizes, terms_along
from ideal_robot.jit import jit
from ideal_robot.loop.loop import Loop

INERTIA, COUPLED = 0.1, 0.05
"""Standard deviations of a joint's inertia over ``k_p T``, which is about what a drive feels, and of that between two
joints over the root of both joints' ``k_p T``."""
STRAY = 0.01
"""Following error of a joint that does not follow: stopped, guided, another command [rad]."""


class Planned(NamedTuple):
    """A cycle's plan: motor angles and velocities at its end, direction of sliding, ``(n,)`` each; parameters used."""

    q: Array
    v: Array
    direction: Array
    x: Array


class CurveState(NamedTuple):
    """Estimates of friction and inertia, and the plans not yet evaluated.

    Attributes:
        x: parameters of each joint: friction's terms, offset, inertia for every joint's acceleration ``(n, p)`` with
            ``p = TERMS + 1 + n``.
        covariance: of them ``(n, p, p)``.
        inertia: coupling of the joints' accelerations into the drive torques beyond the model's ``(n, n)`` [kg m²].
        plans: plans of cycles not yet evaluated, oldest first, after the last evaluated one.
        measured: motor angles of the first of these cycles, each ``(n,)`` [rad].
        error: following error of the last evaluated cycle ``(n,)`` [rad]; None before the first.
        integral: torque of the controller's integral part beyond the planned one ``(n,)`` [N m].
        strayed: sum over the cycles of the squared following errors, each at most ``STRAY``, ``(n,)`` [rad²].
    """

    x: Array
    covariance: Array
    inertia: Array
    plans: tuple[Planned, ...]
    measured: tuple[Array, ...]
    error: Array | None
    integral: Array
    strayed: Array


class _Known(NamedTuple):
    """What is known of the loop; names as in ``Cascade`` where they stand there.

    Attributes:
        dry: dry friction ``(n,)`` [N m].
        v_max: largest speeds that friction is looked at over ``(n,)`` [rad/s].
        unit: standard deviations of inertias ``(n, n)`` [kg m²].
        variance: of one cycle's torque over dry friction.
        correlation: of parameters with themselves when the next torque is used.
    """

    k_p: Array
    k_i: Array
    k_v: Array
    t_ipo: float
    dry: Array
    v_max: Array
    unit: Array
    variance: float
    correlation: float


class _Cycles(NamedTuple):
    """Some cycles; the first row is of the cycle before them.

    Attributes:
        v, direction: planned velocities [rad/s] and directions of sliding ``(c, n)``.
        x: parameters that the plans knew ``(c, n, p)``.
        error: following errors ``(c, n)`` [rad].
    """

    v: Array
    direction: Array
    x: Array
    error: Array


class FrictionCurve:
    """Estimates friction and inertia of every joint from its following error, with the loop's controller."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        n, T, dry = loop.n, loop.t_ipo, dry_sizes(loop.friction)
        root = np.sqrt(loop.cascade.k_p * T)
        unit = np.where(np.eye(n, dtype=bool), INERTIA, COUPLED) * np.outer(root, root)
        variance = float(noise_variance(np.ones(1), T)[0])
        self._together = max(1, round(INTERVAL / T))
        self._known = _Known(loop.cascade.k_p, loop.cascade.k_i, loop.cascade.k_v, T, dry,
                             largest_speeds(loop.path.v_max), unit, variance,
                             process_correlation(self._together * T))
        self._size = TERMS + 1 + n

    def init(self, known: CurveState | None = None) -> CurveState:
        """State before a motion: the prior, or another motion's estimates without its following error."""
        places = np.delete(np.arange(self._size), TERMS)
        if known is None:
            return self._begun(np.zeros((self.loop.n, self._size)), np.zeros((self.loop.n, self._size, self._size)),
                               places[:0])
        return self._begun(known.x, known.covariance, places)

    def inertia_alone(self, state: CurveState) -> CurveState:
        """The part of a state that is valid for other motions: inertia; friction is reset to its prior."""
        return self._begun(state.x, state.covariance, np.arange(TERMS + 1, self._size))

    def _begun(self, x: Array, covariance: Array, places: Array) -> CurveState:
        x, covariance = marginal(x, covariance, places)
        still = np.zeros(self.loop.n)
        return CurveState(x, covariance, self._inertia(x), (), (), None, still, still)

    def _inertia(self, x: Array) -> Array:
        return np.asarray(x[:, TERMS + 1 :] * self._known.unit)

    def values(self, state: CurveState) -> Array:
        """Estimated values of friction's terms ``(n, TERMS)``."""
        return np.asarray(ALONE * state.x[:, :TERMS])

    def planned(self, state: CurveState, ideal: InverseState) -> CurveState:
        """Stores the ideal robot's plan of a cycle, with the parameters used for it."""
        plans, measured, error = state.plans, state.measured, state.error
        if len(plans) > self.loop.path.delay + 1 + len(measured):  # the cycle before was not measured
            measured, error = (), None
        plan = Planned(ideal.q_m, ideal.v_m, ideal.presliding.direction, state.x)
        plans = (*plans, plan)[-self.loop.path.delay - 2 - len(measured) :]
        return state._replace(plans=plans, measured=measured, error=error)

    def update(self, state: CurveState, q: Array) -> CurveState:
        """The state updated by the motor angles ``(n,)`` [rad] reported at the end of a cycle."""
        if len(state.plans) <= self.loop.path.delay + 1 + len(state.measured):
            return state
        measured = (*state.measured, np.array(q, dtype=float))
        # The first following error does not give a torque yet.
        if len(measured) < self._together + (state.error is None):
            return state._replace(measured=measured)
        return self._counted(state, measured)

    def _counted(self, state: CurveState, measured: tuple[Array, ...]) -> CurveState:
        """The state with the cycles whose motor angles are there."""
        now, plans = state.plans[: len(measured) + 1], state.plans[len(measured) :]
        errors = [q - plan.q if q.shape == plan.q.shape else np.full(self.loop.n, np.inf)
                  for q, plan in zip(measured, now[1:], strict=True)]
        # A plan without positions has infinite errors: clipped, they can be summed, and are worse than any other.
        strayed = state.strayed + np.square(np.clip(errors, -STRAY, STRAY)).sum(axis=0)
        if not np.abs(errors).max() < STRAY:
            # The first large error resets the estimates of this motion.
            known = state if state.error is None else self.init(state)
            return known._replace(plans=plans, measured=(), error=None, strayed=strayed)
        if state.error is None:
            now = now[1:]
        else:
            errors.insert(0, state.error)
        x, covariance, integral = state.x.copy(), state.covariance.copy(), state.integral.copy()
        cycles = _Cycles(np.array([plan.v for plan in now]), np.array([plan.direction for plan in now]),
                         np.array([plan.x for plan in now]), np.array(errors))
        _learned(self._known, cycles, x, covariance, integral)
        return CurveState(x, covariance, self._inertia(x), plans, (), errors[-1], integral, strayed)


@jit()
def _cycle(known: _Known, cycles: _Cycles, row: int, integral: Array, together: Array) -> None:
    """Adds what the cycle of a row says of joints that slide; ``integral`` and ``together`` are written to.

    Over the cycles in which a joint told something ``together (n, p + 2)`` sums what the parameters count, the torque,
    and how many they were.
    """
    v, v_before, direction, used = cycles.v[row], cycles.v[row - 1], cycles.direction[row], cycles.x[row]
    n, p, T = len(integral), used.shape[1], known.t_ipo
    h = np.zeros(p)
    for i in range(n):
        before, now = cycles.error[row - 1, i], cycles.error[row, i]
        step = before - now - 0.5 * T * known.k_v[i] * (before + now)
        torque = known.k_p[i] * step / T + integral[i] + 0.5 * known.k_i[i] * step
        integral[i] += known.k_i[i] * step
        if abs(direction[i]) < SLIDES or abs(v[i]) < SLOWEST * known.v_max[i]:
            continue
        terms_along(v[i] / known.v_max[i], direction[i], h)
        for k in range(TERMS):
            h[k] *= ALONE[k]
        h[TERMS] = WEIGHT
        for j in range(n):
            h[TERMS + 1 + j] = known.unit[i, j] / known.dry[i] * (v[j] - v_before[j]) / T
        observed = torque / known.dry[i]
        for k in range(p):
            observed += h[k] * used[i, k] if k != TERMS else 0.0
            together[i, k] += h[k]
        together[i, p] += observed
        together[i, p + 1] += 1.0


@jit()
def _learned(known: _Known, cycles: _Cycles, x: Array, covariance: Array, integral: Array) -> None:
    """Updates ``x``, ``covariance`` and ``integral`` of ``CurveState`` by the mean of some cycles."""
    n, p = x.shape
    together = np.zeros((n, p + 2))
    for row in range(1, len(cycles.v)):
        _cycle(known, cycles, row, integral, together)
    for i in range(n):
        count = together[i, -1]
        predict(x[i], covariance[i], known.correlation)
        if count > 0.0:
            update(x[i], covariance[i], together[i, :p] / count, together[i, p] / count, known.variance / count)
