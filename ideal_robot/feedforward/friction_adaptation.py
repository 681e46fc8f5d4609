"""Adaptation: the ideal robot's friction follows the arm while it works ([L] Fig. 1, [G] Figs 3 and 12).

Friction changes with temperature and lubricant, rigid body and controller do not. So two factors per joint are
estimated, one for the dry and one for the speed-dependent part of the identified friction, by recursive least squares
with forgetting:

    τ - τ_rigid = θ_1 F(0) sign(q̇) + θ_2 (F(|q̇|) - F(0)) sign(q̇) + τ_offset

Safe by construction: without measurements nothing changes; samples that are not finite, too slow or far from
what is expected do not count; forgetting stops when the motion tells nothing; the factors are bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.ideal import IdealRobot, IdealState
from ideal_robot.loop.further_torque import further_torque
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.robots.interface import RobotState

_WINDOW = 9
"""Measured positions whose polynomial gives velocity and acceleration at its middle."""


@dataclass(frozen=True)
class FrictionFactors:
    """What adaptation knows.

    Attributes:
        theta: factors on dry and on speed-dependent friction ``(n, 2)``.
        covariance: of them ``(n, 2, 2)``.
        q, tau: last measurements ``(m, n)`` with ``m`` up to the window.
        rejected: measurements in a row that did not count, per joint ``(n,)``.
        used: measurements that counted, per joint ``(n,)``.
    """

    theta: Array
    covariance: Array
    q: Array
    tau: Array
    rejected: Array
    used: Array


class FrictionAdaptation:
    """Recursive least squares on the friction factors of every joint.

    Args:
        loop: the identified loop; its rigid body, rotors and friction are the reference.
        memory: time over which old measurements lose their weight [s] of informative motion.
        bounds: lowest and highest factor.
        noise: standard deviation of the torque residual relative to dry friction.
        gate: residuals beyond this many standard deviations do not count.
        drift: how fast the factors may wander, standard deviation after one second.
    """

    def __init__(self, loop: LoopModel, *, memory: float = 20.0, bounds: tuple[float, float] = (0.3, 3.0),
                 noise: float = 0.15, gate: float = 4.0, drift: float = 0.02) -> None:
        self.loop, self.bounds, self.gate = loop, bounds, gate
        self._forgetting = np.exp(-loop.t_ipo / memory)
        self._drift = drift**2 * loop.t_ipo
        self._dry = loop.friction_torque[:, 0]
        # Neighbouring windows share most of their samples: what they say is worth about a third of independent ones.
        self._sigma = np.sqrt(3.0) * np.maximum(noise * self._dry.mean(axis=0), 1e-6)
        # Slower than this a window is not long against presliding's few tenths of a milliradian. Joints that hardly
        # move on a path slide slowly all the time: what they say is all that is known of friction where they work.
        self._slow = 0.005 * np.where(np.isfinite(loop.v_max), loop.v_max, 1.0)
        half = _WINDOW // 2
        t = loop.t_ipo * np.arange(-half, half + 1)
        self._fit = np.linalg.pinv(np.vander(t, 4, increasing=True))

    def init(self) -> FrictionFactors:
        """Factors 1, believed to 15 %."""
        n = self.loop.n
        return FrictionFactors(np.ones((n, 2)), np.tile(0.15**2 * np.eye(2), (n, 1, 1)), np.empty((0, n)),
                               np.empty((0, n)), np.zeros(n), np.zeros(n))

    def update(self, state: FrictionFactors, measured: RobotState) -> FrictionFactors:
        """Takes what the controller reported at the end of one cycle."""
        q, tau = np.asarray(measured.q, dtype=float), np.asarray(measured.tau, dtype=float)
        n = self.loop.n
        if q.shape != (n,) or tau.shape != (n,) or not (np.isfinite(q).all() and np.isfinite(tau).all()):
            # A hole in the measurements: the window starts anew, the factors stay.
            return replace(state, q=np.empty((0, n)), tau=np.empty((0, n)))
        window_q = np.concatenate([state.q, q[None]])[-_WINDOW:]
        window_tau = np.concatenate([state.tau, tau[None]])[-_WINDOW:]
        state = replace(state, q=window_q, tau=window_tau)
        if len(window_q) < _WINDOW:
            return state
        return self._learned(state)

    def _ripple(self, q: Array) -> Array:
        """Known torque ripple at positions ``(m, n)`` [N m]."""
        k, a, b = (self.loop.ripple[:, row, None] for row in range(3))
        return np.asarray(np.sum(a * np.cos(k * q) + b * np.sin(k * q), axis=0) if len(k) else np.zeros_like(q))

    def _learned(self, state: FrictionFactors) -> FrictionFactors:
        loop, middle = self.loop, _WINDOW // 2
        coefficients = self._fit @ state.q
        position, speed, acceleration = coefficients[0], coefficients[1], 2 * coefficients[2]
        if np.any(np.abs(speed) > 1.5 * loop.v_max) or np.any(np.abs(state.q[middle] - position) > 1e-2):
            return state
        # Torque through the same filter as the positions, so that both are smoothed alike.
        tau = self._fit[0] @ (state.tau - self._ripple(state.q))
        rigid = inverse_dynamics(loop.chain, position[None], speed[None], acceleration[None])[0]
        further = further_torque(loop, np.zeros(1), position[None], speed[None], acceleration[None], rigid[None],
                                 np.sign(speed)[None])[0]
        left = (tau - further) / loop.gain - rigid - loop.rotor_inertia * acceleration - loop.offset
        theta, covariance = state.theta.copy(), state.covariance.copy()
        rejected, used = state.rejected.copy(), state.used.copy()
        # All samples of the window must slide the same way.
        steps = np.diff(state.q, axis=0)
        for i in range(loop.n):
            v = speed[i]
            same = np.all(steps[:, i] > 0) or np.all(steps[:, i] < 0)
            if abs(v) < self._slow[i] or not same:
                continue
            side = 0 if v > 0 else 1
            dry = self._dry[side, i] + loop.friction_load[i] * abs(rigid[i])
            table = float(np.interp(abs(v), loop.friction_velocity[:, i], loop.friction_torque[side, :, i]))
            h = np.sign(v) * np.array([dry, table - self._dry[side, i]])
            P = covariance[i] / self._forgetting + self._drift * np.eye(2)
            # Without information forgetting would let the covariance grow for ever.
            P *= min(1.0, 0.5 / float(np.trace(P)))
            innovation = left[i] - h @ theta[i]
            S = float(h @ P @ h) + self._sigma[i] ** 2
            if innovation**2 > self.gate**2 * S:
                rejected[i] += 1
                continue
            gain = P @ h / S
            theta[i] = np.clip(theta[i] + gain * innovation, *self.bounds)
            covariance[i] = P - np.outer(gain, h @ P)
            rejected[i], used[i] = 0, used[i] + 1
        return replace(state, theta=theta, covariance=covariance, rejected=rejected, used=used)


@dataclass(frozen=True)
class AdaptedState:
    """State of the feedforward and of what it has learned of friction."""

    ideal: IdealState
    factors: FrictionFactors


class AdaptedIdeal(Feedforward):
    """The ideal robot with friction that follows the arm. Without ``observe`` it is the ideal robot.

    Args:
        ideal: what is adapted.
        adaptation: how.
        known: the factors to start with; 1, believed to 15 %, if None.
    """

    def __init__(self, ideal: IdealRobot, adaptation: FrictionAdaptation | None = None,
                 known: FrictionFactors | None = None) -> None:
        self.ideal, self.known = ideal, known
        self.adaptation = FrictionAdaptation(ideal.loop) if adaptation is None else adaptation
        self.n_d, self.t_ipo = ideal.n_d, ideal.t_ipo

    def init(self, q0: Array, factors: FrictionFactors | None = None) -> AdaptedState:
        """At rest at ``q0``, with the factors known from before, if any."""
        factors = self.known if factors is None else factors
        return AdaptedState(self.ideal.init(q0), self.adaptation.init() if factors is None else factors)

    def observe(self, state: AdaptedState, measured: RobotState) -> AdaptedState:
        """Takes what the controller reported at the end of a cycle."""
        return replace(state, factors=self.adaptation.update(state.factors, measured))

    def step(self, state: AdaptedState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, AdaptedState]:
        """See ``Feedforward.step``."""
        drives = self.ideal.drives._replace(**adapted(self.ideal.loop, state.factors.theta))
        q_c, inner = self.ideal.step_with(drives, state.ideal, q_d, tau_ext_d)
        return q_c, replace(state, ideal=inner)


def adapted(loop: LoopModel, theta: Array) -> dict[str, Any]:
    """Friction fields of a loop model with the factors ``theta (n, 2)`` applied."""
    dry = loop.friction_torque[:, :1]
    torque = theta[:, 0] * dry + theta[:, 1] * (loop.friction_torque - dry)
    return {"friction_torque": torque, "friction_load": theta[:, 0] * loop.friction_load}
