r"""Answers Franka's controller every millisecond from commands that are known some milliseconds ahead.

One command per cycle ``T`` is interpolated to milliseconds by a quadratic B-spline, whose speed is continuous and whose
acceleration is that of the commands,

.. math:: q(s) = \tfrac12 \left[(1 - s)^2 q_{k-2} + (1 + 2 s - 2 s^2)\, q_{k-1} + s^2 q_k\right], \qquad 0 < s \le 1 ,

half a cycle behind them. A program that computes commands in Python cannot answer every millisecond: it sometimes
computes for longer, and ``libfranka`` blocks other threads while it waits for a state. So a separate process answers. A
command is executed a few milliseconds after the state that it answers. It comes with the expected following ones, which
are executed if the next one is late; after the last of them the arm is braked.
"""

from __future__ import annotations

import gc
import math
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.interface import CatchUp

AXES, PERIOD = 7, 1e-3
_AGAIN = 0.2
"""Time between two attempts to connect [s]."""
_STARTS, _SILENCE = 30.0, 2.0
"""How long the process may take to start, and to say something [s]: the library waits a second for a state."""
_PROGRAM = "import sys; from ideal_robot.fci.milliseconds import main; main(int(sys.argv[1]))"
_BRAKES = 0.5
"""Share of the acceleration limit with which an arm is braked of which no command is known."""
_SAID = {
    "communication_constraints_violation": "answers came too late or were lost: a computer with less to do, real-time "
                                           "priority, a cable of its own",
    "joint_motion_generator_position_limits_violation": "a command beyond the joint limits",
    "joint_motion_generator_velocity_limits_violation": "a command faster than the joints may be",
    "joint_motion_generator_velocity_discontinuity": "the commands' speed leaps: a smoother or slower path",
    "joint_motion_generator_acceleration_discontinuity": "the commands' acceleration leaps: a smoother or slower path",
    "joint_position_motion_generator_start_pose_invalid": "the first command is not where the arm stands",
    "joint_position_limits_violation": "a joint is beyond its limits: guide it back by hand",
    "joint_velocity_violation": "a joint is faster than it may be",
    "joint_reflex": "a collision was detected: external torque of a joint above its threshold",
    "cartesian_reflex": "a collision was detected: external force above its threshold",
    "self_collision_avoidance_violation": "the arm came too near to itself",
    "tau_j_range_violation": "a torque sensor is beyond its range: less load or acceleration",
    "power_limit_violation": "the motors take too much power: a slower path",
    "instability_detected": "the arm oscillates: check the load that is set",
    "User Stop pressed": "the user stop is pressed: release it",
}
"""What the controller's reflexes say, and what helps; others are said by their names."""
_SILENT = "UDP receive: Timeout"
"""What the library says where no state comes: nobody knows then what the arm does."""
_MODES = {"UserStopped": "the user stop is pressed: release it", "Guiding": "the arm is being guided by hand",
          "Reflex": "the arm has stopped by a reflex: recover it in Desk",
          "Other": "brakes are closed, or FCI is not active"}


class FciError(IdealRobotError):
    """The controller is not reachable, refuses to be commanded, or has stopped the arm."""


class FciState(NamedTuple):
    """State of the controller in one millisecond.

    Attributes:
        tick: its number.
        q, q_d, dq_d: measured and commanded joint angles, and the commands' speed ``(7,)`` [rad, rad/s].
        tau, tau_ext: measured torques, and those estimated to be external ``(7,)`` [N m].
        wrench: estimated at the tool ``(6,)`` [N, N m].
        mode: number of the arm's mode.
        success: share of the last commands that came in time.
    """

    tick: int
    q: Array
    q_d: Array
    dq_d: Array
    tau: Array
    tau_ext: Array
    wrench: Array
    mode: float
    success: float


class FciMotion:
    """The motion of one arm by ``pylibfranka``, with its errors in plain words.

    Args:
        host: address of the controller.
        cartesian: whether the controller's Cartesian impedance holds the commanded joints, not its joint impedance.
        patience: how long the controller is waited for [s].

    Raises:
        FciError: no controller, or an arm that cannot be commanded now.

    Attributes:
        tick: of the last state.
        begun: whether the motion has begun.
        stopped: whether the controller has ended it.
    """

    def __init__(self, host: str, cartesian: bool, patience: float) -> None:
        import pylibfranka

        self._library, deadline = pylibfranka, Deadline.within(patience)
        self._cartesian = cartesian
        self._franka: Any = None
        self._control: Any = None
        self.tick, self.begun, self.stopped = 0, False, False
        while self._franka is None:
            try:
                self._franka = pylibfranka.Robot(host, pylibfranka.RealtimeConfig.kIgnore)
            except (pylibfranka.FrankaException, RuntimeError) as error:
                if deadline.left < _AGAIN:
                    raise FciError(f"no controller at {host} ({_line(error)}); check address, cable, and that FCI "
                                   "is activated in Desk") from error
                time.sleep(_AGAIN)

    def look(self) -> FciState:
        """The state of an arm before its motion; raises FciError where it cannot be read."""
        state = self._asked(self._franka.read_once)
        if state.robot_mode.name in _MODES:
            raise FciError(f"the arm cannot be commanded: {_MODES[state.robot_mode.name]}")
        if state.current_errors:
            raise FciError(f"the arm has stopped: {said(str(state.current_errors))}; recover it in Desk")
        return self._noted(state)

    def begin(self) -> FciState:
        """Begins the motion at the arm's present setpoint; returns the first state."""
        mode = self._library.ControllerMode
        self._control = self._asked(lambda: self._franka.start_joint_position_control(
            mode.CartesianImpedance if self._cartesian else mode.JointImpedance))
        self.begun = True
        return self.read()

    def read(self) -> FciState:
        """Waits for the next state; raises FciError where the controller has stopped the arm."""
        state, _ = self._asked(self._control.readOnce)
        return self._noted(state)

    def write(self, q: Array) -> None:
        """Commands joint angles ``(7,)`` [rad] of the coming millisecond."""
        self._asked(lambda: self._control.writeOnce(self._library.JointPositions(q.tolist())))

    def end(self, q: Array) -> None:
        """Ends the motion at joint angles ``(7,)`` [rad], if the controller has not, and closes the connection."""
        # A controller that has ended the motion by itself answers no command any more.
        if self._control is not None and not self.stopped:
            command = self._library.JointPositions(q.tolist())
            command.motion_finished = True
            with suppress(self._library.FrankaException, RuntimeError):
                self._control.writeOnce(command)
        self._control = self._franka = None

    def _noted(self, state: Any) -> FciState:
        self.tick = round(state.time.to_sec() / PERIOD)
        return FciState(self.tick, np.array(state.q), np.array(state.q_d), np.array(state.dq_d), np.array(state.tau_J),
                        np.array(state.tau_ext_hat_filtered), np.array(state.K_F_ext_hat_K),
                        float(state.robot_mode.value), float(state.control_command_success_rate))

    def _asked(self, call: Any) -> Any:
        """What a call of the library gives; its errors in the field's words."""
        try:
            return call()
        except (self._library.FrankaException, RuntimeError) as error:
            self.stopped = True
            if _SILENT in _line(error):
                raise FciError("the controller is silent; check cable and power, and that FCI is activated in Desk "
                               f"({_line(error)})") from error
            raise FciError(f"the controller has stopped the arm: {said(_line(error))}") from error


class Knots:
    """Commands by cycle, interpolated to every millisecond.

    Args:
        start: present setpoint of the arm ``(7,)`` [rad].
        steps: milliseconds of a cycle.
        a_max: acceleration limits ``(7,)`` [rad/s²].

    Attributes:
        used: cycle of the last command that is in force.
        late: commands that came when another was in force in their place.
    """

    def __init__(self, start: Array, steps: int, a_max: Array) -> None:
        self._steps, self._least = steps, _BRAKES * a_max * (steps * PERIOD)**2
        self._last = np.tile(start, (4, 1))
        self._coming: dict[int, Array] = {}
        self._expected, self._first = np.zeros((0, len(start))), 0
        self.used, self.late = -1, 0

    def give(self, cycle: int, rows: Array) -> None:
        """Adds the command of a cycle and the expected ones of the following cycles ``(m, 7)`` [rad]."""
        self.late += cycle <= self.used
        # For cycles without a command the earlier expected ones are used.
        for k, row in enumerate(self._expected[1 : cycle - self._first], self._first + 1):
            if k > self.used:
                self._coming[k] = row
        if cycle > self.used:
            self._coming[cycle] = rows[0]
        self._expected, self._first = rows, cycle

    @property
    def in_force(self) -> Array:
        """The last command in force ``(7,)`` [rad]."""
        return np.asarray(self._last[3])

    @property
    def rest(self) -> bool:
        """Whether the interpolated motion is at rest."""
        known = self._coming or self._first + len(self._expected) > self.used + 1
        return not known and bool(np.array_equal(self._last[0], self._last[3]))

    def at(self, millisecond: int) -> Array:
        """Joint angles ``(7,)`` [rad] of a millisecond; number 1 is the first one of the first cycle's command.

        The one before the last call is still available.
        """
        while self.used < (millisecond - 1) // self._steps:
            self._go_on()
        before = (millisecond - 1) // self._steps < self.used
        first, middle, last = self._last[:-1] if before else self._last[1:]
        if self._steps == 1:
            return last
        s = (millisecond - (self.used - before) * self._steps) / self._steps
        return np.asarray(0.5 * ((1 - s)**2 * first + (1 + 2 * s - 2 * s**2) * middle + s**2 * last))

    def _go_on(self) -> None:
        """The next command comes into force: the one given, or where none is, one nearer to rest."""
        self.used += 1
        row, i = self._coming.pop(self.used, None), self.used - self._first
        if row is None and 0 <= i < len(self._expected):
            row = self._expected[i]
        if row is None:
            step = self._last[3] - self._last[2]
            count = max(math.ceil(float(np.max(np.abs(step) / self._least))), 1)
            row = self._last[3] + (1.0 - 1.0 / count) * step
        self._last = np.vstack([self._last[1:], row])


class Report(NamedTuple):
    """Report on one cycle, for the program that computes commands.

    Attributes:
        cycle: its number.
        state: at its end.
        unanswered: milliseconds so far that had no answer.
        late: commands so far that came when another was in force in their place.
    """

    cycle: int
    state: FciState
    unanswered: int
    late: int


class Wanted(NamedTuple):
    """Settings by which an arm is answered.

    Attributes:
        host, cartesian, patience: see ``FciMotion``.
        steps: milliseconds of a cycle.
        queue: delay after which a command is executed [ms].
        a_max, v_max: limits of the joints ``(7,)`` [rad/s², rad/s].
    """

    host: str
    cartesian: bool
    patience: float
    steps: int
    queue: int
    a_max: Array
    v_max: Array


class Answering:
    """Answers every millisecond of a motion.

    After missed milliseconds, which the controller extrapolates, the next ones move from its setpoint back to the
    commands.

    Args:
        motion: the arm's, not yet begun.
        wanted: settings of the answers.

    Attributes:
        knots: the commands; ``begin`` resets them.
    """

    def __init__(self, motion: FciMotion, wanted: Wanted) -> None:
        self._motion, self._given = motion, wanted
        # Planning a return takes longer than a millisecond, so it is prepared.
        self._catch_up = CatchUp(wanted.a_max, wanted.v_max, PERIOD)
        self.knots = Knots(np.zeros(AXES), wanted.steps, wanted.a_max)
        self._began = self._cycle = self._unanswered = 0

    def begin(self, rows: Array) -> None:
        """Begins the motion with the first command and the expected following ones ``(m, 7)`` [rad]."""
        self._state = first = self._motion.begin()
        self.knots = Knots(first.q_d, self._given.steps, self._given.a_max)
        self.knots.give(0, rows)
        self._began, self._wanted, self._step = first.tick, first.q_d, np.zeros(AXES)

    def write(self) -> None:
        """Answers the last state: commands the coming millisecond."""
        self._motion.write(self._led_back(self._commanded(self._since + 1)))

    def read(self) -> Report | None:
        """Waits for the next state; returns a report at the end of a cycle."""
        before, self._state = self._state.tick, self._motion.read()
        if (missed := max(self._state.tick - before - 1, 0)) > 0:
            self._unanswered += missed
            self._missed()
        if (cycle := self._since // self._given.steps) == self._cycle:
            return None
        self._cycle = cycle
        return Report(cycle, self._state, self._unanswered, self.knots.late)

    def _commanded(self, millisecond: int) -> Array:
        return self.knots.at(max(millisecond - self._given.queue, 0))

    def _led_back(self, q: Array) -> Array:
        self._step, self._wanted = q - self._wanted, q
        return q + self._catch_up.next(self._step) if self._catch_up.active else q

    def _missed(self) -> None:
        """The way begins from where the controller has the arm to what was wanted in the milliseconds missed."""
        last = self._commanded(self._since)
        step = last - self._commanded(self._since - 1)
        self._catch_up.start(self._state.q_d - last, PERIOD * self._state.dq_d - step, np.zeros(AXES), step)
        self._wanted, self._step = last, step

    @property
    def _since(self) -> int:
        """Milliseconds since the motion has begun."""
        return self._state.tick - self._began


def said(errors: str) -> str:
    """The controller's errors in words, with a remedy; unknown ones are returned unchanged.

    >>> said('["joint_reflex"]')
    'a collision was detected: external torque of a joint above its threshold (joint_reflex)'
    """
    known = [f"{text} ({name})" for name, text in _SAID.items() if name in errors]
    return "; ".join(known) or errors


def _line(error: BaseException) -> str:
    """An error of the library on one line."""
    return " ".join(str(error).split())


# The answering process.

def answer(pipe: Connection) -> None:
    """Runs the process that answers the controller: on request, then, after the first command, every millisecond.

    The pipe receives ``Wanted``; None as a request, answered by an ``FciState``; and ``(cycle, rows)`` as commands.
    After the first command it returns reports, and the text of an error if the motion ends. If the pipe closes, the arm
    is braked after the last known command, and the motion ends.
    """
    wanted: Wanted = pipe.recv()
    try:
        motion = FciMotion(wanted.host, wanted.cartesian, wanted.patience)
        answering, ended = Answering(motion, wanted), False
        pipe.send(motion.look())
        while (told := pipe.recv()) is None:
            pipe.send(motion.look())
        _undisturbed()
        answering.begin(told[1])
        knots = answering.knots
        while not (ended and knots.rest):
            answering.write()
            report = answering.read()
            try:
                if report is not None and not ended:
                    pipe.send(report)
                while not ended and pipe.poll():
                    knots.give(*pipe.recv())
            except (EOFError, OSError):
                ended = True
        motion.end(knots.in_force)
    except FciError as error:
        with suppress(OSError):
            pipe.send(str(error))
    except EOFError:
        return


def _undisturbed() -> None:
    """Nothing is collected while a millisecond waits, and who answers comes before who computes commands."""
    gc.collect()
    gc.freeze()
    gc.disable()
    if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_FIFO:
        priority = min(os.sched_getparam(0).sched_priority + 1, os.sched_get_priority_max(os.SCHED_FIFO))
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            os.sched_setaffinity(0, range(os.cpu_count() or 1))


class Process:
    """Runs ``answer`` in a separate process.

    Args:
        wanted: settings of the answers to the arm.

    Raises:
        FciError: see ``FciMotion``.

    Attributes:
        rest: state of the arm before the motion.
    """

    def __init__(self, wanted: Wanted) -> None:
        # A missing library is reported here, before the process starts.
        import pylibfranka  # noqa: F401

        ours, theirs = Pipe()
        with theirs:
            self._process = subprocess.Popen([sys.executable, "-c", _PROGRAM, str(theirs.fileno())],
                                             pass_fds=(theirs.fileno(),), start_new_session=True)
        self._pipe = ours
        self._pipe.send(wanted)
        self.rest: FciState = self._told(wanted.patience + _STARTS)

    def look(self) -> FciState:
        """The state of an arm before its motion."""
        self._pipe.send(None)
        state: FciState = self._told(_SILENCE)
        return state

    def command(self, cycle: int, rows: Array) -> None:
        """Sends the command of a cycle, and the expected following ones ``(m, 7)`` [rad]."""
        # The reason why the process has ended is its last message.
        with suppress(OSError):
            self._pipe.send((cycle, rows))

    def reports(self) -> list[Report]:
        """Waits for a report and returns all since the last call; raises FciError where the motion has ended."""
        reports: list[Report] = [self._told(_SILENCE)]
        while self._pipe.poll():
            reports.append(self._told(0.0))
        return reports

    def end(self) -> None:
        """Ends the motion at its last command, and the process."""
        self._pipe.close()
        try:
            self._process.wait(_SILENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _told(self, timeout: float) -> Any:
        try:
            told = "the process that answers the controller is silent"
            if self._pipe.poll(timeout):
                told = self._pipe.recv()
        except (EOFError, OSError):
            told = "the process that answers the controller has ended"
        if isinstance(told, str):
            self._pipe.close()
            raise FciError(told)
        return told


class Here:
    """A ``Process`` within this process: milliseconds are answered between two commands.

    Args:
        wanted: see ``Process``.
    """

    def __init__(self, wanted: Wanted) -> None:
        self._motion = FciMotion(wanted.host, wanted.cartesian, wanted.patience)
        self._answering, self.rest = Answering(self._motion, wanted), self._motion.look()

    def look(self) -> FciState:
        """The state of an arm before its motion; see ``Process``."""
        return self._motion.look()

    def command(self, cycle: int, rows: Array) -> None:
        """Sends the command of a cycle, and the expected following ones ``(m, 7)`` [rad]; see ``Process``."""
        if self._motion.begun:
            self._answering.knots.give(cycle, rows)
        else:
            self._answering.begin(rows)
        self._answering.write()

    def reports(self) -> list[Report]:
        """Waits for a report and returns it in a list; see ``Process.reports``."""
        while (report := self._answering.read()) is None:
            self._answering.write()
        return [report]

    def end(self) -> None:
        """Ends the motion at its last command, and the process; see ``Process``."""
        self._motion.end(self._answering.knots.in_force)


def main(descriptor: int) -> None:
    """Runs the answering process on a pipe's file descriptor."""
    # Ctrl-C is handled by the process that computes the commands, which brings the arm to rest.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answer(Connection(descriptor))
