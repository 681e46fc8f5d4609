"""Nonlinear precorrection: inverse dynamics, then the inverted controller, at the interpolation cycle.

    τ_d = M(q_d) q̈_d + c + g + τ_f(q̇_d)                                            [G] (8)
    u_d(k) = (τ_d(k) - τ_d(k-1) + u_d(k-1)) / (1 + k_I)                              [G] (18)
    Δq(k) = (u_d(k) + k_D Δq(k-1)/T - k_1 q̇_d(k) - k_2 q̈_d(k)) / (k_P + k_D/T)      [G] (19)
    q_c(k) = q_d(k) + Δq(k)                                                          [G] (20)

At rest τ_d is constant, so u_d and with it Δq fade to zero: the static accuracy is the controller's own.

[G] leaves three things out that :meth:`Precorrection.complete` adds: the desired path is looked at ahead by the delay
that planner, interpolation and command low-pass make; and where the gears' stiffness is known, q_d is the *arm's* and
the motor has to be at q_d + τ_g/k.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.interpolate import BSpline

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import SETTLE, Feedforward
from ideal_robot.loop.from_model import further_torque, loop_model
from ideal_robot.loop.loop_model import LoopModel, behind_uneven_gears, friction_along, low_pass_taps, ripple_torque
from ideal_robot.model.arm_with_effects import side_of_gap
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.robots.robot import Robot

# Linear operators that turn samples of a path into its smoothed value and derivatives at other instants.
#
# A penalised B-spline (degree 5, a knot per sample) is fitted to the samples. Fit and evaluation are linear, so for
# fixed instants they are one matrix, made once and multiplied every cycle.

_DEGREE, _PENALTY_ORDER = 5, 4
"""A quintic has continuous third derivatives; differences of order 4 make the gain ``1/(1 + (f/cutoff)^8)``."""


def spline_operators(t_samples: Array, t_out: Array, spacing: float, cutoff: float, orders: int = 3) -> list[Array]:
    """Matrices ``(len(t_out), len(t_samples))``: from samples to value, derivative, … of the smoothed path.

    Args:
        t_samples, t_out: instants of the samples, evenly spaced, and of the result, within the samples [s].
        spacing: distance of the spline's knots [s].
        cutoff: frequency at which a sinusoid is halved [Hz]; the gain is 1/(1 + (f/cutoff)^8), so a quarter of it
            passes unharmed (1e-5).
        orders: how many matrices, value included.
    """
    start, end = float(t_samples[0]), float(t_samples[-1])
    pieces = max(1, round((end - start) / spacing))
    knots = start + (end - start) / pieces * np.arange(-_DEGREE, pieces + _DEGREE + 1)
    size = len(knots) - _DEGREE - 1
    basis = BSpline(knots, np.eye(size), _DEGREE, extrapolate=True)
    B = basis(t_samples)
    differences = np.diff(np.eye(size), _PENALTY_ORDER, axis=0)
    # A sinusoid of coefficients is penalised by (2 sin(ω h/2))^8 and appears in the samples with the basis' own gain
    # sinc(f h)^6; both terms shall weigh the same at the cut-off.
    h = (end - start) / pieces
    seen = len(t_samples) / (pieces + 1) * np.sinc(cutoff * h) ** (2 * (_DEGREE + 1))
    weight = seen / (2 * np.sin(min(np.pi * cutoff * h, 1.5))) ** (2 * _PENALTY_ORDER)
    fit = np.linalg.solve(B.T @ B + weight * differences.T @ differences, B.T)
    return [np.ascontiguousarray(basis.derivative(order)(t_out) @ fit if order else basis(t_out) @ fit)
            for order in range(orders)]


_BEFORE, _AFTER = 4, 4
"""Desired positions used on either side of the instant that counts, for its derivatives."""
_STILL = 1e-4
"""Velocity below which a joint counts as at rest, where its friction jumps [rad/s]."""


@dataclass(frozen=True)
class PrecorrectionState:
    """What one cycle hands to the next.

    Attributes:
        q_d: desired positions before ``(4, n)`` [rad].
        motor: motor position planned last ``(n,)`` [rad].
        bent: dry friction over its identified size ``(n,)``: how far its bristles are bent.
        tau, u, correction: last ``τ_d`` [N m], ``u_d`` and ``Δq`` [rad], each ``(n,)``.
        sag: deflection under gravity at the start ``(n,)`` [rad].
        cycle: cycles since the start.
    """

    q_d: Array
    motor: Array
    bent: Array
    tau: Array
    u: Array
    correction: Array
    sag: Array
    cycle: int


class Precorrection(Feedforward):
    """Nonlinear precorrection, [G] (8), (9), (16)–(20).

    Args:
        model: identified model with a controller.
        robot: cycle time and limits.
        lead: how far ahead the path is looked at [s]. 0 is [G]: the correction is right for the instant at which the
            command is handed over, not for the one at which it acts.
        elastic: whether the gears' deflection is compensated; needs a stiffness. The command at rest then differs from
            the desired position by the deflection under gravity, else by nothing.

    Raises:
        InputError: the model has no controller, or no stiffness for ``elastic``.
    """

    def __init__(self, model: Model, robot: Robot, *, lead: float = 0.0, elastic: bool = False) -> None:
        model.require_arm(robot)
        if model.controller is None:
            raise InputError("the model holds no controller; identify it from recordings with commands (q_c_i)",
                             field="controller")
        if lead < 0:
            raise InputError("cannot be negative", field="lead", value=lead)
        T = robot.t_ipo
        self.t_ipo, self.n_d = T, int(np.ceil(lead / T)) + _AFTER + 1
        self._loop = loop_model(model, robot, delay=0)
        if elastic and not self._loop.compliance.any():
            raise InputError("the model holds no stiffness of the gears", field="stiffness")
        self._drives = self._loop.drives(self._loop.stiffness, self._loop.damping)
        self._compliance = self._loop.compliance if elastic else np.zeros(robot.n)
        self._gap = self._loop.half_gap if elastic else np.zeros(robot.n)
        self._lead = lead
        self._controller = at_cycle(model.controller, T)
        self._range = robot.q_min, robot.q_max
        rows = T * np.arange(-_BEFORE, self.n_d, dtype=float)
        self._at = spline_operators(rows, lead + T * np.array([-1.0, 0.0, 1.0]), T, cutoff=16.0)

    @classmethod
    def complete(cls, model: Model, robot: Robot, *, delay: int) -> Precorrection:
        """Undoes planner's delay, interpolation and low-pass by the horizon, and the elasticity of gears if known.

        Args:
            model, robot: identified, and the arm.
            delay: of the planner [cycles].
        """
        controller = model.controller
        lag = 0.0
        if controller is not None:
            taps = low_pass_taps(controller.filter_time, controller.filter_order, robot.t_position, robot.n)
            lag = robot.t_position * float(np.mean(np.arange(len(taps)) @ taps))
        # A command is reached one cycle after its interpolation began.
        elastic = bool(loop_model(model, robot, delay=0).compliance.any())
        return cls(model, robot, lead=(delay + 1) * robot.t_ipo + lag, elastic=elastic)

    def init(self, q0: Array) -> PrecorrectionState:
        """See ``Feedforward.init``."""
        q0, loop = np.array(q0, dtype=float), self._loop
        still = np.zeros((1, len(q0)))
        load = inverse_dynamics(loop.chain, q0[None], still, still)
        further = further_torque(loop, np.zeros(1), q0[None], still, still, load, still)[0]
        tau = loop.gain * (load[0] + loop.offset) + further
        sag = self._motor(q0[None], still, load)[0] - q0
        return PrecorrectionState(np.tile(q0, (_BEFORE, 1)), q0, still[0], tau, still[0], still[0], sag, 0)

    def step(self, state: PrecorrectionState, q_d: Array, tau_ext_d: Array | None = None
             ) -> tuple[Array, PrecorrectionState]:
        """See ``Feedforward.step``."""
        T, gains = self.t_ipo, self._controller
        rows = np.concatenate([state.q_d, q_d[: self.n_d]])
        missing = len(self._at[0][0]) - len(rows)
        if missing > 0:
            rows = np.concatenate([rows, rows[-1] + np.arange(1, missing + 1)[:, None] * (rows[-1] - rows[-2])])
        arm, speed, acceleration = (operator @ rows for operator in self._at)
        load = inverse_dynamics(self._loop.chain, arm, speed, acceleration)
        if tau_ext_d is not None:
            load = load - tau_ext_d[min(self.n_d - _AFTER - 1, len(tau_ext_d) - 1)]
        # The deflection at the start is taken up smoothly: a jump would leave friction where no one knows.
        begun = (state.cycle + np.array([[-1.0], [0.0], [1.0]])) * T / SETTLE
        rest = 1.0 - np.clip(begun, 0.0, 1.0)
        motor = self._motor(arm, speed, load) - state.sag * rest**3 * (10.0 - 15.0 * rest + 6.0 * rest**2)
        qd, qdd = (motor[2] - motor[0]) / (2 * T), (motor[2] - 2 * motor[1] + motor[0]) / T**2
        friction = friction_along(self._drives, qd[None], load[1:2], T, state.bent, _STILL)
        tau = self._torque(state.cycle * T + self._lead, motor[1], qd, qdd, load[1], friction)
        u = (tau - state.tau + state.u) / (1 + gains.k_i)
        correction = ((u + gains.k_d * state.correction / T - gains.k_1 * qd - gains.k_2 * qdd)
                      / (gains.k_p + gains.k_d / T))
        q_c = np.clip(motor[1] + correction, *self._range)
        return q_c, PrecorrectionState(np.concatenate([state.q_d[1:], q_d[:1]]), motor[1], friction[1][0], tau, u,
                                       correction, state.sag, state.cycle + 1)

    def _motor(self, arm: Array, speed: Array, load: Array) -> Array:
        """Motor angles ``(m, n)`` for arm angles, behind elastic and uneven gears with play."""
        output = arm + self._compliance * load
        if self._gap.any():
            output = output + self._gap * side_of_gap(load, speed, self._loop.gap_load)
        if len(self._loop.uneven):
            still = np.zeros_like(output)
            output = behind_uneven_gears(self._loop.uneven, output, still, still)[0]
        return output

    def _torque(self, t: float, q: Array, qd: Array, qdd: Array, load: Array,
                friction: tuple[Array, Array, Array]) -> Array:
        """Motor torque ``(n,)`` [N m], [G] (8), with ripple and further effects; friction as of ``friction_along``."""
        loop = self._loop
        acting = load + loop.rotor_inertia * qdd + loop.offset + friction[0][0]
        if len(loop.ripple):
            acting = acting + [ripple_torque(loop.ripple, i, float(angle)) for i, angle in enumerate(q)]
        further = further_torque(loop, np.array([t]), q[None], qd[None], qdd[None], load[None], friction[2])[0]
        return np.asarray(loop.gain * acting + further)


def at_cycle(controller: ControllerModel, t_cycle: float) -> ControllerModel:
    """The same controller for another cycle: the integral gain of (17) is a share per cycle, the others are rates."""
    return replace(controller, k_i=controller.k_i * t_cycle / controller.t_cycle, t_cycle=t_cycle)


# Inverse of the command path: which commands make the position loop see a wanted signal.
#
# Delay, linear interpolation, command low-pass and the position loop's gain and feedforward are linear, so the commands
# over the horizon are one regularised least-squares problem with a fixed matrix. Only the first command is used; what
# was commanded before enters as the free response. Systems whose low-pass is not minimum phase are no special case.

@dataclass(frozen=True)
class CommandInverse:
    """Gains of the first command.

    Those ``wanted (n, m s)`` are of the signal ``k_v r + k_ff ṙ`` at the position cycles of the ``m`` next
    interpolation cycles in which the command can act, ``past (n, P)`` of the commands before, oldest first.
    """

    wanted: Array
    past: Array

    @property
    def n_past(self) -> int:
        """How many past commands are needed."""
        return self.past.shape[1]


_SMOOTHNESS = 0.02
"""Weight of the commands' second differences against a position error of the same size: keeps the inverse of the
low-pass from amplifying what the interpolation cannot pass anyway."""


def command_inverse(loop: LoopModel, cycles: int) -> CommandInverse:
    """Solves for the first of ``cycles`` commands, which are solved for together, once and for all."""
    s, n = loop.steps_ipo, loop.n
    taps = loop.command_filter
    n_past = int(np.ceil(len(taps) / s)) + 2
    knots = n_past + cycles
    # Linear interpolation: from the knots to the fine grid, which ends just before the last knot.
    fine = s * (knots - 1)
    interpolation = np.zeros((fine, knots))
    for j in range(fine):
        interpolation[j, j // s] = 1 - (j % s) / s
        interpolation[j, j // s + 1] = (j % s) / s
    wanted, past = np.zeros((n, s * cycles)), np.zeros((n, n_past))
    second = np.diff(np.eye(cycles + 2), 2, axis=0)
    for i in range(n):
        answer = np.zeros(fine)
        answer[: len(taps)] = taps[:fine, i]
        response = linalg.toeplitz(answer, np.zeros(fine))
        # Before the oldest knot the command counts as constant.
        response[:, 0] += 1.0 - response.sum(axis=1)
        position = response @ interpolation
        signal = loop.k_v[i] * position
        signal[1:] += loop.k_ff[i] / loop.t_position * np.diff(position, axis=0)
        signal = signal[-s * cycles :] / loop.k_v[i]
        free, forced, weight = signal[:, :n_past], signal[:, n_past:], _SMOOTHNESS * np.sqrt(s)
        first = np.linalg.pinv(np.vstack([forced, weight * second[:, 2:]]))[0]
        wanted[i] = first[: s * cycles] / loop.k_v[i]
        past[i] = -first[: s * cycles] @ free
        past[i, -2:] -= first[s * cycles :] @ (weight * second[:, :2])
    return CommandInverse(wanted, past)
