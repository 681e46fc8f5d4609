"""The ideal robot behind any joint controller: the command's law evaluated ahead along the desired motion."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array, held
from ideal_robot.command.law import CommandLaw
from ideal_robot.command.motion import Bodies, Motion
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import SETTLE, Feedforward
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass

_BEFORE, _AFTER = 6, 6
"""Desired positions on either side of an instant that its derivatives are taken from."""


@dataclass(frozen=True)
class InverseState:
    """What one cycle hands to the next.

    Attributes:
        q_d: desired positions before ``(6, n)`` [rad].
        filters: states of each joint's filters of direct and integrated terms ``(n, 2, k)``.
        start: command minus position at rest at the start ``(n,)`` [rad].
        cycle: cycles since the start.
    """

    q_d: Array
    filters: tuple[Array, ...]
    start: Array
    cycle: int


class CommandInverse(Feedforward):
    """Commands that make an arm with this law follow the desired positions.

    Gears that are known to be elastic are wound up first: the law is of motor angles, the desired ones are the arm's.
    What commands and positions differ by at rest is taken up over the first ``SETTLE`` seconds.

    Args:
        model: with the law, ``model.command``.
        robot: cycle.
        delay: cycles between hand-over of a command and the start of its interpolation, beyond those of the recording
            that the law is from.

    Raises:
        InputError: the model has no law.
    """

    def __init__(self, model: Model, robot: Robot, *, delay: int = 0) -> None:
        model.require_arm(robot)
        if model.command is None:
            raise InputError("the model holds no command law; identify it from recordings with commands (q_c_i)",
                             field="command")
        self.law: CommandLaw = model.command
        self.model, self.t_ipo, self.n = model, robot.t_ipo, robot.n
        self.bodies = Bodies.of(model.dynamics, model.rotor_inertia)
        self.compliance = (np.zeros(self.n) if model.known_stiffness is None else 1.0 / model.known_stiffness)
        # Commands act at lines from one to the next: a cycle other than the recording's shifts them by its half.
        self.shift = delay * self.t_ipo + 0.5 * (self.t_ipo - self.law.t_cycle)
        self.ahead = np.maximum([own.shape.ahead + self.shift for own in self.law.joints], 0.0)
        self.n_d = int(np.ceil(self.ahead.max() / self.t_ipo)) + _AFTER

    def motion(self, q_d: Array, tau_ext_d: Array | None = None) -> Motion:
        """Motion of the motors ``(N, n)`` along desired positions, with the torques that it asks for."""
        motion = Motion.of(q_d, self.t_ipo, self.law.still, self.bodies)
        external = np.zeros_like(q_d) if tau_ext_d is None else tau_ext_d
        if np.any(self.compliance):
            load = self.model.rigid_body(motion.q, motion.qd, motion.qdd) - external
            motion = Motion.of(q_d + self.compliance * load, self.t_ipo, self.law.still, self.bodies)
        if self.law.torque == "none":
            return motion
        return motion.with_torque(self.model.inverse_dynamics(motion.q, motion.qd, motion.qdd) - external)

    def along(self, q_d: Array) -> Array:
        """See ``Feedforward.along``; the whole path at once."""
        motion = self.motion(held(q_d, after=self.n_d))
        t = self.t_ipo * np.arange(float(len(motion.q)))
        commands = np.empty_like(q_d)
        for j in range(self.n):
            commands[:, j] = self._early(motion, j, self.law.error(motion, j), t[: len(q_d)])
        start = commands[0] - q_d[0]
        return commands - (1.0 - _settled(t[: len(q_d)], self.t_ipo))[:, None] * start

    def init(self, q0: Array) -> InverseState:
        """See ``Feedforward.init``."""
        from scipy import signal

        rows = np.tile(q0, (2 * _BEFORE, 1))
        motion, filters, start = self.motion(rows), [], np.empty(self.n)
        for j, own in enumerate(self.law.joints):
            sums = self.law.sums(motion, j)
            num, den = own.shape.discrete(self.t_ipo)
            states = [signal.lfilter_zi(b, den) * x[0] if len(den) > 1 else np.zeros(0)
                      for b, x in zip(num, sums, strict=True)]
            filters.append(np.array(states))
            start[j] = motion.q[0, j] + self.law.error(motion, j)[0] - q0[j]
        return InverseState(np.tile(q0, (_BEFORE, 1)), tuple(filters), start, 0)

    def step(self, state: InverseState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, InverseState]:
        """See ``Feedforward.step``."""
        from scipy import signal

        ahead = q_d[: self.n_d] if len(q_d) >= self.n_d else _extended(state.q_d, q_d, self.n_d)
        external = None
        if tau_ext_d is not None:
            rows = held(tau_ext_d, after=max(self.n_d - len(tau_ext_d), 0))[: self.n_d]
            external = held(rows, before=_BEFORE)
        motion = self.motion(np.vstack([state.q_d, ahead]), external)
        q_c, filters = np.empty(self.n), []
        for j, own in enumerate(self.law.joints):
            num, den = own.shape.discrete(self.t_ipo)
            total, states = np.zeros(len(motion.q)), []
            for b, x, zi in zip(num, self.law.sums(motion, j), state.filters[j], strict=True):
                if len(den) == 1:
                    total += b[0] / den[0] * x
                    states.append(zi)
                    continue
                now, after = signal.lfilter(b, den, x[_BEFORE : _BEFORE + 1], zi=zi)
                total[_BEFORE], total[_BEFORE + 1 :] = total[_BEFORE] + now[0], total[_BEFORE + 1 :] + signal.lfilter(
                    b, den, x[_BEFORE + 1 :], zi=after)[0]
                states.append(after)
            filters.append(np.array(states))
            q_c[j] = self._early(motion, j, total, np.array([_BEFORE * self.t_ipo]), first=_BEFORE)[0]
        rest = 1.0 - _settled(np.array([state.cycle * self.t_ipo]), self.t_ipo)[0]
        return q_c - rest * state.start, InverseState(np.vstack([state.q_d[1:], ahead[:1]]), tuple(filters),
                                                      state.start, state.cycle + 1)

    def expected(self, q_d: Array) -> Array:
        """Standard deviation of what the commands for a path leave ``(N, n)`` [rad]."""
        return self.law.expected(self.motion(q_d))

    def uncorrected(self, q_d: Array) -> Array:
        """Error ``(N, n)`` [rad] that the path itself leaves when it is commanded: ``q_d - q``."""
        speed = np.std(np.gradient(q_d, self.t_ipo, axis=0), axis=0)
        missing = self._unsettled(q_d) - q_d
        # How late each joint is; the motion whose commands are the path is looked for where that is a third of a turn.
        late = np.std(missing, axis=0) / np.maximum(speed, 1e-12)
        cutoff = min(_TURN / (2.0 * np.pi * max(float(late.max()), 1e-6)), 0.2 / self.t_ipo)
        first, size = missing, float(np.std(missing))
        while cutoff * self.t_ipo * len(q_d) > _FEWEST_TURNS:
            error, missing = np.zeros_like(q_d), first
            for _ in range(_ROUNDS):
                error = lowpass(error + _STEP * missing, self.t_ipo, cutoff)
                missing = self._unsettled(q_d - error) - q_d
                if not float(np.std(missing)) <= 1.5 * size:
                    break
            else:
                return error
            # Inertia and integrators turn fast motion further than lateness does.
            cutoff *= 0.5
        return lowpass(first, self.t_ipo, min(1.0, 0.2 / self.t_ipo))

    def _unsettled(self, q: Array) -> Array:
        motion = self.motion(held(q, after=self.n_d))
        t = self.t_ipo * np.arange(float(len(q)))
        commands = np.stack([self._early(motion, j, self.law.error(motion, j), t) for j in range(self.n)], axis=1)
        return np.asarray(commands - (commands[0] - q[0]))

    def _early(self, motion: Motion, j: int, error: Array, t: Array, first: int = 0) -> Array:
        """The command of joint ``j`` at instants ``t (M,)`` [s] of a motion, whose rows from ``first`` on count."""
        shape = self.law.joints[j].shape
        r = (motion.q[:, j] + error)[first:, None]
        early = shape.filter.before(r, self.t_ipo, shape.time)[:, 0]
        at = self.t_ipo * np.arange(first, first + len(early))
        return np.asarray(CubicSpline(at, early)(np.clip(t + self.ahead[j], at[0], at[-1])))


_TURN = 3.0
"""Angular frequency times lateness up to which the uncorrected path's error is looked for."""
_FEWEST_TURNS = 4.0
"""Oscillations of the cut-off that a path holds at least; below, the first guess is all there is."""
_STEP = 0.18
"""Share of what is missing that each round adds: below 2/(1 + 3²), with which the rounds converge there."""
_ROUNDS = 25
"""After which 0.7 % of slow motion's error is missing, 0.82 to the power of 25."""


def _settled(t: Array, t_ipo: float) -> Array:
    """Share of a start's difference that is taken up at instants ``(N,)`` [s], smoothly from 0 to 1."""
    share = np.clip(t / max(SETTLE, t_ipo), 0.0, 1.0)
    return np.asarray(share**3 * (10.0 - 15.0 * share + 6.0 * share**2))


def _extended(before: Array, q_d: Array, rows: int) -> Array:
    """A horizon ``(n_d, n)`` that is too short, on with its last speed."""
    speed = (np.vstack([before, q_d])[-1] - np.vstack([before, q_d])[-2])
    more = np.arange(1, rows - len(q_d) + 1)[:, None]
    return np.vstack([q_d, q_d[-1] + more * speed])


def at_cycle_of(robot: Robot, law: CommandLaw | None) -> Robot:
    """The robot at the cycle in which its recordings were commanded, where its drive data name none."""
    named = robot.data.get("controller", {})
    if law is None or "t_ipo" in named or abs(law.t_cycle - robot.t_ipo) < 1e-9:
        return robot
    return dataclasses.replace(robot, t_ipo=law.t_cycle, t_position=min(robot.t_position, law.t_cycle),
                               t_velocity=min(robot.t_velocity, law.t_cycle))
