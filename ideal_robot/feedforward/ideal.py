"""The ideal robot: everything that is known of the arm, inverted over the horizon, for paths never moved before.

An arm with elastic gears under a cascaded controller is flat: the wanted arm angles and their derivatives decide all
the rest, from the gear torque back to the command. Step by step, along [G] (8), (18)–(20) and [L] 2.2:

    τ_g = M(q_d) q̈_d + c + g - τ_ext            gear torque, [G] (5)
    q_m = q_d + τ_g / k                          motor angle behind the elastic gear; with play, and turned unevenly
    τ_d = τ_g + J q̈_m + τ_f(q̇_m) + τ_r(q_m)       motor torque, [G] (8), with ripple and further effects where known
    τ̇_d = k_p u̇ + k_i u                         velocity loop inverted, [G] (17), (18)
    k_v r + k_ff ṙ = u + q̇_m + k_v q_m           position loop inverted, [G] (16), (19)
    r = low-pass(interpolation(q_c(k - delay)))  command path inverted by least squares over the horizon
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ideal_robot.arrays import Array, interpolated
from ideal_robot.dynamics.newton_euler import inverse_dynamics, inverse_dynamics_with_point
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import SETTLE, Feedforward
from ideal_robot.feedforward.precorrection import command_inverse, spline_operators
from ideal_robot.jit import jit
from ideal_robot.loop.from_model import further_torque, loop_model
from ideal_robot.loop.loop_model import (
    Drives,
    LoopModel,
    behind_uneven_gears,
    friction_along,
    ripple_torque,
    unevenness,
)
from ideal_robot.model.arm_with_effects import side_of_gap
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot

_CYCLES = 7
"""Commands solved for together: what lies further ahead changes the first one by less than 1e-4 of itself."""
_BEFORE = 6
"""Desired positions kept from the cycles before, for the derivatives."""
_AFTER = 4
"""Desired positions wanted beyond the last one used, for the same reason."""
_CUTOFF = 14.0
"""Frequencies of the desired path above this are not asked of the arm [Hz]."""
_STILL = 1e-3
"""Velocity below which a joint counts as at rest, where its friction jumps [rad/s]."""


@dataclass(frozen=True)
class IdealState:
    """What one cycle hands to the next.

    Attributes:
        q_d: desired positions of the cycles before ``(_BEFORE, n)``.
        q_c: commands of the cycles before ``(P, n)``, newest last.
        u, tau: velocity-loop error and motor torque planned so far ``(n,)``.
        bent: dry friction over its identified size ``(n,)``: how far its bristles are bent.
        q_m, v_m, turned: motor angles and velocities planned for the end of the cycle in which the last command acts,
            and how far friction has turned since the last reversal then, -1 to 1, each ``(n,)`` [rad, rad/s, 1].
        sag: gear deflection under gravity at the start, not yet compensated ``(n,)`` [rad].
        cycle: cycles since the start.
    """

    q_d: Array
    q_c: Array
    u: Array
    tau: Array
    q_m: Array
    v_m: Array
    turned: Array
    bent: Array
    sag: Array
    cycle: int


class Carried(NamedTuple):
    """A mass [kg] at a place of the last joint's frame ``(3,)`` [m]."""

    mass: float
    place: Array


class IdealRobot(Feedforward):
    """Inverse of the identified closed loop over the horizon.

    Args:
        loop: the identified closed loop; see :func:`ideal_robot.loop.from_model.loop_model`.
        n_d: length of the horizon it is given; with fewer than ``n_d_needed`` rows the path is continued with constant
            acceleration.
        elastic: whether gear deflection is compensated. Then the command at rest differs from the desired position
            by the deflection under gravity; without, by nothing.
    """

    def __init__(self, loop: LoopModel, n_d: int = 30, *, elastic: bool = True) -> None:
        if n_d < 1:
            raise InputError("the horizon needs at least one row", field="n_d", value=n_d)
        self.loop, self.n_d, self.t_ipo, self.elastic = loop, n_d, loop.t_ipo, elastic
        T, fine = loop.t_ipo, loop.t_position
        self.n_d_needed = loop.delay + _CYCLES + _AFTER + 1
        t_rows = T * np.arange(-_BEFORE, self.n_d_needed, dtype=float)
        # Torque on a grid of half cycles, a cycle wider than needed: its derivatives follow from it.
        t_coarse = T * (loop.delay - 2 + 0.5 * np.arange(2.0 * (_CYCLES + 4) + 1))
        # A position-loop output acts on average half its cycle later: torques are wanted there.
        t_fine = T * loop.delay + fine * (np.arange(float(loop.steps_ipo * _CYCLES)) + 0.5)
        self._t_fine = t_fine
        self._coarse = spline_operators(t_rows, t_coarse, T, _CUTOFF)
        self._fine = _Operators(*spline_operators(t_rows, t_fine, T, _CUTOFF))
        self._torque = _Operators(*spline_operators(t_coarse, t_fine, T, _CUTOFF))
        self._inverse = command_inverse(loop, _CYCLES)
        self._compliance = loop.compliance if elastic else np.zeros(loop.n)
        self._damped = np.where(np.isfinite(loop.stiffness), loop.damping, 0.0) * self._compliance**2
        self._gap = loop.half_gap if elastic else np.zeros(loop.n)
        self._gaps = bool(self._gap.any())
        self._lag = loop.t_filter + 0.5 * loop.t_velocity
        self.drives = loop.drives(loop.stiffness, loop.damping)
        self._step_max = 1.5 * loop.v_max * T

    @classmethod
    def of(cls, model: Model, robot: Robot, n_d: int = 30, *, delay: int | None = None, **options: Any) -> IdealRobot:
        """From an identified model: see ``loop_model`` for ``delay`` and the class for ``n_d`` and the other options.

        Args:
            model, robot, delay: as of ``loop_model``.
            n_d, options: as of the class.
        """
        return cls(loop_model(model, robot, delay=delay), n_d, **options)

    def init(self, q0: Array, carried: Carried | None = None) -> IdealState:
        """See ``Feedforward.init``; ``carried`` as in ``step_with``."""
        q0 = np.array(q0, dtype=float)
        loop, still = self.loop, np.zeros((1, self.loop.n))
        load, more = self._load(q0[None], still, still, carried)
        gravity = load[0]
        further = further_torque(loop, np.zeros(1), q0[None], still, still, gravity[None], still)[0]
        held = gravity if more is None else gravity + more[0]
        sag = gravity * self._compliance + self._gap * side_of_gap(gravity, still[0], loop.gap_load)
        sag -= [unevenness(loop.uneven, i, float(q))[0] for i, q in enumerate(q0)]
        return IdealState(
            q_d=np.tile(q0, (_BEFORE, 1)), q_c=np.tile(q0, (self._inverse.n_past, 1)), u=np.zeros(loop.n),
            tau=loop.gain * (held + loop.offset) + further, q_m=q0, v_m=np.zeros(loop.n),
            turned=np.zeros(loop.n), bent=np.zeros(loop.n), sag=sag, cycle=0)

    def step(self, state: IdealState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, IdealState]:
        """See ``Feedforward.step``."""
        return self.step_with(self.drives, state, q_d, tau_ext_d)

    def step_with(self, drives: Drives, state: IdealState, q_d: Array, tau_ext_d: Array | None = None,
                  carried: Carried | None = None, inertia: Array | None = None) -> tuple[Array, IdealState]:
        """``step`` with other drives than the identified ones, for adaptation.

        Args:
            drives: parameters of the drives.
            state, q_d, tau_ext_d: as of ``step``.
            carried: what the motors carry beyond the model's bodies. How far it bends the gears is left out.
            inertia: what the drives feel of the joints' accelerations beyond the model's ``(n, n)`` [kg m²].
        """
        loop = self.loop
        q_d = self._checked(q_d)
        rows = np.concatenate([state.q_d, self._horizon(q_d, state.q_d)])
        q, qd, qdd = (operator @ rows for operator in self._coarse)
        load, more = self._load(q, qd, qdd, carried)
        if tau_ext_d is not None:
            load -= self._external(np.asarray(tau_ext_d, dtype=float))
        gears = self._torque.of(load)
        motors = self._fine.of(rows) + self._compliance * gears
        if self.elastic:
            motors[0] -= self._damped * gears[1]
        if self._gaps:
            motors += self._torque.of(self._gap * side_of_gap(load, qd, loop.gap_load))
        gear, (q_m, v_m, a_m) = gears[0], motors
        reflected = gear
        if len(loop.uneven):
            output = v_m
            q_m, v_m, a_m = behind_uneven_gears(loop.uneven, q_m, v_m, a_m)
            # A gear that turns faster than its motor hands more of its torque on to it.
            reflected = gear * np.divide(output, v_m, out=np.ones_like(v_m), where=np.abs(v_m) > 1e-6)
        self._take_up(state, q_m, v_m)
        smooth = reflected + drives.rotor_inertia * a_m + loop.offset
        if inertia is not None:
            smooth = smooth + a_m @ inertia.T
        if more is not None:
            smooth = smooth + self._torque.value @ more
        friction, bent, turned = friction_along(drives, v_m, gear, loop.t_position, state.bent, _STILL)
        further = further_torque(loop, state.cycle * self.t_ipo + self._t_fine, q_m, v_m, a_m, gear, turned)
        signal, u, tau = _position_loop_signal(drives, (q_m, v_m, a_m), (smooth + friction, further), self._lag,
                                               loop.t_position, loop.steps_ipo, (state.u, state.tau))
        last = loop.steps_ipo - 1
        # Half a step on from the middle of the last one.
        reached = q_m[last] + 0.5 * loop.t_position * v_m[last]
        q_c = _command(self._inverse.wanted, signal, self._inverse.past, state.q_c, self._step_max, loop.q_min,
                       loop.q_max)
        return q_c, IdealState(np.concatenate([state.q_d[1:], q_d[:1]]), np.concatenate([state.q_c[1:], q_c[None]]),
                               u, tau, reached, v_m[last], turned[last], bent[last], state.sag, state.cycle + 1)

    def _checked(self, q_d: Array) -> Array:
        """A horizon's positions ``(n_d, n)``; InputError where they are none."""
        q_d = np.asarray(q_d, dtype=float)
        if q_d.ndim != 2 or q_d.shape[1] != self.loop.n or len(q_d) == 0 or not np.isfinite(q_d).all():
            raise InputError(f"expected finite desired positions of shape (n_d, {self.loop.n})", field="q_d",
                             value=q_d.shape)
        return q_d

    def _take_up(self, state: IdealState, q_m: Array, v_m: Array) -> None:
        """Takes the deflection at the start up smoothly, from nothing to all, in the motors' motion ``(N, n)``."""
        begun = (state.cycle * self.t_ipo + self._t_fine) / SETTLE
        if begun[0] < 1.0:
            remaining = 1.0 - np.minimum(begun, 1.0)[:, None]
            q_m -= state.sag * remaining**3 * (10.0 - 15.0 * remaining + 6.0 * remaining**2)
            v_m += state.sag * 30.0 * remaining**2 * (1.0 - remaining) ** 2 / SETTLE

    def _load(self, q: Array, qd: Array, qdd: Array, carried: Carried | None) -> tuple[Array, Array | None]:
        """Torques of the model's bodies and of what is carried beyond them, each ``(N, n)`` [N m]."""
        if carried is None:
            return inverse_dynamics(self.loop.chain, q, qd, qdd), None
        load, kilogram = inverse_dynamics_with_point(self.loop.chain, carried.place, q, qd, qdd)
        return load, carried.mass * kilogram

    def _horizon(self, q_d: Array, before: Array) -> Array:
        if len(q_d) >= self.n_d_needed:
            return q_d[: self.n_d_needed]
        last = np.concatenate([before, q_d])[-3:]
        speed, bend = last[2] - last[1], last[2] - 2.0 * last[1] + last[0]
        ahead = np.arange(1, self.n_d_needed - len(q_d) + 1)[:, None]
        return np.concatenate([q_d, q_d[-1] + ahead * speed + 0.5 * ahead * (ahead + 1) * bend])

    def _external(self, tau_ext_d: Array) -> Array:
        """The contact torque on the torque grid, linear in between and constant beyond the horizon."""
        t = np.arange(len(tau_ext_d)) * self.t_ipo
        grid = self.t_ipo * (self.loop.delay - 2 + 0.5 * np.arange(2 * (_CYCLES + 4) + 1))
        return interpolated(grid, t, tau_ext_d)


class _Operators:
    """Matrices that give a spline's values (``value``) and its first two derivatives, applied together."""

    def __init__(self, value: Array, first: Array, second: Array) -> None:
        self.value, self._together = value, np.concatenate([value, first, second])

    def of(self, rows: Array) -> Array:
        """Values and derivatives of rows ``(m, n)``, shape ``(3, k, n)``."""
        return (self._together @ rows).reshape(3, -1, rows.shape[1])


@jit()
def _command(wanted: Array, signal: Array, past: Array, q_c: Array, step_max: Array, q_min: Array, q_max: Array
             ) -> Array:
    """The command ``(n,)`` [rad] that makes the position loop see its signal ``(N, n)``, within the limits."""
    command = np.empty(len(q_min))
    for i in range(len(q_min)):
        ahead, behind = 0.0, 0.0
        for j in range(wanted.shape[1]):
            ahead += wanted[i, j] * signal[j, i]
        for j in range(past.shape[1]):
            behind += past[i, j] * q_c[j, i]
        before = q_c[len(q_c) - 1, i]
        within = min(max(ahead + behind, before - step_max[i]), before + step_max[i])
        command[i] = min(max(within, q_min[i]), q_max[i])
    return command


@jit()
def _position_loop_signal(drives: Drives, motion: tuple[Array, Array, Array], torques: tuple[Array, Array], lag: Array,
                          t_position: float, steps: int, before: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """The signal ``k_v r + k_ff ṙ`` the position loop must see, and the recursions' values one cycle on.

    ``motion`` is that of the motors; ``torques`` the motor torque with friction, without ripple, and that of other
    effects, all ``(m, n)``; ``before`` the recursions' values u and τ.
    """
    (q_m, v_m, a_m), (acting, further), (u0, tau0) = motion, torques, before
    N, n = q_m.shape
    signal = np.empty((N, n))
    u_next, tau_next = u0.copy(), tau0.copy()
    k_p, k_i = drives.k_p, drives.k_i
    for i in range(n):
        u, tau = u0[i], tau0[i]
        half = 0.5 * k_i[i] * t_position
        for j in range(N):
            v = v_m[j, i]
            wanted = drives.gain[i] * (acting[j, i] + ripple_torque(drives.ripple, i, q_m[j, i])) + further[j, i]
            # [G] (18) with the trapezoidal rule: k_p Δu + k_i T (u + u_before)/2 = Δτ.
            u = (wanted - tau + u * (k_p[i] - half)) / (k_p[i] + half)
            tau = wanted
            # [G] (19), half a position cycle back to the instant at which the position is compared.
            measured = v - lag[i] * a_m[j, i]
            signal[j, i] = u + measured + drives.k_v[i] * (q_m[j, i] - 0.5 * t_position * v)
            if j == steps - 1:
                u_next[i], tau_next[i] = u, tau
    return signal, u_next, tau_next
