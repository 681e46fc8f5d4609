"""Adaptation: friction and the tool's mass follow the arm while it works ([L] Fig. 1, [G] Figs 3 and 12).

Friction changes with temperature and lubricant, and a tool may be heavier than told; arm and controller do not change.
So two factors per joint are estimated, one for the dry part of the identified friction and one for what rises with the
root of speed, an apparent inertia per joint, and one mass at the tool for all joints, by recursive least squares with
forgetting:

    τ - τ_rigid + τ_ext = z (F(|q̇|) + (θ_1 - 1) F(0) + (θ_2 - 1) F(0) √(|q̇| / v_max)) + c k_p T q̈ + τ_offset
                          + m y(q, q̇, q̈)

with z how far friction has turned since the last reversal, and y the torque of 1 kg at the tool. Friction turns round
with the motion and is each joint's own; a weight does not, and shows in all joints as its lever has it.

Commands are joined by straight lines: at the end of each cycle T the wanted speed jumps by q̈ T, and with it the torque,
by a share of k_p T q̈. A torque that is read there shows less inertia than there is; it would be taken for less friction
at low speed and more at high. That is c, and what rotors were identified wrong by besides; nothing is commanded for it.
What other inertias are wrong by is counted to a sample's variance.

Before anything was measured all joints are thought to have changed together: an arm is cold as a whole.

What the law's shape lacks over speed can be learned beside it: from the following error (``friction_curve``) or, where
the path is planned anew all the time and following errors are not friction's alone, from the torques too, as

    z F(0) Σ_k c_k φ_k(|q̇|)

more on the right, a curve as there. A gear's friction falls with speed before it rises. Without the curve two factors
explain what was measured at higher speeds at the cost of the friction that a reversal meets.

Safe by construction: without measurements nothing changes; samples that are not finite, too slow or far from
what is expected do not count; forgetting stops when the motion tells nothing; all that is learned is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, inverse_dynamics, point_mass
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.friction_curve import (
    LARGEST,
    SHAPE,
    SPEEDS,
    CurveState,
    FrictionCurve,
    between_nodes,
    likeness,
    table_of,
    tabled,
)
from ideal_robot.feedforward.ideal import IdealRobot, IdealState
from ideal_robot.feedforward.smoothed_window import CYCLES, SmoothedWindow
from ideal_robot.loop.from_model import further_torque
from ideal_robot.loop.loop_model import LoopModel, friction_of_load, largest_speeds
from ideal_robot.robots.interface import RobotState

_GRAVITY = 9.81
_SHARED, _OWN = (0.1, 0.3), (0.12, 0.15)
"""Standard deviations of the two friction factors before anything was measured: of what all joints share, which are
cold or warm together, and of what is a joint's own. Oil changes with temperature more than what runs dry."""
_SLIDES = 0.9
"""How far friction must have turned to tell its size."""
_APPARENT = 0.2
"""Standard deviation of an apparent inertia over ``k_p T``."""
_WEIGHT = 0.2
"""Weight of an unknown tool mass before anything was measured, at a metre, over the largest dry friction: standard
deviation. What is lighter is no more than friction's own changes leave."""
_FARTHEST = 4.0
"""Bound of the mass in these standard deviations."""
_ACCELERATING = 0.03
"""Share of the torque for acceleration that identified masses and rotors may be wrong by: standard deviation."""


@dataclass(frozen=True)
class FrictionFactors:
    """What adaptation knows.

    Attributes:
        theta: factors on dry friction and on what rises with speed ``(n, 2)``.
        apparent: inertia that torques show beyond the model's, over ``k_p T`` ``(n,)``.
        mass: that the tool has beyond the model [kg].
        curve: friction beyond the factors', over dry friction, at the nodes ``SPEEDS`` of ``friction_curve``
            ``(n, K)``; K = 0 where none is learned.
        covariance: of the factors, joint by joint, the apparent inertias, the mass and the curves
            ``(3 n + 1 + K n, 3 n + 1 + K n)``.
        q, tau: last measurements ``(m, n)`` with ``m`` up to the window, contact torque taken away.
        z: how far friction had turned then ``(m, n)``, -1 to 1.
        rejected: measurements in a row that did not count, per joint ``(n,)``.
        used: measurements that counted, per joint ``(n,)``.
    """

    theta: Array
    apparent: Array
    mass: float
    curve: Array
    covariance: Array
    q: Array
    tau: Array
    z: Array
    rejected: Array
    used: Array


class FrictionAdaptation:
    """Recursive least squares on the friction factors of every joint, the mass at the tool and, if wanted, a curve.

    Args:
        loop: the identified loop; its rigid body, rotors and friction are the reference.
        memory: time over which old measurements lose their weight [s] of informative motion; with a curve they lose it
            by drift alone.
        bounds: lowest and highest factor.
        noise: standard deviation of the torque residual relative to dry friction.
        gate: residuals beyond this many standard deviations do not count.
        drift: how fast the factors may wander, standard deviation after one second; the mass in its own standard
            deviation.
        tool: where in the last joint's frame the mass is ``(3,)`` [m]; no mass is learned if None: on the axes of a
            wrist it hardly differs from what inertias may be wrong by.
        curve: whether what the factors' law lacks over speed is learned from the torques.
        noise_std: what the model left of the torques that it was identified from ``(n,)`` [N m]; a residual is at least
            as uncertain. Where friction is small, it is not what torques are wrong by.
    """

    def __init__(self, loop: LoopModel, *, memory: float = 20.0, bounds: tuple[float, float] = (0.3, 3.0),
                 noise: float = 0.15, gate: float = 4.0, drift: float = 0.02,
                 tool: Array | None = None, curve: bool = False, noise_std: Array | None = None) -> None:
        self.loop, self.bounds, self.gate = loop, bounds, gate
        self._nodes = len(SPEEDS) if curve else 0
        self._kilogram = point_mass(loop.chain, np.zeros(3) if tool is None else tool)
        # Factors and a curve hardly differ at any one speed: forgetting lets them wander off against each other.
        self._forgetting = 1.0 if curve else np.exp(-loop.t_ipo / memory)
        self._dry = loop.friction_torque[:, 0]
        self._mean_dry = dry = np.maximum(self._dry.mean(axis=0), 1e-6)
        self._mass = 0.0 if tool is None else unknown_mass(dry)
        # All joints ask for the mass's drift in every cycle.
        self._drift = drift**2 * loop.t_ipo * np.array([1.0, 1.0, self._mass**2 / loop.n])
        self._alike = likeness()[: self._nodes, : self._nodes]
        self._curve_drift = (SHAPE * drift) ** 2 * loop.t_ipo * self._alike
        self._v_max = largest_speeds(loop.v_max)
        self._table = table_of(loop)
        # Neighbouring windows share most of their samples: what they say is worth about a third of independent ones.
        self._sigma = np.sqrt(3.0) * np.maximum(noise * dry, 0.0 if noise_std is None else noise_std)
        # Slower than this a window is not long against presliding's few tenths of a milliradian. Joints that hardly
        # move on a path slide slowly all the time: what they say is all that is known of friction where they work.
        self._slow = 0.005 * np.where(np.isfinite(loop.v_max), loop.v_max, 1.0)
        self._apparent = loop.k_p * loop.t_ipo
        self._grown = grown_friction(loop)
        self._window = SmoothedWindow(loop)
        most = np.concatenate([np.full(loop.n, _FARTHEST * _APPARENT), [_FARTHEST * self._mass]])
        largest = np.full(loop.n * self._nodes, LARGEST)
        self._low = np.concatenate([np.full(2 * loop.n, bounds[0] - 1.0), -most, -largest])
        self._high = np.concatenate([np.full(2 * loop.n, bounds[1] - 1.0), most, largest])

    def init(self) -> FrictionFactors:
        """Factors 1, believed as far as friction changes, no mass, and curves of nothing."""
        n = self.loop.n
        shared, own = np.diag(np.square(_SHARED)), np.diag(np.square(_OWN))
        covariance = linalg.block_diag(np.kron(np.ones((n, n)), shared) + np.kron(np.eye(n), own),
                                       np.diag([*[_APPARENT**2] * n, self._mass**2]),
                                       np.kron(np.eye(n), SHAPE**2 * self._alike))
        return FrictionFactors(np.ones((n, 2)), np.zeros(n), 0.0, np.zeros((n, self._nodes)), covariance,
                               np.empty((0, n)), np.empty((0, n)), np.empty((0, n)), np.zeros(n), np.zeros(n))

    def friction(self, state: FrictionFactors) -> dict[str, Array]:
        """Friction fields of the loop with what was learned applied."""
        fields = adapted(self.loop, state.theta)
        if self._nodes:
            more = tabled(self._table, state.curve, self._mean_dry)
            fields["friction_torque"] = np.maximum(fields["friction_torque"] + more, 0.0)
        return fields

    def carried(self, mass: float) -> Chain | None:
        """The tool's mass beyond the model's as a body; None for none."""
        return self._kilogram._replace(mass=mass * self._kilogram.mass) if mass != 0.0 else None

    def update(self, state: FrictionFactors, measured: RobotState, tau_ext: Array | None = None) -> FrictionFactors:
        """Takes what the controller reported at the end of one cycle.

        Args:
            state: before the cycle.
            measured: motor angles and torques.
            tau_ext: joint torque of contact that was expected ``(n,)`` [N m]; None for none.
        """
        q, tau = np.asarray(measured.q, dtype=float), np.asarray(measured.tau, dtype=float)
        n = self.loop.n
        if q.shape != (n,) or tau.shape != (n,) or not (np.isfinite(q).all() and np.isfinite(tau).all()):
            # A hole in the measurements: the window starts anew, the factors stay.
            return replace(state, q=np.empty((0, n)), tau=np.empty((0, n)), z=np.empty((0, n)))
        if tau_ext is not None:
            tau = tau + self.loop.gain * tau_ext
        z = self._window.turned(state.z[-1], q - state.q[-1]) if len(state.q) else np.zeros(n)
        window_z = np.concatenate([state.z, z[None]])[-CYCLES:]
        window_q = np.concatenate([state.q, q[None]])[-CYCLES:]
        window_tau = np.concatenate([state.tau, tau[None]])[-CYCLES:]
        state = replace(state, q=window_q, tau=window_tau, z=window_z)
        if len(window_q) < CYCLES:
            return state
        return self._with_window(state)

    def _with_window(self, state: FrictionFactors) -> FrictionFactors:
        loop, n = self.loop, self.loop.n
        seen = self._window.of(state.q, state.tau, state.z)
        speed = seen.motor_v
        if np.any(np.abs(speed) > 1.5 * loop.v_max) or np.any(np.abs(state.q[CYCLES // 2] - seen.q) > 2e-2):
            return state
        at = seen.q[None], seen.v[None]
        rigid = inverse_dynamics(loop.chain, *at, seen.a[None])[0]
        steady = inverse_dynamics(loop.chain, *at, np.zeros((1, n)))[0]
        further = further_torque(loop, np.zeros(1), *at, seen.motor_a[None], rigid[None], np.sign(speed)[None])[0]
        accelerating = rigid - steady + loop.rotor_inertia * seen.motor_a
        left = (seen.tau - further) / loop.gain - steady - accelerating - loop.offset
        variance = self._sigma**2 + (_ACCELERATING * accelerating) ** 2
        per_kilogram = inverse_dynamics(self._kilogram, *at, seen.a[None])[0]
        x = np.concatenate([(state.theta - 1.0).ravel(), state.apparent, [state.mass], state.curve.ravel()])
        at_nodes = between_nodes(np.abs(speed) / self._v_max) if self._nodes else np.empty((n, 0))
        covariance, rejected, used = state.covariance, state.rejected.copy(), state.used.copy()
        for i in range(n):
            v = speed[i]
            z = seen.z[i]
            if abs(v) < self._slow[i] or z * np.sign(v) < _SLIDES:
                continue
            side = 0 if v > 0 else 1
            by_load = friction_of_load(loop.friction_load[i], loop.friction_driven[i], rigid[i], v)
            table = float(np.interp(abs(v), loop.friction_velocity[:, i], loop.friction_torque[side, :, i]))
            grown = float(np.interp(abs(v), loop.friction_velocity[:, i], self._grown[side, :, i]))
            h, (own, curve) = np.zeros(len(x)), self._places(i)
            h[own] = z * np.array([self._dry[side, i] + by_load, grown])
            h[2 * n + i], h[3 * n] = self._apparent[i] * seen.motor_a[i], per_kilogram[i]
            h[curve] = z * self._mean_dry[i] * at_nodes[i]
            P = self._aged(covariance, i)
            innovation, said = left[i] - z * (table + by_load) - h @ x, P @ h
            S = float(h @ said) + variance[i]
            if innovation**2 > self.gate**2 * S:
                rejected[i] += 1
                continue
            x = np.clip(x + said / S * innovation, self._low, self._high)
            covariance = P - np.outer(said, said) / S
            rejected[i], used[i] = 0, used[i] + 1
        return replace(state, theta=1.0 + x[: 2 * n].reshape(-1, 2), apparent=x[2 * n : 3 * n],
                       mass=float(x[3 * n]), curve=x[3 * n + 1 :].reshape(n, -1), covariance=covariance,
                       rejected=rejected, used=used)

    def _places(self, joint: int) -> tuple[slice, slice]:
        """Where among the parameters a joint's two factors and its curve are."""
        curve = 3 * self.loop.n + 1 + joint * self._nodes
        return slice(2 * joint, 2 * joint + 2), slice(curve, curve + self._nodes)

    def _aged(self, covariance: Array, joint: int) -> Array:
        """Covariance before the next measurement of a joint: its factors forgotten and wandered a little.

        The mass is not forgotten, as it does not change by itself.
        """
        P, (own, curve) = covariance.copy(), self._places(joint)
        # Without information forgetting would let the covariance grow for ever.
        scale = np.sqrt(min(1.0 / self._forgetting, 0.5 / float(np.trace(P[own, own]))))
        P[own] *= scale
        P[:, own] *= scale
        at = np.array([own.start, own.start + 1, 3 * self.loop.n])
        P[at, at] += self._drift
        P[curve, curve] += self._curve_drift
        return P


@dataclass(frozen=True)
class AdaptedState:
    """State of the feedforward, what it has learned, and the contact torque that it was last told ``(n,)`` [N m]."""

    ideal: IdealState
    factors: FrictionFactors
    curve: CurveState | None
    tau_ext: Array | None = None


class AdaptedIdeal(Feedforward):
    """The ideal robot whose friction and tool mass follow the arm. Without ``observe`` it is the ideal robot.

    How far a mass that was learned bends the gears is left out: a camera calibrated with the tool on has seen that.

    Args:
        ideal: what is adapted.
        adaptation: how.
        known: what to start with; factors 1, believed to 15 %, and no mass if None.
        curve: learns what the law's shape lacks over speed; nothing does if None. For paths known beforehand: one
            that is planned anew all the time leaves following errors that are not friction's.
        known_curve: what that starts with; nothing if None.
    """

    def __init__(self, ideal: IdealRobot, adaptation: FrictionAdaptation | None = None,
                 known: FrictionFactors | None = None, curve: FrictionCurve | None = None,
                 known_curve: CurveState | None = None) -> None:
        self.ideal, self.known, self.curve, self.known_curve = ideal, known, curve, known_curve
        self.adaptation = FrictionAdaptation(ideal.loop) if adaptation is None else adaptation
        self.n_d, self.t_ipo = ideal.n_d, ideal.t_ipo

    def init(self, q0: Array, factors: FrictionFactors | None = None) -> AdaptedState:
        """At rest at ``q0``, with what is known from before, if anything."""
        factors = self.known if factors is None else factors
        return AdaptedState(self.ideal.init(q0), self.adaptation.init() if factors is None else factors,
                            None if self.curve is None else self.curve.init(self.known_curve))

    def observe(self, state: AdaptedState, measured: RobotState) -> AdaptedState:
        """Takes what the controller reported at the end of a cycle."""
        curve = state.curve
        if self.curve is not None and curve is not None:
            curve = self.curve.update(curve, measured.q)
        return replace(state, factors=self.adaptation.update(state.factors, measured, state.tau_ext), curve=curve)

    def step(self, state: AdaptedState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, AdaptedState]:
        """See ``Feedforward.step``."""
        factors, inner = state.factors, state.ideal
        carried = self.adaptation.carried(factors.mass)
        if inner.cycle == 0:
            # The motors hold already at rest what was learned before the first step.
            inner = self.ideal.init(inner.q_d[-1], carried)
        change = self.adaptation.friction(factors)
        curve, inertia = state.curve, None
        if self.curve is not None and curve is not None:
            change["friction_torque"] = change["friction_torque"] + self.curve.torque(curve)
            inertia = self.curve.inertia(curve)
        drives = self.ideal.drives._replace(**change)
        q_c, inner = self.ideal.step_with(drives, inner, q_d, tau_ext_d, carried, inertia)
        if self.curve is not None and curve is not None:
            curve = self.curve.planned(curve, inner)
        return q_c, AdaptedState(inner, factors, curve,
                                 None if tau_ext_d is None else np.array(tau_ext_d[0]))


def unknown_mass(dry: Array) -> float:
    """How heavy a tool may be beyond the model's before anything was measured: standard deviation [kg].

    Args:
        dry: dry friction ``(n,)`` [N m].
    """
    return float(_WEIGHT * dry.max() / _GRAVITY)


def adapted(loop: LoopModel, theta: Array) -> dict[str, Any]:
    """Friction fields of a loop model with the factors ``theta (n, 2)`` applied."""
    more = (theta[:, 0] - 1.0) * loop.friction_torque[:, :1] + (theta[:, 1] - 1.0) * grown_friction(loop)
    return {"friction_torque": np.maximum(loop.friction_torque + more, 0.0),
            "friction_load": theta[:, 0] * loop.friction_load, "friction_driven": theta[:, 0] * loop.friction_driven}


def grown_friction(loop: LoopModel) -> Array:
    """What the second factor counts, in the loop's table of friction ``(2, m, n)`` [N m].

    It rises with the root of speed to as much as dry friction. The identified friction less its dry part has not this
    form: at low speed a gear's friction falls before it rises, and what of it rises does not show by itself.
    """
    shares = loop.friction_velocity / largest_speeds(loop.v_max)
    return np.asarray(loop.friction_torque[:, :1] * np.sqrt(shares))
