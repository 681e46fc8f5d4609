r"""The inverse of the identified closed loop: from desired positions over a horizon to the command.

An arm with elastic gears under a cascaded controller is flat: the desired arm angles and their derivatives determine
all the rest, from the gear torque back to the command. Step by step, along [G] (8), (18)-(20) and [L] 2.2:

    τ_g = M(q_d) q̈_d + c + g - τ_ext            gear torque, [G] (5)
    q_m = q_d + τ_g / k                          motor angle behind the elastic gear; with backlash and transmission
        error
    τ_d = τ_g + J q̈_m + τ_f(q̇_m) + τ_r(q_m)       motor torque, [G] (8), with ripple and further effects where known,
                                                 less what the drive compensates of friction by itself

What comes then is a setting.

*Complete* (``COMPLETE``): the loops at their own cycles, and the command path,

    τ̇_d = k_p u̇ + k_i u                         velocity loop inverted, [G] (17), (18)
    k_v r + k_ff ṙ + k_a r̈ = u + q̇_m + k_v q_m   position loop inverted, [G] (16), (19)
    r = low-pass(interpolation(q_c(k - delay)))  command path inverted by least squares over the horizon

*As printed* (``PRINTED``): the controller at the interpolation cycle T, the command path left out,

    u_d(k) = (τ_d(k) - τ_d(k-1) + u_d(k-1)) / (1 + k_I)                              [G] (18)
    Δq(k) = (u_d(k) + k_D Δq(k-1)/T - k_1 q̇_d(k) - k_2 q̈_d(k)) / (k_P + k_D/T)      [G] (19)
    q_c(k) = q_d(k) + Δq(k)                                                          [G] (20)

At rest τ_d is constant, so u_d and with it Δq fade to zero: the static accuracy is the controller's own. [G] takes all
this at the instant at which the command is handed over, and the gears for rigid. ``AHEAD`` takes it at the instant at
which the command acts, behind delay, interpolation and low-pass, and with elastic gears.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array, eased, interpolated
from ideal_robot.dynamics.newton_euler import inverse_dynamics, inverse_dynamics_with_point
from ideal_robot.errors import InputError
from ideal_robot.estimate.cholesky import factor, solve
from ideal_robot.feedforward.base import SETTLE, CommandLimits, Feedforward
from ideal_robot.feedforward.command_path import command_path_inverse
from ideal_robot.feedforward.path_operators import spline_operators
from ideal_robot.friction.table import Friction, Presliding, friction_along
from ideal_robot.jit import jit
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop import (
    Cascade,
    Compensation,
    Loop,
    behind_uneven_gears,
    compensated,
    further_torque,
    gains_at,
    mass_at,
    ripple_torque,
    sheet_torque,
    unevenness,
)
from ideal_robot.model.arm_with_effects import side_of_gap
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import COMMANDS_TOGETHER, ROWS_AFTER, ROWS_BEFORE


class Options(NamedTuple):
    """Effects that the inverse takes into account.

    Attributes:
        elastic: whether gear deflection is compensated. If so, the command at rest differs from the desired position by
            the deflection under gravity.
        path: whether the loops are inverted at their own cycles and the command path with them; else as printed.
        ahead: whether the controller as printed is right for the instant at which the command acts, or for the one at
            which it is handed over. The command path, inverted, knows.
    """

    elastic: bool = True
    path: bool = True
    ahead: bool = True


COMPLETE = Options()
"""All that is known of the loop."""
AHEAD = Options(path=False)
"""[G] (8), (16) to (20) with look ahead and elastic gears ([L] 2.2)."""
PRINTED = Options(elastic=False, path=False, ahead=False)
"""[G] (8), (9), (16) to (20)."""

_CUTOFF = 14.0
"""Frequencies of the desired path above this are not asked of the arm [Hz]. With half of it known paths were left twice
as far, fast lines a quarter further; twice as much gains nothing."""


class _Operators:
    """Matrices that give a path's value and first two derivatives, applied together.

    Args:
        value, first, second: each ``(k, m)``.
    """

    def __init__(self, value: Array, first: Array, second: Array) -> None:
        self.value, self._together = value, np.concatenate([value, first, second])

    @classmethod
    def smoothing(cls, t_samples: Array, t_out: Array, spacing: float, cutoff: float) -> _Operators:
        """The operators that smooth a path.

        Args:
            t_samples, t_out, spacing, cutoff: as of ``spline_operators``.
        """
        return cls(*spline_operators(t_samples, t_out, spacing, cutoff))

    def of(self, rows: Array) -> Array:
        """Values and derivatives of rows ``(m, n)``, shape ``(3, k, n)``."""
        return (self._together @ rows).reshape(3, -1, rows.shape[1])


class _Grid(NamedTuple):
    """Where the inverse evaluates a path, and the linear operators that do it.

    Attributes:
        rows: desired positions ahead that it looks at, the current one included.
        coarse: instants of the gear torques ``(c,)`` [s] after the command is handed over.
        fine: instants of the motors' motion ``(f,)`` [s].
        step: time between two of them [s].
        last: index of the last one within the cycle in which the command acts.
        at_coarse: from rows of the path to value and two derivatives at the coarse instants.
        at_fine: the same at the fine instants.
        torque: from coarse to fine instants.
    """

    rows: int
    coarse: Array
    fine: Array
    step: float
    last: int
    at_coarse: _Operators
    at_fine: _Operators
    torque: _Operators


def _complete_grid(loop: Loop) -> _Grid:
    """Over the cycles in which the next commands act: torques every half cycle, motors at the position loop's."""
    T, fine, delay = loop.t_ipo, loop.path.t_position, loop.path.delay
    rows = delay + COMMANDS_TOGETHER + ROWS_AFTER + 1
    t_rows = T * np.arange(-ROWS_BEFORE, rows, dtype=float)
    # One cycle wider than needed, for the derivatives of torques.
    t_coarse = T * (delay - 2 + 0.5 * np.arange(2.0 * (COMMANDS_TOGETHER + 4) + 1))
    # A position-loop output acts on average half its cycle later, so torques are computed there.
    t_fine = T * delay + fine * (np.arange(float(loop.steps_ipo * COMMANDS_TOGETHER)) + 0.5)
    return _Grid(rows, t_coarse, t_fine, fine, loop.steps_ipo - 1,
                 _Operators.smoothing(t_rows, t_coarse, T, _CUTOFF), _Operators.smoothing(t_rows, t_fine, T, _CUTOFF),
                 _Operators.smoothing(t_coarse, t_fine, T, _CUTOFF))


def _printed_grid(loop: Loop, lead: float) -> _Grid:
    """The grid of the printed precorrection: one instant, ``lead`` [s] after the command, differences over a cycle."""
    T = loop.t_ipo
    rows = int(np.ceil(lead / T)) + ROWS_AFTER + 1
    t_coarse = lead + T * np.array([-1.0, 0.0, 1.0])
    at_coarse = _Operators.smoothing(T * np.arange(-ROWS_BEFORE, rows, dtype=float), t_coarse, T, _CUTOFF)
    differences = [np.array([[0.0, 1.0, 0.0]]), np.array([[-0.5, 0.0, 0.5]]) / T, np.array([[1.0, -2.0, 1.0]]) / T**2]
    return _Grid(rows, t_coarse, t_coarse[1:2], T, 0, at_coarse,
                 _Operators(*(difference @ at_coarse.value for difference in differences)), _Operators(*differences))


def command_lag(loop: Loop) -> float:
    """Time from the hand-over of a command to its effect [s]: delay, interpolation and low-pass."""
    taps = loop.path.command_filter
    # A command is reached one cycle after its interpolation began.
    return (loop.path.delay + 1) * loop.t_ipo + loop.path.t_position * float(np.mean(np.arange(len(taps)) @ taps))


class _Planned(NamedTuple):
    """Velocity-loop error, its torque and what the integrator sums up, reference with rates, ``(n,)`` each.

    In rad/s, N m, rad/s, rad, rad/s, rad/s².
    """

    u: Array
    tau: Array
    summed: Array
    reference: Array
    rate: Array
    bend: Array


@dataclass(frozen=True)
class InverseState:
    """State of the inverse from cycle to cycle.

    Attributes:
        q_d: desired positions of the cycles before ``(ROWS_BEFORE, n)``.
        q_c: commands of the cycles before ``(P, n)``, newest last.
        planned: velocity-loop error, motor torque, integrator state and reference so far.
        q_m, v_m, presliding: motor angles, velocities ``(n,)`` [rad, rad/s] and state of the contacts planned for the
            end of the cycle in which the last command acts.
        deflection: of the gears under gravity at the start, not yet compensated ``(n,)`` [rad].
        sag: velocity-loop error at rest of joints without an integrator, not yet compensated ``(n,)`` [rad/s].
        cycle: cycles since the start.
    """

    q_d: Array
    q_c: Array
    planned: _Planned
    q_m: Array
    v_m: Array
    presliding: Presliding
    deflection: Array
    sag: Array
    cycle: int


class _Motion(NamedTuple):
    """Angles, velocities and accelerations of the motors at the fine instants, ``(f, n)`` each [rad, rad/s, rad/s²]."""

    q: Array
    v: Array
    a: Array


class Carried(NamedTuple):
    """A payload: mass [kg] at a place of the last joint's frame ``(3,)`` [m]."""

    mass: float
    place: Array


class Inverse(Feedforward):
    """Inverse of the identified closed loop over the horizon.

    Args:
        loop: the identified closed loop; see :func:`ideal_robot.loop.from_model.loop_model`.
        n_d: length of the horizon it is given; with fewer than ``n_d_needed`` rows the path is continued with constant
            acceleration. None for ``n_d_needed``.
        options: effects taken into account.
    """

    def __init__(self, loop: Loop, n_d: int | None = 30, options: Options = COMPLETE) -> None:
        if n_d is not None and n_d < 1:
            raise InputError("the horizon needs at least one row", field="n_d", value=n_d)
        self.loop, self.t_ipo, self.options = loop, loop.t_ipo, options
        drives = loop.drives
        lead = command_lag(loop) if options.ahead else 0.0
        grid = _complete_grid(loop) if options.path else _printed_grid(loop, lead)
        self._grid, self.n_d_needed = grid, grid.rows
        self.n_d = grid.rows if n_d is None else n_d
        self._inverse = command_path_inverse(loop, COMMANDS_TOGETHER)
        self._printed = _printed_gains(loop.cascade, loop.t_ipo)
        self._compliance = loop.compliance if options.elastic else np.zeros(loop.n)
        self._damped = drives.damping * self._compliance**2
        self._gap = drives.half_gap if options.elastic else np.zeros(loop.n)
        self._gaps = bool(self._gap.any())
        self._adds, self._sags = bool(loop.compensation.bodies.any()), bool((loop.cascade.k_i == 0.0).any())
        self._compensates = loop.compensation.coupled or bool(loop.compensation.friction_torque.any())
        self._lag = loop.cascade.t_filter + 0.5 * loop.path.t_velocity
        self._limits = CommandLimits.of(loop.path)

    @classmethod
    def of(cls, model: Model, robot: Robot, n_d: int | None = 30, *, delay: int = 0,
           options: Options = COMPLETE) -> Inverse:
        """The inverse of an identified model; ``delay`` as in ``loop_model``, ``n_d`` and ``options`` as in the class.

        Args:
            model, robot, delay: as in ``loop_model``.
            n_d, options: see the class.
        """
        return cls(loop_model(model, robot, delay=delay), n_d, options)

    def init(self, q0: Array, carried: Carried | None = None) -> InverseState:
        """State for an arm at rest at ``q0 (n,)`` [rad]; see ``Feedforward.init``. ``carried`` as in ``step_with``."""
        q0 = np.array(q0, dtype=float)
        loop, still = self.loop, np.zeros((1, self.loop.n))
        load, more = self._load(q0[None], still, still, carried)
        further = further_torque(loop, np.zeros(1), q0[None], still, still, load, still)[0]
        holding = load[0] if more is None else load[0] + more[0]
        deflection = load[0] * self._compliance + self._gap * side_of_gap(load[0], still[0], loop.drives.gap_load)
        deflection -= [unevenness(loop.drives.uneven, i, float(q))[0] for i, q in enumerate(q0)]
        tau = loop.drives.gain * (holding + loop.drives.offset) + further
        tau -= sheet_torque(loop.compensation, q0, still[0])
        if loop.compensation.coupled:
            tau = np.linalg.solve(gains_at(loop.compensation, q0), tau)
        sag = np.where(loop.cascade.k_i > 0.0, 0.0, tau / loop.cascade.k_p)
        return InverseState(
            q_d=np.tile(q0, (ROWS_BEFORE, 1)), q_c=np.tile(q0, (self._inverse.n_past, 1)),
            planned=_Planned(sag, tau, still[0], q0, still[0], still[0]), sag=sag,
            q_m=q0, v_m=still[0],
            presliding=Presliding.none(loop.n), deflection=deflection, cycle=0)

    def step(self, state: InverseState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, InverseState]:
        """The command of one interpolation cycle; see ``Feedforward.step``."""
        return self.step_with(self.loop.friction, state, q_d, tau_ext_d)

    def step_with(self, friction: Friction, state: InverseState, q_d: Array, tau_ext_d: Array | None = None,
                  carried: Carried | None = None, inertia: Array | None = None) -> tuple[Array, InverseState]:
        """``step`` with other friction, payload or inertia than identified, for adaptation.

        Args:
            friction: of every joint.
            state, q_d, tau_ext_d: as in ``step``.
            carried: payload beyond the model's bodies; its gear deflection is not added.
            inertia: coupling of the joints' accelerations into the drive torques beyond the model's ``(n, n)`` [kg m²].
        """
        loop, drives, grid = self.loop, self.loop.drives, self._grid
        q_d = self._checked(q_d)
        rows = np.concatenate([state.q_d, self._horizon(q_d, state.q_d)])
        q, qd, qdd = grid.at_coarse.of(rows)
        load, more = self._load(q, qd, qdd, carried)
        if tau_ext_d is not None:
            external = np.asarray(tau_ext_d, dtype=float)
            # The external torque is interpolated linearly, and constant beyond the horizon.
            load -= interpolated(grid.coarse, np.arange(len(external)) * self.t_ipo, external)
        gears = grid.torque.of(load)
        motors = grid.at_fine.of(rows) + self._compliance * gears
        if self.options.elastic:
            motors[0] -= self._damped * gears[1]
        if self._gaps:
            motors += grid.torque.of(self._gap * side_of_gap(load, qd, drives.gap_load))
        gear, (q_m, v_m, a_m) = gears[0], motors
        reflected = gear
        if len(drives.uneven):
            output = v_m
            q_m, v_m, a_m = behind_uneven_gears(drives.uneven, q_m, v_m, a_m)
            # A gear with a higher momentary ratio transmits more torque back to its motor.
            reflected = gear * np.divide(output, v_m, out=np.ones_like(v_m), where=np.abs(v_m) > 1e-6)
        self._take_up(state, q_m, v_m)
        smooth = reflected + drives.rotor_inertia * a_m + drives.offset
        if inertia is not None:
            smooth = smooth + a_m @ inertia.T
        if more is not None:
            smooth = smooth + grid.torque.value @ more
        rubbing, presliding = friction_along(friction, v_m, gear, grid.step * v_m, state.presliding)
        further = further_torque(loop, state.cycle * self.t_ipo + grid.fine, q_m, v_m, a_m, gear,
                                 presliding.direction)
        q_c, planned = self._command(state, _Motion(q_m, v_m, a_m), smooth + rubbing, further)
        k = grid.last
        # Half a step after the middle of the last one; as printed in the paper there is only one instant.
        reached = q_m[k] + 0.5 * grid.step * v_m[k] if self.options.path else q_m[k]
        return q_c, InverseState(np.concatenate([state.q_d[1:], q_d[:1]]), np.concatenate([state.q_c[1:], q_c[None]]),
                                 planned, reached, v_m[k],
                                 Presliding(presliding.force[k], presliding.direction[k]), state.deflection,
                                 state.sag, state.cycle + 1)

    def _command(self, state: InverseState, motors: _Motion, acting: Array, further: Array) -> tuple[Array, _Planned]:
        """The command ``(n,)`` [rad], and what is planned one cycle on, for the motors' motion and torques it takes."""
        loop, path = self.loop, self.loop.path
        if self._adds:
            added = inverse_dynamics(loop.compensation.sheet, motors.q, motors.v, np.zeros_like(motors.q))
            further = further - loop.compensation.bodies * added
        wanted = _motor_torques(loop.drives.gain, loop.drives.ripple, motors.q, acting, further)
        if self._compensates:
            wanted = _without_compensation(loop.compensation, motors, wanted)
        if self.options.path:
            signal, planned = _position_loop_signal(self._cascade(motors), motors, wanted, self._lag, path.t_position,
                                                    loop.steps_ipo, state.planned)
            if self._sags:
                signal -= state.sag * eased(self._remaining(state))
            q_c = _command(self._inverse.wanted, signal, self._inverse.past, state.q_c, self._limits)
            return q_c, planned
        gains = _printed_gains(self._cascade(motors), self.t_ipo) if loop.compensation.schedule else self._printed
        (q, qd, qdd), T = (rows[0] for rows in motors), self.t_ipo
        tau = wanted[0]
        u = (tau - state.planned.tau + state.planned.u) / (1.0 + gains.k_i)
        before = state.q_c[-1] - state.q_m
        correction = (u + gains.k_d * before / T - gains.k_1 * qd - gains.k_2 * qdd) / (gains.k_p + gains.k_d / T)
        return self._limits.within(q + correction), state.planned._replace(u=u, tau=tau)

    def _cascade(self, motors: _Motion) -> Cascade:
        """The loops with the gains that they have where the motion begins."""
        cascade, compensation = self.loop.cascade, self.loop.compensation
        if not compensation.schedule:
            return cascade
        follows = np.diag(gains_at(compensation, motors.q[0]))
        return cascade._replace(k_p=follows * cascade.k_p, k_i=follows * cascade.k_i)

    def _checked(self, q_d: Array) -> Array:
        """A horizon's positions ``(n_d, n)``; InputError where they are none."""
        q_d = np.asarray(q_d, dtype=float)
        if q_d.ndim != 2 or q_d.shape[1] != self.loop.n or len(q_d) == 0 or not np.isfinite(q_d).all():
            raise InputError(f"expected finite desired positions of shape (n_d, {self.loop.n})", field="q_d",
                             value=q_d.shape)
        return q_d

    def _take_up(self, state: InverseState, q_m: Array, v_m: Array) -> None:
        """Takes the deflection at the start up smoothly, from nothing to all, in the motors' motion ``(N, n)``."""
        if state.cycle * self.t_ipo + self._grid.fine[0] < SETTLE:
            remaining = self._remaining(state)
            q_m -= state.deflection * eased(remaining)
            v_m += state.deflection * 30.0 * remaining**2 * (1.0 - remaining) ** 2 / SETTLE

    def _remaining(self, state: InverseState) -> Array:
        """Share of the time of taking up at the start that is still to come, at the fine instants ``(f, 1)``."""
        return 1.0 - np.minimum((state.cycle * self.t_ipo + self._grid.fine) / SETTLE, 1.0)[:, None]

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


class _PrintedGains(NamedTuple):
    """Gains of [G] (16), (17) at the interpolation cycle, ``(n,)`` each; ``k_i`` is a share per cycle."""

    k_p: Array
    k_d: Array
    k_1: Array
    k_2: Array
    k_i: Array


def _printed_gains(cascade: Cascade, T: float) -> _PrintedGains:
    """A cascade's gains in [G]: ``k_P = k_p k_v``, ``k_D = k_p k_ff``, ``k_1 = k_D - k_p``, ``k_2 = k_p t_filter``."""
    k_d = cascade.k_p * cascade.k_ff
    return _PrintedGains(cascade.k_p * cascade.k_v, k_d, k_d - cascade.k_p, cascade.k_p * cascade.t_filter,
                         cascade.k_i * T / cascade.k_p)


@jit()
def _command(wanted: Array, signal: Array, past: Array, q_c: Array, limits: CommandLimits) -> Array:
    """The command ``(n,)`` [rad] that makes the position loop see its signal ``(N, n)``, within the limits."""
    command = np.empty(len(limits.low))
    for i in range(len(command)):
        ahead, behind = 0.0, 0.0
        for j in range(wanted.shape[1]):
            ahead += wanted[i, j] * signal[j, i]
        for j in range(past.shape[1]):
            behind += past[i, j] * q_c[j, i]
        before = q_c[len(q_c) - 1, i]
        within = min(max(ahead + behind, before - limits.step[i]), before + limits.step[i])
        command[i] = min(max(within, limits.low[i]), limits.high[i])
    return command


@jit()
def _motor_torques(gain: Array, ripple: Array, q: Array, acting: Array, further: Array) -> Array:
    """Torques that motors show ``(f, n)`` [N m]; few arrays, since each one that is handed over takes 0.3 µs.

    Args:
        gain, ripple: of ``Drives``.
        q: motor angles ``(f, n)`` [rad].
        acting, further: motor torque with friction, without ripple, and that of other effects, ``(f, n)`` [N m].
    """
    N, n = acting.shape
    torque = np.empty((N, n))
    for i in range(n):
        for j in range(N):
            torque[j, i] = gain[i] * (acting[j, i] + ripple_torque(ripple, i, q[j, i])) + further[j, i]
    return torque


@jit()
def _without_compensation(compensation: Compensation, motors: _Motion, torques: Array) -> Array:
    """What velocity loops have to give at the record's gains, but for a schedule, of motor torques ``(f, n)`` [N m]."""
    wanted = torques.copy()
    for j in range(len(wanted)):
        for i in range(wanted.shape[1]):
            # Except for the correction, the command moves like the motor.
            wanted[j, i] -= compensated(compensation, i, motors.v[j, i])
        if compensation.coupled:
            # M diag(1/J_0) x = τ; M is positive definite.
            M = mass_at(compensation.sheet, compensation.rotors, motors.q[j])
            if factor(M):
                solve(M, wanted[j])
                wanted[j] *= compensation.scheduled_at
    return wanted


@jit()
def _position_loop_signal(cascade: Cascade, motors: _Motion, wanted: Array, lag: Array, t_position: float, steps: int,
                          before: _Planned) -> tuple[Array, _Planned]:
    """The signal ``k_v r + k_ff ṙ + k_a r̈`` that the position loop must see ``(f, n)``, and what is planned a cycle on.

    ``wanted`` is what the velocity loops have to give ``(f, n)`` [N m].
    """
    N, n = wanted.shape
    signal = np.empty((N, n))
    u_next, tau_next, summed_next = before.u.copy(), before.tau.copy(), before.summed.copy()
    reference_next, rate_next, bend_next = before.reference.copy(), before.rate.copy(), before.bend.copy()
    k_p, k_i, k_v, w = cascade.k_p, cascade.k_i, cascade.k_v, cascade.integrated
    passed = 1.0 - np.exp(-t_position / cascade.t_rate) if cascade.t_rate > 0.0 else 1.0
    step = passed / t_position
    for i in range(n):
        u, tau, summed = before.u[i], before.tau[i], before.summed[i]
        reference, rate, bend = before.reference[i], before.rate[i], before.bend[i]
        half = 0.5 * k_i[i] * t_position
        ahead = step * (cascade.k_ff[i] + step * cascade.k_a[i])
        share = k_v[i] / (k_v[i] + ahead)
        for j in range(N):
            q, v = motors.q[j, i], motors.v[j, i]
            # Half a position cycle back, to the instant of the position comparison.
            measured, compared = v - lag[i] * motors.a[j, i], k_v[i] * (q - 0.5 * t_position * v)
            # [G] (18) with the trapezoidal rule: k_p Δu + k_i T (s + s_before)/2 = Δτ, s = w u + (1 - w) k_v (r - q),
            # where the signal is linear in r and what its rates were: k_v (r - q) = share u + rest.
            if w == 1.0:
                u = (wanted[j, i] - tau + u * (k_p[i] - half)) / (k_p[i] + half)
            else:
                fading, curving = (1.0 - passed) * rate - step * reference, (1.0 - passed) * bend - step * rate
                still = cascade.k_ff[i] * fading + cascade.k_a[i] * (curving + step * fading)
                rest = share * (measured + compared - still) - compared
                u = (wanted[j, i] - tau + k_p[i] * u - half * (summed + (1.0 - w) * rest)) / (
                    k_p[i] + half * (w + (1.0 - w) * share))
                summed = w * u + (1.0 - w) * (share * u + rest)
                reference = (summed - w * u) / ((1.0 - w) * k_v[i]) + compared / k_v[i]
                rate = fading + step * reference
                bend = curving + step * rate
            tau = wanted[j, i]
            # [G] (19).
            signal[j, i] = u + measured + compared
            if j == steps - 1:
                u_next[i], tau_next[i], summed_next[i] = u, tau, summed
                reference_next[i], rate_next[i], bend_next[i] = reference, rate, bend
    return signal, _Planned(u_next, tau_next, summed_next, reference_next, rate_next, bend_next)
