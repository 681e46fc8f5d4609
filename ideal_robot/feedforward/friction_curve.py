r"""The shape of friction over speed, learned from how far the motors are from where they were planned to be.

A law with a few coefficients has not the shape of a gear's friction where it moves slowly: there it falls with the
speed before it rises. What the law lacks shows in the following error. With planned motor angles :math:`q_m` the joint
controller [G] (16), (17) adds to the planned torque

.. math:: \Delta\tau = k_p \Delta u + k_i \int \Delta u\, dt, \qquad
          \Delta u = -\left(\frac{d}{dt} + k_v\right) (q - q_m),

which is what the plan did not know: no measured torque is needed, and its noise does not count. Of each joint a curve
over speed is learned, piecewise linear, by a Kalman filter whose prior is smooth over the logarithm of the speed:

.. math:: \Delta\tau = o + F(0)\, z \sum_k c_k\, \phi_k(|\dot q_m|)

with z the direction of sliding, between -1 and 1 after a reversal, and an offset o that wanders: weight, load.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.feedforward.ideal import IdealState
from ideal_robot.loop.loop_model import LoopModel

SPEEDS = np.array([0.0, 0.002, 0.005, 0.01, 0.015, 0.022, 0.035, 0.06, 0.12, 0.25, 0.5, 1.0])
"""Nodes of the curve, as shares of the largest speed."""
KNEE = 0.005
"""Share of the largest speed below which speeds are alike."""
LENGTH = 1.2
"""Logarithm of speed over which the curve becomes another."""
SHAPE = 0.15
"""What the law lacks, as a share of dry friction: standard deviation."""
OFFSET, WANDERS = 0.3, 0.2
"""Offset over dry friction at first, and how far it wanders in a second: standard deviations."""
DRIFT = 0.1
"""How far the curve wanders in a second, as a share of ``SHAPE``²'s root."""
NOISE = 0.2
"""Standard deviation of a measurement over dry friction."""
LARGEST = 0.5
"""Bound of the curve."""
SLIDES = 0.9
"""Direction of sliding from which on a joint counts as sliding."""


@dataclass(frozen=True)
class CurveState:
    """What is known.

    Attributes:
        x: offset and curve over dry friction ``(n, 1 + K)``.
        P: covariance ``(n, 1 + K, 1 + K)``.
        plans: of the cycles whose measurement is not there yet, planned motor angle, its speed, the direction of
            sliding and the curve used, each ``(n, …)``; oldest first.
        error: last following error ``(n,)`` [rad]; none before the first.
        integral: torque of the integral part ``(n,)`` [N m].
    """

    x: Array
    P: Array
    plans: tuple[tuple[Array, Array, Array, Array], ...] = ()
    error: Array | None = None
    integral: Array | None = None


class FrictionCurve:
    def __init__(self, loop: LoopModel) -> None:
        self.loop = loop
        n = loop.n
        self._v_max = np.where(np.isfinite(loop.v_max), loop.v_max, 10.0)
        self._dry = np.maximum(loop.friction_torque[:, 0].mean(axis=0), 1e-6)
        x = np.log1p(SPEEDS / KNEE)
        K = SHAPE**2 * np.exp(-0.5 * ((x[:, None] - x) / LENGTH) ** 2)
        prior = np.zeros((1 + len(x), 1 + len(x)))
        prior[0, 0], prior[1:, 1:] = OFFSET**2, K
        self._prior = np.tile(prior, (n, 1, 1))
        self._drift = loop.t_ipo * prior
        self._drift[0, 0] = WANDERS**2 * loop.t_ipo
        self._drift[1:, 1:] *= DRIFT
        self._table = np.stack([_hats(loop.friction_velocity[:, i] / self._v_max[i]) for i in range(n)])

    def init(self) -> CurveState:
        return CurveState(np.zeros((self.loop.n, 1 + len(SPEEDS))), self._prior)

    def torque(self, curve: Array) -> Array:
        """What the curve ``(n, K)`` adds to the friction's table ``(m, n)`` [N m]."""
        return np.einsum("imk,ik->mi", self._table, curve) * self._dry

    def planned(self, state: CurveState, ideal: IdealState) -> CurveState:
        plan = (ideal.q_m, ideal.v_m, ideal.turned, state.x[:, 1:])
        return CurveState(state.x, state.P, (*state.plans, plan)[-self.loop.delay - 1:], state.error, state.integral)

    def update(self, state: CurveState, q: Array) -> CurveState:
        loop, T = self.loop, self.loop.t_ipo
        if len(state.plans) <= loop.delay:
            return state
        q_m, v, turned, used = state.plans[0]
        error = q - q_m
        if state.error is None or state.integral is None:
            return CurveState(state.x, state.P, state.plans, error, np.zeros(loop.n))
        step = -(error - state.error) - loop.k_v * T * 0.5 * (error + state.error)
        torque = loop.k_p * step / T + state.integral + 0.5 * loop.k_i * step
        integral = state.integral + loop.k_i * step
        h = np.zeros_like(state.x)
        h[:, 0] = 1.0
        h[:, 1:] = turned[:, None] * _hats(np.abs(v) / self._v_max)
        y = torque / self._dry + np.sum(h[:, 1:] * used, axis=1)
        P = state.P + self._drift
        said = np.einsum("ijk,ik->ij", P, h)
        S = np.sum(h * said, axis=1) + NOISE**2
        innovation = y - np.sum(h * state.x, axis=1)
        counts = (np.abs(turned) > SLIDES)  & (np.abs(v)>1e-3*self._v_max)
        gain = np.where(counts, 1.0, 0.0)[:, None] * said / S[:, None]
        x = state.x + gain * innovation[:, None]
        x[:, 1:] = np.clip(x[:, 1:], -LARGEST, LARGEST)
        P = P - gain[:, :, None] * said[:, None, :]
        return CurveState(x, P, state.plans, error, integral)


def _hats(v: Array) -> Array:
    """Piecewise linear functions ``(m, K)`` at speeds ``(m,)`` over the largest one."""
    v = np.clip(np.asarray(v), SPEEDS[0], SPEEDS[-1])
    k = np.clip(np.searchsorted(SPEEDS, v, side="right") - 1, 0, len(SPEEDS) - 2)
    share = (v - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k])
    hats = np.zeros((len(v), len(SPEEDS)))
    rows = np.arange(len(v))
    hats[rows, k], hats[rows, k + 1] = 1.0 - share, share
    return hats
