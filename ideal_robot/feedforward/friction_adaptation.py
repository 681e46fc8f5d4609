"""Adaptation of friction and of the tool's mass during the run ([L] Fig. 1, [G] Figs 3 and 12).

Friction changes with temperature and lubricant, and a tool may be heavier than stated; arm and controller do not
change. From motor angles and torques, smoothed alike (``smoothed_window``), adaptation learns by the recursion of
``estimate.recursive`` friction's terms of every joint, an apparent inertia per joint, and one mass at the tool:

    τ_a - τ_rigid - J q̈_m - τ_offset - τ_f(q̇_m) = z (F(0) f(s) + θ_1 F_load) + c k_p T q̈_m
                                                    + m y(q, q̇, q̈)
    f(s) = θ_1 + θ_2 √s + Σ_k c_k φ_k(s)

with s the speed over the largest and F_load what the load on the gear's teeth adds to friction. Friction turns round
with the motion and is each joint's own; a weight does not, and shows in all joints as its lever has it.

Commands are joined by straight lines: at the end of each cycle T the wanted speed jumps by q̈ T, and with it the
torque, by up to k_p T q̈. A torque that is read there shows less inertia than there is; it would be taken for less
friction at low speed and more at high. That is c, and what rotors were identified wrong by besides; nothing is
commanded for it. What other inertias are wrong by is counted to a sample's variance.

Before anything was measured all joints are thought to have changed together: an arm is cold as a whole.

Safe by construction: without measurements nothing changes, bit for bit; samples that are not finite, too slow or far
from what is expected are not used; all that is learned is bounded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import (
    Chain,
    frames_of,
    inverse_dynamics,
    joint_frames,
    point_mass,
    torque_at,
)
from ideal_robot.estimate.recursive import predict, update
from ideal_robot.feedforward.base import FASTEST, Feedforward
from ideal_robot.feedforward.friction_curve import CurveState, FrictionCurve
from ideal_robot.feedforward.inverse import Carried, Inverse, InverseState
from ideal_robot.feedforward.learned_friction import (
    INTERVAL,
    SLIDES,
    SLOWEST,
    noise_variance,
    process_correlation,
    unknown_mass,
)
from ideal_robot.feedforward.smoothed_window import CYCLES, Smoothed, Window, noted, smoothed
from ideal_robot.friction.table import Friction, friction_sizes, friction_step, largest_speeds
from ideal_robot.friction.terms import OWN, SHARED, TERMS, dry_sizes, table_terms, terms_along, with_terms
from ideal_robot.jit import jit
from ideal_robot.loop.loop import Drives, Loop, further_torque
from ideal_robot.robots.interface import RobotState
from ideal_robot.tolerances import MEASURED_SPACING

_APPARENT = 12.0**-0.5
"""Standard deviation of an apparent inertia over ``k_p T``: torques are read anywhere in the jump."""
_ACCELERATING = 0.03
"""Share of the torque for acceleration that identified masses and rotors may be wrong by: standard deviation."""
_OWN, _COMMON = TERMS + 1, 3
"""Parameters of each joint, friction's terms and the apparent inertia; behind those of all joints the ones that they
share: the dry and the rising term, and the mass."""
_LAG = 2e-2
"""How far arm and motor, or smoothed and measured, may be apart [rad]; what is further is no motion of an arm."""


class _Measured(NamedTuple):
    """Signals of one cycle: motor angles [rad], motor torques and joint torques of contact [N m], ``(n,)`` each."""

    q: Array
    tau: Array
    tau_ext: Array


class _Estimate(NamedTuple):
    """``x``, ``covariance``, ``used`` and ``load`` of ``FrictionFactors``, written to."""

    x: Array
    covariance: Array
    used: Array
    load: Array


class FrictionFactors(NamedTuple):
    """Estimated deviations of friction and tool mass.

    Attributes:
        x: parameters: each joint's own, and those that all joints share ``(p,)``.
        covariance: of them ``(p, p)``.
        values: of friction's terms ``(n, TERMS)``.
        mass: mass of the tool beyond the model's [kg].
        friction: of the loop with them, see ``friction.terms.with_terms``.
        load: torque that the gears transmitted in the middle of the last window ``(n,)`` [N m].
        used: number of used measurements per joint ``(n,)``.
        window: last measurements.
        waiting: measurements that the estimate does not contain yet: motor angles, motor torques, joint torques of
            contact.
        cycle: cycles since the start.
        t: of the last measurement [s]; not a number before the first.
    """

    x: Array
    covariance: Array
    values: Array
    mass: float
    friction: Friction
    load: Array
    used: Array
    window: Window
    waiting: tuple[_Measured, ...] = ()
    cycle: int = 0
    t: float = np.nan


class _Known(NamedTuple):
    """What the compiled recursion needs: records of the loop, prior and noise.

    Attributes:
        chain, drives, friction: of the loop.
        place: where in the last joint's frame the mass is ``(3,)`` [m].
        spacing: time between measurements [s].
        terms: of ``table_terms``.
        dry: dry friction ``(n,)`` [N m].
        v_max: largest speeds that friction is looked at over, and that can be ``(2, n)`` [rad/s].
        apparent: standard deviation of an apparent inertia ``(n,)`` [kg m²].
        mass: standard deviation of the mass [kg].
        variance: of a torque's noise ``(n,)`` [(N m)²]. The mean over a window has less, but windows overlap: what many
            of them say of a parameter has the noise of as many torques.
        correlation: of parameters with themselves one window later.
    """

    chain: Chain
    drives: Drives
    friction: Friction
    place: Array
    spacing: float
    terms: Array
    dry: Array
    v_max: Array
    apparent: Array
    mass: float
    variance: Array
    correlation: float


class FrictionAdaptation:
    """Estimates friction of every joint and the mass at the tool from motor torques.

    Args:
        loop: the identified loop; its rigid body, rotors and friction are the reference.
        tool: place of the mass in the last joint's frame ``(3,)`` [m]; None learns no mass, as on the axes of a wrist
            it is hardly distinguishable from errors of inertias.
        noise_std: the model's torque residual in the identification ``(n,)`` [N m]; see
            ``learned_friction.noise_variance``.
    """

    def __init__(self, loop: Loop, *, tool: Array | None = None, noise_std: Array | None = None) -> None:
        self.loop = loop
        self._every = max(1, round(MEASURED_SPACING / loop.t_ipo))
        spacing, dry = self._every * loop.t_ipo, dry_sizes(loop.friction)
        self._apart = max(1, round(INTERVAL / spacing))
        self._known = _Known(
            loop.chain, loop.drives, loop.friction, np.zeros(3) if tool is None else tool, spacing,
            table_terms(loop.friction, loop.path.v_max), dry,
            np.stack([largest_speeds(loop.path.v_max), FASTEST * loop.path.v_max]),
            _APPARENT * loop.cascade.k_p * loop.t_ipo,
            0.0 if tool is None else unknown_mass(dry),
            noise_variance(dry, self._apart * spacing, noise_std), process_correlation(self._apart * spacing))
        self._still = np.zeros(loop.n)

    def init(self) -> FrictionFactors:
        """The state before any measurement: friction as identified, and no mass."""
        n = self.loop.n
        p = n * _OWN + _COMMON
        return FrictionFactors(np.zeros(p), np.eye(p), np.zeros((n, TERMS)), 0.0, self._known.friction,
                               np.zeros(n), np.zeros(n), Window.empty(n))

    def begun(self, state: FrictionFactors) -> FrictionFactors:
        """The state without the last measurements, for the begin of a motion or after a gap."""
        return state._replace(window=state.window._replace(rows=0), waiting=(), cycle=0, t=np.nan)

    def more(self, friction: Friction, values: Array) -> Friction:
        """Friction of the loop with further values of friction's terms ``(n, TERMS)`` added."""
        return with_terms(friction, self._known.terms, values)

    def carried(self, state: FrictionFactors) -> Carried | None:
        """The tool's estimated mass beyond the model's; None for none."""
        return Carried(state.mass, self._known.place) if state.mass != 0.0 else None

    def update(self, state: FrictionFactors, measured: RobotState, tau_ext: Array | None = None) -> FrictionFactors:
        """The state updated by the controller's report at the end of a cycle.

        Args:
            state, measured: state before the cycle, and measured motor angles and torques.
            tau_ext: joint torque of contact that was expected ``(n,)`` [N m]; None for none.
        """
        # Copies, as the controller's driver may overwrite its arrays later.
        q, tau = np.array(measured.q, dtype=float), np.array(measured.tau, dtype=float)
        if q.shape != self._still.shape or tau.shape != self._still.shape:
            return self.begun(state)
        if not 0.5 < (measured.t - state.t) / self.loop.t_ipo < 1.5:
            # A window across two motions would not be a motion of the arm.
            state = self.begun(state)
        waiting = state.waiting
        if state.cycle % self._every == 0:
            waiting = (*waiting, _Measured(q, tau, self._still if tau_ext is None else tau_ext))
        if len(waiting) == self._apart:
            return self._with(state, np.array(waiting), measured.t)
        return state._replace(waiting=waiting, cycle=state.cycle + 1, t=measured.t)

    def _with(self, state: FrictionFactors, measured: Array, t: float) -> FrictionFactors:
        """What is known after measurements ``(m, 3, n)``, the last one at time ``t`` [s]."""
        drives, friction = self.loop.drives, self.loop.friction
        window = noted(state.window, measured, drives, friction, state.load, self._known.spacing)
        state = state._replace(window=window, waiting=(), cycle=state.cycle + 1, t=t)
        if window.rows < CYCLES:
            return state
        own = _Estimate(state.x.copy(), state.covariance.copy(), state.used.copy(), state.load.copy())
        informed = _learned(self._known, window, self._further(window) if self.loop.terms else self._still, own)
        state = state._replace(**own._asdict())
        if not informed:
            return state
        known = self._known
        values, friction = _applied(known.friction, known.terms, own.x)
        return state._replace(values=values, mass=known.mass * float(own.x[-1]), friction=friction)

    def _further(self, window: Window) -> Array:
        """Torque of further effects in the middle of a full window ``(n,)`` [N m]."""
        loop = self.loop
        motion = smoothed(window, loop.drives, self._known.spacing)
        rigid = inverse_dynamics(loop.chain, motion.q, motion.v, motion.a)
        sliding = np.sign(motion.motor_v)
        return np.asarray(further_torque(loop, np.zeros(1), motion.q, motion.v, motion.motor_a, rigid, sliding)[0])


@jit()
def _learned(known: _Known, window: Window, further: Array, estimate: _Estimate) -> bool:
    """Updates the estimate by a full window; whether any joint showed its friction in it.

    ``further (n,)`` [N m] is the torque of further effects in the middle of the window.
    """
    x, covariance, load, n = estimate.x, estimate.covariance, estimate.load, len(further)
    motion, informed = smoothed(window, known.drives, known.spacing), False
    speed = motion.motor_v[0]
    for i in range(n):
        if abs(speed[i]) > known.v_max[1, i] or abs(window.q[CYCLES // 2, i] - motion.q[0, i]) > _LAG:
            return False
    R, p = frames_of(known.chain)
    torques = np.empty((3, n))
    joint_frames(known.chain, motion.q[0], R, p)
    torque_at(known.chain, R, p, motion.v[0], motion.a[0], 1.0, torques[0])
    torque_at(known.chain, R, p, motion.v[0], np.zeros(n), 1.0, torques[1])
    torque_at(point_mass(known.chain, known.place), R, p, motion.v[0], motion.a[0], 1.0, torques[2])
    load[:] = torques[0]
    h, own = np.zeros(len(x)), 0
    predict(x, covariance, known.correlation)
    for i in range(n):
        size = friction_sizes(known.friction, i, speed[i], load[i])[0]
        z = motion.force[0, i] / size if size > 0.0 else np.sign(speed[i])
        if abs(speed[i]) < SLOWEST * known.v_max[0, i] or z * np.sign(speed[i]) < SLIDES:
            continue
        h[own : own + _OWN] = 0.0
        own = i * _OWN
        residual, accelerating = _row(known, motion, torques, i, z, h)
        variance = known.variance[i] + (_ACCELERATING * accelerating) ** 2
        if update(x, covariance, h, residual - further[i] / known.drives.gain[i], variance):
            estimate.used[i] += 1.0
            informed = True
    return informed


@jit()
def _row(known: _Known, motion: Smoothed, torques: Array, i: int, z: float, h: Array) -> tuple[float, float]:
    """What the model leaves of joint ``i``'s torque, and its torque for acceleration [N m].

    What the joint's parameters count is written to ``h (p,)``; ``torques (3, n)`` [N m] are of the rigid body, of it
    without acceleration, and of 1 kg at the tool; ``z`` is the direction of sliding.
    """
    v, dry, load = motion.motor_v[0, i], known.dry[i], torques[0, i]
    accelerating = load - torques[1, i] + known.drives.rotor_inertia[i] * motion.motor_a[0, i]
    friction, _ = friction_step(known.friction, i, v, load, motion.force[0, i], 0.0)
    by_load = friction_sizes(known.friction, i, v, load)[0] - friction_sizes(known.friction, i, v, 0.0)[0]
    own, common = h[i * _OWN :], h[len(h) - _COMMON :]
    terms_along(v / known.v_max[0, i], z, own)
    own[0] += z * by_load / dry
    for k in range(TERMS):
        own[k] *= dry
        if k < len(SHARED):
            common[k] = SHARED[k] * own[k]
        own[k] *= OWN[k]
    own[TERMS], common[2] = known.apparent[i] * motion.motor_a[0, i], known.mass * torques[2, i]
    return motion.tau[0, i] - torques[1, i] - accelerating - known.drives.offset[i] - friction, accelerating


@jit()
def _applied(friction: Friction, terms: Array, x: Array) -> tuple[Array, Friction]:
    """Values of friction's terms ``(n, TERMS)``, and friction with them, by the parameters ``x (p,)``."""
    n, common = len(terms), x[len(x) - _COMMON :]
    values = np.empty((n, TERMS))
    for i in range(n):
        values[i] = OWN * x[i * _OWN : i * _OWN + TERMS]
        values[i, :2] += SHARED * common[:2]
    return values, with_terms(friction, terms, values)


class AdaptedState(NamedTuple):
    """State of the feedforward, with its estimates.

    Attributes:
        ideal: of the ideal robot.
        factors: learned from torques.
        curve: learned from following errors; None where nothing is.
        friction: the friction that follows from both.
        tau_ext: last contact torque that it was given ``(n,)`` [N m].
    """

    ideal: InverseState
    factors: FrictionFactors
    curve: CurveState | None
    friction: Friction
    tau_ext: Array | None = None


class AdaptedIdeal(Feedforward):
    """The ideal robot with adapted friction and tool mass. Without ``observe`` it is the ideal robot.

    The gear deflection by a learned mass is not added, as a camera calibrated with the tool already contains it.

    Args:
        ideal: the ideal robot to be adapted.
        adaptation: method of adaptation.
        known: initial estimates; friction as identified and no mass if None.
        curve: estimates the rest from following errors; None for none. Only for paths known beforehand, as replanning
            causes following errors without friction.
        known_curve: its initial state; None for none.
        adapted: mask of joints ``(n,)`` in which learned friction and inertia are used; all if None.
    """

    def __init__(self, ideal: Inverse, adaptation: FrictionAdaptation | None = None,
                 known: FrictionFactors | None = None, curve: FrictionCurve | None = None,
                 known_curve: CurveState | None = None, adapted: NDArray[np.bool_] | None = None) -> None:
        self.ideal, self.known, self.curve, self.known_curve = ideal, known, curve, known_curve
        self.adapted = adapted
        self.adaptation = FrictionAdaptation(ideal.loop) if adaptation is None else adaptation
        self.n_d, self.t_ipo = ideal.n_d, ideal.t_ipo

    def init(self, q0: Array, factors: FrictionFactors | None = None) -> AdaptedState:
        """State at rest at ``q0``, with the factors of an earlier motion if there are any."""
        factors = self.known if factors is None else factors
        factors = self.adaptation.init() if factors is None else self.adaptation.begun(factors)
        curve = None if self.curve is None else self.curve.init(self.known_curve)
        return AdaptedState(self.ideal.init(q0), factors, curve, self._friction(factors, curve))

    def _friction(self, factors: FrictionFactors, curve: CurveState | None) -> Friction:
        friction, identified = factors.friction, self.ideal.loop.friction
        if self.curve is not None and curve is not None:
            friction = self.adaptation.more(friction, self.curve.values(curve))
        if self.adapted is not None:
            fields = [np.array(values) for values in friction]
            for values, own in zip(fields, identified, strict=True):
                values[~self.adapted] = own[~self.adapted]
            friction = Friction(*fields)
        return friction

    def observe(self, state: AdaptedState, measured: RobotState) -> AdaptedState:
        """The state after the controller's report at the end of a cycle."""
        factors = self.adaptation.update(state.factors, measured, state.tau_ext)
        curve, friction = state.curve, state.friction
        changed = factors.friction is not state.factors.friction
        if self.curve is not None and curve is not None:
            before, curve = curve.x, self.curve.update(curve, measured.q)
            changed = changed or curve.x is not before
        if changed:
            friction = self._friction(factors, curve)
        return AdaptedState(state.ideal, factors, curve, friction, state.tau_ext)

    def step(self, state: AdaptedState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, AdaptedState]:
        """The command of one interpolation cycle; see ``Feedforward.step``."""
        factors, curve, inner = state.factors, state.curve, state.ideal
        carried = self.adaptation.carried(factors)
        if inner.cycle == 0:
            # At rest the motors already hold the learned torque before the first step.
            inner = self.ideal.init(inner.q_d[-1], carried)
        inertia = None if curve is None else curve.inertia
        if inertia is not None and self.adapted is not None:
            inertia = self.adapted[:, None] * inertia
        q_c, inner = self.ideal.step_with(state.friction, inner, q_d, tau_ext_d, carried, inertia)
        if self.curve is not None and curve is not None:
            curve = self.curve.planned(curve, inner)
        return q_c, AdaptedState(inner, factors, curve, state.friction,
                                 None if tau_ext_d is None else np.array(tau_ext_d[0]))
