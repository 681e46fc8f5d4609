r"""Friction's shape over speed, and inertia, learned from how far the motors are from where they were planned to be.

A law of few coefficients has not the shape of a gear's friction where it moves slowly: there friction falls with speed
before it rises. What the law lacks shows in the following error. Where the motors are not at the planned :math:`q_m`,
the joint controller [G] (16), (17) gives a torque beyond the planned one,

.. math:: \Delta\tau = k_p \Delta u + k_i \int \Delta u\, dt, \qquad
          \Delta u = -\left(\frac{d}{dt} + k_v\right) (q - q_m),

which is what the plan did not know. No torque is measured for that, so the noise of its sensor does not count. For
each joint a Kalman filter learns a curve over speed, linear between nodes and smooth over the logarithm of speed:

.. math::

    \Delta\tau_i = F_i(0) \left(o_i + z_i \sum_k (c_{ik} - c_{ik}') \phi_k(|\dot q_{m,i}|)\right)
                   + \sum_j (J_{ij} - J_{ij}') \ddot q_{m,j}

with F(0) the dry friction, z the direction of sliding, between -1 and 1 after a reversal, J the inertia that the drive
feels beyond the model's, its own and that of links which other joints accelerate, :math:`c'` and :math:`J'` what the
plan had used, and an offset o that wanders: weight, load, what was planned wrong besides.

The torque for acceleration is planned wrong where rotors and links were identified wrong, and where the gain
:math:`k_p` was, by which the plan turns it into a command. It is the same on any motion about the path and does not
change; friction's shape does, and is learned anew on each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.feedforward.ideal import IdealState
from ideal_robot.loop.loop_model import LoopModel, largest_speeds

SPEEDS = np.array([0.0, 0.002, 0.005, 0.01, 0.015, 0.022, 0.035, 0.06, 0.12, 0.25, 0.5, 1.0])
"""Nodes of the curve, as shares of the largest speed."""
KNEE = 0.005
"""Share of the largest speed below which speeds are alike."""
LENGTH = 1.2
"""Logarithm of speed over which the curve becomes another."""
SHAPE, DRIFT = 0.15, 0.05
"""The curve at first, and how far it wanders in a second: standard deviations over dry friction."""
OFFSET, WANDERS = 0.3, 0.1
"""The same of the offset."""
INERTIA, COUPLED = 0.1, 0.05
"""Standard deviations at first of a joint's inertia over ``k_p T``, which is about what a drive feels, and of that
between two joints over the root of both joints' ``k_p T``."""
HEAVIEST = 0.3
"""Bound of either."""
NOISE = 0.2
"""Standard deviation of a measurement over dry friction: neighbouring ones share what is wrong besides."""
LARGEST = 0.5
"""Bound of the curve over dry friction."""
GATE = 4.0
"""Measurements beyond this many standard deviations do not count."""
SLIDES, SLOWEST = 0.9, 1e-3
"""Direction of sliding, and share of the largest speed, from which on a joint tells its friction."""
FAR = 0.01
"""Following error of a joint that does not follow: stopped, guided, another command [rad]."""


@dataclass(frozen=True)
class Planned:
    """Of one cycle: motor angles and velocities at its end, direction of sliding, each ``(n,)``, and what was known."""

    q: Array
    v: Array
    turned: Array
    x: Array


@dataclass(frozen=True)
class CurveState:
    """What is known of the curves.

    Attributes:
        x: of each joint offset over dry friction, inertia for every joint's acceleration over the root of both joints'
            ``k_p T``, curve over dry friction ``(n, 1 + n + K)``.
        covariance: of them ``(n, 1 + n + K, 1 + n + K)``.
        plans: cycles whose measurement has not come yet, oldest first, behind the last one whose has.
        error: following error of the last cycle ``(n,)`` [rad]; None before the first.
        integral: torque of the controller's integral part beyond the planned one ``(n,)`` [N m].
    """

    x: Array
    covariance: Array
    plans: tuple[Planned, ...]
    error: Array | None
    integral: Array

    @property
    def curve(self) -> Array:
        """Friction beyond the model's, over dry friction, at the nodes ``(n, K)``."""
        return self.x[:, 1 + len(self.x) :]


class FrictionCurve:
    """Kalman filter for the friction curve and the inertia of every joint.

    Args:
        loop: the identified loop; its controller and its dry friction are the reference.
    """

    def __init__(self, loop: LoopModel) -> None:
        self.loop = loop
        self._v_max = largest_speeds(loop.v_max)
        self._dry = np.maximum(loop.friction_torque[:, 0].mean(axis=0), 1e-6)
        root = np.sqrt(loop.k_p * loop.t_ipo)
        self._unit = np.outer(root, root)
        alike, n = likeness(), loop.n
        # Places of the inertias and of the curve among a joint's parameters, behind the offset.
        self._masses, self._shape = slice(1, 1 + n), slice(1 + n, None)
        count, at = 1 + n + len(SPEEDS), np.arange(n)
        prior, drift = np.zeros((n, count, count)), np.zeros((count, count))
        prior[:, 0, 0], prior[:, self._shape, self._shape] = OFFSET**2, SHAPE**2 * alike
        prior[:, 1 + at, 1 + at] = COUPLED**2
        prior[at, 1 + at, 1 + at] = INERTIA**2
        drift[0, 0], drift[self._shape, self._shape] = WANDERS**2 * loop.t_ipo, DRIFT**2 * loop.t_ipo * alike
        self._prior, self._drift = prior, drift
        self._table = table_of(loop)

    def init(self, known: CurveState | None = None) -> CurveState:
        """Nothing known, or what is known from another motion; of that motion's following error nothing stays."""
        n = self.loop.n
        x = np.zeros((n, 1 + n + len(SPEEDS)))
        if known is None:
            return CurveState(x, self._prior, (), None, np.zeros(n))
        x[:, 1:] = known.x[:, 1:]
        covariance = known.covariance.copy()
        covariance[:, 0], covariance[:, :, 0] = self._prior[:, 0], self._prior[:, :, 0]
        return CurveState(x, covariance, (), None, np.zeros(n))

    def inertia_alone(self, state: CurveState) -> CurveState:
        """What a motion tells of any other: the inertia. Friction's shape is unknown again."""
        begun = self.init()
        x, covariance = begun.x.copy(), begun.covariance.copy()
        x[:, self._masses] = state.x[:, self._masses]
        covariance[:, self._masses, self._masses] = state.covariance[:, self._masses, self._masses]
        return replace(begun, x=x, covariance=covariance)

    def torque(self, state: CurveState) -> Array:
        """What the curves add to the loop's table of sliding friction ``(m, n)`` [N m]."""
        return tabled(self._table, state.curve, self._dry)

    def inertia(self, state: CurveState) -> Array:
        """What the drives feel of the joints' accelerations beyond the model's rotors and links ``(n, n)`` [kg m²]."""
        return np.asarray(state.x[:, self._masses] * self._unit)

    def planned(self, state: CurveState, ideal: IdealState) -> CurveState:
        """Takes note of what the ideal robot planned in a cycle with what this state knows."""
        plan = Planned(ideal.q_m, ideal.v_m, ideal.turned, state.x)
        return replace(state, plans=(*state.plans, plan)[-self.loop.delay - 2 :])

    def update(self, state: CurveState, q: Array) -> CurveState:
        """Takes the motor angles ``(n,)`` [rad] that the controller reported at the end of a cycle."""
        loop, q = self.loop, np.asarray(q, dtype=float)
        if len(state.plans) <= loop.delay + 1:
            return state
        before, plan = state.plans[:2]
        if q.shape != plan.q.shape or not np.all(np.abs(q - plan.q) < FAR):
            return replace(self.init(state), plans=state.plans)
        error = q - plan.q
        if state.error is None:
            return replace(state, error=error)
        step = state.error - error - 0.5 * loop.t_ipo * loop.k_v * (state.error + error)
        torque = loop.k_p * step / loop.t_ipo + state.integral + 0.5 * loop.k_i * step
        h = np.ones_like(state.x)
        h[:, self._masses] = self._unit / self._dry[:, None] * (plan.v - before.v) / loop.t_ipo
        h[:, self._shape] = plan.turned[:, None] * between_nodes(np.abs(plan.v) / self._v_max)
        covariance = state.covariance + self._drift
        said = np.matmul(covariance, h[:, :, None])[:, :, 0]
        S = np.sum(h * said, axis=1) + NOISE**2
        innovation = torque / self._dry - np.sum(h[:, 1:] * (state.x - plan.x)[:, 1:], axis=1) - state.x[:, 0]
        slides = (np.abs(plan.turned) > SLIDES) & (np.abs(plan.v) > SLOWEST * self._v_max)
        counts = slides & (innovation**2 < GATE**2 * S)
        gain = np.where(counts, 1.0 / S, 0.0)[:, None] * said
        x = state.x + gain * innovation[:, None]
        x[:, self._masses] = np.clip(x[:, self._masses], -HEAVIEST, HEAVIEST)
        x[:, self._shape] = np.clip(x[:, self._shape], -LARGEST, LARGEST)
        # Of a joint that stands nothing is learned, and nothing forgotten.
        covariance = np.where(counts[:, None, None], covariance - gain[:, :, None] * said[:, None], state.covariance)
        return CurveState(x, covariance, state.plans, error, state.integral + loop.k_i * step)


def likeness() -> Array:
    """Correlation of a curve's values at the nodes ``(K, K)``: it is smooth over the logarithm of speed."""
    place = np.log1p(SPEEDS / KNEE)
    return np.asarray(np.exp(-0.5 * ((place[:, None] - place) / LENGTH) ** 2))


def table_of(loop: LoopModel) -> Array:
    """Shares of the nodes ``(n, m, K)`` at the speeds of the loop's table of friction."""
    return np.stack([between_nodes(speed / most)
                     for speed, most in zip(loop.friction_velocity.T, largest_speeds(loop.v_max), strict=True)])


def tabled(table: Array, curve: Array, dry: Array) -> Array:
    """What curves add to the loop's table of friction ``(m, n)`` [N m].

    Args:
        table: shares of the nodes ``(n, m, K)``, as of ``table_of``.
        curve: its values at the nodes, as a share of dry friction ``(n, K)``.
        dry: dry friction ``(n,)`` [N m].
    """
    return np.asarray(np.matmul(table, curve[:, :, None])[:, :, 0].T * dry)


def between_nodes(speed: Array) -> Array:
    """Shares of the nodes ``(m, K)`` at speeds ``(m,)`` over the largest one."""
    speed = np.minimum(speed, SPEEDS[-1])
    k = np.minimum(np.searchsorted(SPEEDS, speed, side="right") - 1, len(SPEEDS) - 2)
    share = (speed - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k])
    rows, shares = np.arange(len(speed)), np.zeros((len(speed), len(SPEEDS)))
    shares[rows, k], shares[rows, k + 1] = 1.0 - share, share
    return shares
