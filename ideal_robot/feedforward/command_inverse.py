"""The ideal robot for any joint controller: the command's law, evaluated ahead along the desired motion."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array, eased, held
from ideal_robot.command.law import CommandLaw
from ideal_robot.command.motion import Bodies, Motion
from ideal_robot.command.response import REST, position_response, uncorrected
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import SETTLE, Feedforward
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import REVERSING, ROWS_BEFORE

_TURNS = 0.25
"""Share of a joint's acceleration that its command may take where friction turns."""
_WIDTHS, _LONGEST = (0.0, 0.6, 1.0, 1.5, 2.2, 3.3, 5.0, 7.5, 11.0, 17.0, 25.0, 37.0, 56.0), 0.06
"""Standard deviations of the smoothing of friction that are tried [cycles], and the longest [s]."""


@dataclass(frozen=True)
class InverseState:
    """State of the inverse from cycle to cycle.

    Attributes:
        q_d: desired positions before ``(W, n)`` [rad].
        filters: states of each joint's filters of direct and integrated terms ``(n, 2, k)``.
        start: command minus position at rest at the start ``(n,)`` [rad].
        cycle: cycles since the start.
        motors: planned motor angles of the last command, with gear deflection ``(n,)`` [rad].
    """

    q_d: Array
    filters: tuple[Array, ...]
    start: Array
    cycle: int
    motors: Array


@dataclass(frozen=True)
class Changed:
    """Changes of a command law since its identification.

    Attributes:
        late: commands act so much later ``(n,)`` [s].
        offset: more of the command ``(n,)`` [rad].
        factors: on each joint's coefficients ``(m,)`` each.
    """

    late: Array
    offset: Array
    factors: tuple[Array, ...]


class CommandInverse(Feedforward):
    """Commands that make an arm with this law follow the desired positions.

    Known gear deflection is added first: the law is for motor angles, the desired angles are the arm's. Where dry
    friction reverses, the law requires a jump of the command. It is spread over the cycles that the joints'
    acceleration needs; with a long cycle over none. The difference of command and position at rest is introduced over
    the first ``SETTLE`` seconds.

    Args:
        model: with the law, ``model.command``.
        robot: cycle.
        delay: cycles between hand-over of a command and the start of its interpolation, beyond those of the recording
            that the law is from.

    Raises:
        InputError: the model has no law.
    """

    extends = True

    def __init__(self, model: Model, robot: Robot, *, delay: int = 0) -> None:
        model.require_arm(robot)
        if model.command is None:
            raise InputError("the model holds no command law; identify it from recordings with commands (q_c_i)",
                             field="command")
        self.law: CommandLaw = model.command
        self.model, self.t_ipo, self.n = model, robot.t_ipo, robot.n
        self.bodies = Bodies.of(model.dynamics, model.rotor_inertia)
        self.compliance = (np.zeros(self.n) if model.known_stiffness is None else 1.0 / model.known_stiffness)
        self.shift = delay * self.t_ipo + self.law.reached_after(self.t_ipo)
        self.ahead = np.maximum([own.shape.ahead + self.shift for own in self.law.joints], 0.0)
        self.discrete = [own.shape.discrete(self.t_ipo) for own in self.law.joints]
        self._response: Array | None = None
        self._spread: list[Array] = [np.ones(1)] * self.n
        if self.law.torque != "none":
            # Change of each joint's friction at a reversal.
            turns = -np.diff(self.model.friction.torque(np.array([[1.0], [-1.0]]) * self.law.still), axis=0)[0]
            self._spread = [_bell(self._width(i, turns, robot.a_max)) for i in range(self.n)]
        spread = max(len(kernel) for kernel in self._spread) // 2
        self.before = ROWS_BEFORE + spread
        self.n_d = int(np.ceil(self.ahead.max() / self.t_ipo)) + ROWS_BEFORE + spread

    def _width(self, i: int, turns: Array, a_max: Array) -> float:
        """Least spread of the friction of joint ``i`` (from 0) with which no command leaps where it turns [cycles].

        Args:
            i: joint, from 0.
            turns: by how much the friction of each joint changes there ``(n,)`` [N m].
            a_max: acceleration of the joints ``(n,)`` [rad/s²].
        """
        rows = round(8 * _LONGEST / self.t_ipo)
        motion = Motion.of(np.tile(self.law.middle, (rows, 1)), self.t_ipo, self.law.still, self.bodies)
        turned, width = np.zeros((rows, self.n)), 0.0
        turned[rows // 2 :, i] = turns[i]
        rest = self.law.commands(motion.with_torque(np.zeros_like(turned)), 1, self.ahead)
        for width in _WIDTHS:
            if width * self.t_ipo > _LONGEST:
                break
            torque = turned.copy()
            torque[:, i] = _spread_over(turned[:, i], _bell(width))
            commands = self.law.commands(motion.with_torque(torque), rows, self.ahead) - rest
            bend = np.abs(np.diff(commands, 2, axis=0)).max(axis=0) / self.t_ipo**2
            if np.all(bend <= _TURNS * a_max):
                break
        return width

    def motion(self, q_d: Array, tau_ext_d: Array | None = None) -> Motion:
        """Motion of the motors ``(N, n)`` along desired positions, with its torques."""
        motion = Motion.of(q_d, self.t_ipo, self.law.still, self.bodies)
        external = np.zeros_like(q_d) if tau_ext_d is None else tau_ext_d
        if np.any(self.compliance):
            load = self.model.rigid_body(motion.q, motion.qd, motion.qdd) - external
            motion = Motion.of(q_d + self.compliance * load, self.t_ipo, self.law.still, self.bodies)
        return self.with_model_torque(motion, external)

    def with_model_torque(self, motion: Motion, external: Array | float = 0.0) -> Motion:
        """A motion with the model's torques, if the law uses torques, less those of contact ``(N, n)`` [N m]."""
        if self.law.torque == "none":
            return motion
        moves = np.abs(motion.qd) > REVERSING * self.law.still
        torque = self.model.inverse_dynamics(motion.q, np.where(moves, motion.qd, 0.0), motion.qdd)
        # The torque of the bodies is as smooth as the motion; the rest is friction.
        friction = torque - motion.body
        spread = np.stack([_spread_over(friction[:, i], kernel) for i, kernel in enumerate(self._spread)], axis=1)
        return motion.with_torque(motion.body + spread - external)

    def along(self, q_d: Array) -> Array:
        """Commands ``(N, n)`` [rad] of a whole path that is known beforehand; see ``Feedforward.along``."""
        commands, t = self._required(q_d), self.t_ipo * np.arange(float(len(q_d)))
        return np.asarray(commands - (1.0 - _settled(t, self.t_ipo))[:, None] * (commands[0] - q_d[0]))

    def init(self, q0: Array) -> InverseState:
        """State for an arm at rest at ``q0 (n,)`` [rad]; see ``Feedforward.init``."""
        from scipy import signal

        rows = np.tile(q0, (2 * self.before, 1))
        motion, filters, start = self.motion(rows), [], np.empty(self.n)
        for j, (num, den) in enumerate(self.discrete):
            sums = self.law.sums(motion, j)
            states = [signal.lfilter_zi(b, den) * x[0] if len(den) > 1 else np.zeros(0)
                      for b, x in zip(num, sums, strict=True)]
            filters.append(np.array(states))
            start[j] = motion.q[0, j] + self.law.error(motion, j)[0] - q0[j]
        return InverseState(np.tile(q0, (self.before, 1)), tuple(filters), start, 0, q0.copy())

    def step(self, state: InverseState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, InverseState]:
        """The command of one interpolation cycle; see ``Feedforward.step``."""
        return self.changed_step(state, q_d, tau_ext_d, None)

    def changed_step(self, state: InverseState, q_d: Array, tau_ext_d: Array | None, changed: Changed | None,
                     rows: int = 0) -> tuple[Array, InverseState]:
        """``step`` with a changed law.

        Args:
            state, q_d, tau_ext_d: see ``Feedforward.step``.
            changed: the changes; None for none.
            rows: rows of the horizon that are used, if more than ``n_d``.
        """
        from scipy import signal

        n_d = max(rows, self.n_d)
        ahead = q_d[:n_d] if len(q_d) >= n_d else _extended(state.q_d, q_d, n_d)
        external = None
        if tau_ext_d is not None:
            contact = held(tau_ext_d, after=max(n_d - len(tau_ext_d), 0))[:n_d]
            external = held(contact, before=self.before)
        motion = self.motion(np.vstack([state.q_d, ahead]), external)
        q_c, filters, now_row = np.empty(self.n), [], self.before
        for j, (num, den) in enumerate(self.discrete):
            total, states = np.zeros(len(motion.q)), []
            sums = self.law.sums(motion, j, None if changed is None else changed.factors[j])
            for b, x, zi in zip(num, sums, state.filters[j], strict=True):
                if len(den) == 1:
                    total += b[0] / den[0] * x
                    states.append(zi)
                    continue
                now, passed = signal.lfilter(b, den, x[now_row : now_row + 1], zi=zi)
                total[now_row] += now[0]
                total[now_row + 1 :] += signal.lfilter(b, den, x[now_row + 1 :], zi=passed)[0]
                states.append(passed)
            filters.append(np.array(states))
            now_at, late = np.array([now_row * self.t_ipo]), self.ahead[j]
            if changed is not None:
                late, total = max(late + changed.late[j], 0.0), total + changed.offset[j]
            q_c[j] = self.law.early(motion, j, total, now_at, late, first=now_row)[0]
        rest = 1.0 - _settled(np.array([state.cycle * self.t_ipo]), self.t_ipo)[0]
        after = InverseState(np.vstack([state.q_d[1:], ahead[:1]]), tuple(filters), state.start, state.cycle + 1,
                             motion.q[now_row] - rest * state.start)
        return q_c - rest * state.start, after

    def expected(self, q_d: Array) -> Array:
        """Expected standard deviation of the path error with the commands of this law ``(N, n)`` [rad].

        It is the law's residual on held-out motion; for a law of another controller kind also the difference of the
        commands, as the joints respond to them.
        """
        rows, motion = len(q_d), self.motion(held(q_d, after=self.n_d))
        variance = self.law.variance(motion)[:rows]
        for j in range(self.n):
            for probability, apart in self.law.apart(motion, j):
                variance[:, j] += probability * self._answered(apart, j)[:rows] ** 2
        return np.asarray(np.sqrt(variance))

    def expected_by(self, q_c: Array, q_d: Array) -> Array:
        """Expected standard deviation of the path error with other commands, by this law ``(N, n)`` [rad].

        Args:
            q_c, q_d: commands and path ``(N, n)`` each [rad].
        """
        missing = q_c - self._required(q_d)
        answered = np.stack([self._answered(missing[:, j], j) for j in range(self.n)], axis=1)
        return np.asarray(np.sqrt(answered**2 + self.law.variance(self.motion(q_d))))

    def _answered(self, command: Array, j: int) -> Array:
        """What joint ``j`` (from 0) makes of a small part of its command ``(N,)``, both from rest [rad]."""
        if self._response is None:
            self._response = self.response(self.law.middle, round(REST / self.t_ipo))
        return np.convolve(command - command[0], self._response[:, j])[: len(command)] + command[0]

    def uncorrected(self, q_d: Array) -> Array:
        """Error ``q_d - q`` ``(N, n)`` [rad] by this law if the path itself is commanded."""
        return uncorrected(self._required, q_d, self.t_ipo, self.law.still)

    def response(self, q: Array, length: int) -> Array:
        """Impulse response ``(length, n)`` of each joint's position to its own commands at the cycles.

        Args:
            q: posture about which the joints move ``(n,)`` [rad].
            length: rows; row ``l`` is the answer ``l`` cycles after the command.
        """
        rows, speed = 2 * max(round(REST / self.t_ipo), length), 10.0 * self.law.still
        return np.asarray(np.fft.irfft(position_response(self._required, q, speed, self.t_ipo, rows), rows, axis=0)
                          [:length])

    def _required(self, q: Array) -> Array:
        """Commands ``(N, n)`` [rad] with which the arm makes this motion, whatever it rests with at the start."""
        return self.law.commands(self.motion(held(q, after=self.n_d)), len(q), self.ahead)


def _bell(width: float) -> Array:
    """Weights of about a Gaussian's shape, of a standard deviation in rows ``(k,)``, k odd; one for none.

    ``(1 - u²)⁶`` ends with five derivatives: a law that smooths commands asks for four of the torque.
    """
    half = int(np.ceil(np.sqrt(15.0) * width)) if width else 0
    weights = (1.0 - (np.arange(-half, half + 1.0) / (half + 1.0)) ** 2) ** 6
    return np.asarray(weights / weights.sum())


def _spread_over(rows: Array, kernel: Array) -> Array:
    """Rows ``(N,)`` smoothed by weights ``(k,)``; the first and the last hold beyond the ends."""
    half = len(kernel) // 2
    return np.convolve(np.pad(rows, half, mode="edge"), kernel, mode="valid") if half else rows


def _settled(t: Array, t_ipo: float) -> Array:
    """Share of the start's offset that is removed at instants ``(N,)`` [s]: it rises smoothly from 0 to 1."""
    return eased(np.clip(t / max(SETTLE, t_ipo), 0.0, 1.0))


def _extended(before: Array, q_d: Array, rows: int) -> Array:
    """A horizon ``(n_d, n)`` that is too short, on with its last speed."""
    speed = (np.vstack([before, q_d])[-1] - np.vstack([before, q_d])[-2])
    more = np.arange(1, rows - len(q_d) + 1)[:, None]
    return np.vstack([q_d, q_d[-1] + more * speed])


def at_cycle_of(robot: Robot, law: CommandLaw | None) -> Robot:
    """The robot with the cycle of its recordings' commands, if its drive data have none."""
    named = robot.data.get("controller", {})
    if law is None or "t_ipo" in named or abs(law.t_cycle - robot.t_ipo) < 1e-9:
        return robot
    return dataclasses.replace(robot, t_ipo=law.t_cycle, t_position=min(robot.t_position, law.t_cycle),
                               t_velocity=min(robot.t_velocity, law.t_cycle))
