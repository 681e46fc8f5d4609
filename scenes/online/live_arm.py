"""A connected arm in real time, behind any maker's interface: its clock, its stops, its recording."""

from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from typing import Any, Protocol, TypeVar

import numpy as np

from ideal_robot.arrays import Array, eased_way, interpolated
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.execution.following import ANSWERS
from ideal_robot.execution.guard import Guard, StoppedError, accelerations
from ideal_robot.feedforward.command_inverse import CommandInverse
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from planning import PlanningError
from scenes.online.journal import Journal
from scenes.scene_files.scene import SceneError
from sensing.clock_relation import ClockRelation

START_TOLERANCE = np.radians(5.0)
"""How far from the start of the path the arm may stand [rad]: a calibration of the surface moves the start."""
_APPROACH = 0.3
"""Rest at the start [s]."""
_REMEMBERED = 256
"""Cycles whose times are remembered."""
_RECENT, _FOR_LOST = 20, 0.3
"""Answers whose usual time tells how many lost cycles are made good in one, and the share of it that may take."""
_SLOWEST, _SHARE = 0.35, 0.25
"""Shares of the limits of speed and acceleration that moves between postures take."""
_REPORTED = 20.0
"""Time of which states are kept [s]: a calibration by moving takes less."""
_SPARE = 0.02
"""Share of a cycle that a packet was waited for, from which on there was time left: a packet that is there is read in
less."""

_LATE_OVER, _LATE = 0.4, 0.5
"""Time [s] in which the controller may be without an answer of ours in that share of the cycles. More is no disturbance
to be made good but a cycle that this computer does not hold: what is late makes the next answer later, and forces are
felt and met too late. Runs of `glue` that went on beyond it lay 0.57 mm and more beside the line at 12 ms (0.13
otherwise), and pressed with 43 N and more at 4 ms."""

Worked = TypeVar("Worked")


def near_start(held: Array, start: Array, tolerance: float) -> Array:
    """Differences of the resting arm's joints from the path's start ``(n,)`` [rad]; raises if too far.

    Args:
        held: joint angles ``(n,)`` [rad].
        start: of the path ``(n,)`` [rad].
        tolerance: how far that may be [rad].

    Raises:
        SceneError: further.
    """
    offset = held - start
    joint = int(np.argmax(np.abs(offset)))
    if abs(offset[joint]) > tolerance:
        raise SceneError(f"joint {joint + 1} stands at {np.degrees(held[joint]):.2f}° and the path starts at "
                         f"{np.degrees(start[joint]):.2f}°; move the arm to the start of the path, or check axis_sign "
                         "and axis_zero in the robot's data")
    return offset


class FollowStoppedError(PlanningError):
    """Following has to end; the arm is brought to rest on its path."""


class Link(Protocol):
    """The common interface of the makers' links."""

    robot: Robot
    t_ipo: float
    commanded: Array
    fault: str | None
    counts: Any
    answer_times: Any
    gone_on: int
    missed: bool
    unanswered: tuple[RobotState, ...]

    @property
    def arrived(self) -> float:
        """When the last packet was read, by ``time.perf_counter`` [s]."""

    def send(self, q_c: Array) -> None:
        """Sends a command ``(n,)`` [rad]."""

    def receive(self) -> RobotState:
        """Waits for the next packet."""

    def skip(self, q_c: Array) -> None:
        """Stores the command ``(n,)`` [rad] of a cycle in which the controller continued by itself."""


class LiveArm:
    """A ``RobotInterface`` to a connected arm that writes each cycle to a journal.

    Its time, which planning and sensors share, is the number of cycles since ``begin``. If the controller stopped the
    arm in a lost cycle, path and time wait. If the controller continued (increments that are repeated), the path
    continues as well: lost cycles are planned but not commanded, and the arm goes on from where it is. Only as many
    lost cycles are caught up in one cycle as leave time for the answer; for the others the path waits. ``play_time``
    converts this computer's time to the path's.

    Attributes:
        t_ipo: cycle [s].
        clock: how the controller's clock relates to this computer's.
        between: called in every cycle after the command has gone and before the next packet is waited for.
        at_begin: called when time restarts.
        guard: checks every motion of the arm.
        q_d: desired position of the coming cycle, for the journal ``(n,)`` [rad].
        steps: cycles of the controller from the last state but one to the last; more than one where some were lost.
        pace: share of a cycle by which the path's time goes on in each.
        reported: the last states, cycle by cycle.
    """

    def __init__(self, link: Link, journal: Journal) -> None:
        self.link, self.robot, self.t_ipo, self._journal = link, link.robot, link.t_ipo, journal
        self.clock = ClockRelation()
        self.between: list[Callable[[], None]] = []
        self.at_begin: list[Callable[[], None]] = []
        self.guard = Guard(link.robot, link.commanded)
        self.q_d = link.commanded.copy()
        self.cycles, self.steps, self._waited = 0, 1, 0.0
        self._k, self.pace = 0.0, 1.0
        self._last: RobotState | None = None
        self._told: deque[float] = deque(maxlen=_REMEMBERED)
        self._played: deque[float] = deque(maxlen=_REMEMBERED)
        self._passed: deque[RobotState] = deque()
        self._missed: deque[bool] = deque(maxlen=round(_LATE_OVER / self.t_ipo))
        self.reported: deque[RobotState] = deque(maxlen=round(_REPORTED / self.t_ipo))

    @property
    def stop_reason(self) -> str | None:
        """Why following has to end; None while it has not."""
        return self.guard.reason

    def stop(self, reason: str) -> None:
        """Requests that the arm comes to rest on its path; may be called from any thread."""
        self.guard.stop(reason)

    def check(self, t: float) -> None:
        """Raises ``FollowStoppedError`` where following has to end at ``t`` [s]."""
        if self.link.fault is not None:
            self.stop(self.link.fault)
        if self.guard.held is not None:
            self.stop(self.guard.held)
        if self.stop_reason is not None:
            raise FollowStoppedError(f"stopped on the path at {t:.3f} s: {self.stop_reason}")

    def begin(self) -> None:
        """Restarts time: the next cycle is the first."""
        self._k, self.pace = 0.0, 1.0
        self._journal.begin()
        self._passed.clear()
        self._told.clear()
        self._played.clear()
        for work in self.at_begin:
            work()

    @property
    def t(self) -> float:
        """Time since ``begin`` [s]."""
        return self._k * self.t_ipo

    @property
    def paced(self) -> bool:
        """Whether the path advances by less than a cycle in each cycle."""
        return self.pace != 1.0

    @property
    def behind(self) -> bool:
        """Whether this computer is late: the last packet had arrived before it was waited for."""
        return self._waited <= _SPARE * self.t_ipo

    @property
    def controller_time(self) -> float:
        """Controller time of the last cycle [s]; NaN before the first."""
        return float("nan") if self._last is None else self._last.t

    def cycle(self, q_c: Array) -> RobotState:
        """Runs one cycle under the guard; the state's time is that since ``begin``.

        Raises:
            InputError, LimitError: a command that cannot be.
            FollowStoppedError: the arm is gone.
        """
        state = self._cycle(q_c)
        if self.link.fault is not None:
            self.stop(self.link.fault)
        self.guard.look(state.t, q_c, state.q)
        return state

    def _cycle(self, q_c: Array) -> RobotState:
        if self._passed:
            # The pending answer is to the last packet: this cycle is over already.
            self.link.skip(q_c)
            return self._counted(self._passed.popleft())
        try:
            self.link.send(q_c)
            sent = self.link.commanded
            for work in self.between:
                work()
            begun = time.perf_counter()
            state = self.link.receive()
            self._waited = self.link.arrived - begun
        except IdealRobotError as error:
            if isinstance(error, PlanningError):
                raise
            # Missed answers may be the controller's reason to stop.
            late = f"; {self._late()}" if any(self._missed) else ""
            raise FollowStoppedError(f"stopped at {self.t:.3f} s: {error}{late}") from error
        self.cycles += 1
        self.clock.add(state.t, self.link.arrived)
        first = self._made_good(state)
        # Cycles that are caught up lie before the state.
        self._journal.add(self.t + self.t_ipo * (self.pace + len(self._passed)), state, self.q_d, sent)
        self._check_late()
        return self._counted(first)

    def _check_late(self) -> None:
        """Ends following where too many of the last cycles had no answer of ours in time."""
        self._missed.append(self.link.missed)
        if sum(self._missed) > _LATE * (self._missed.maxlen or 1):
            self.stop(f"{self._late()}: take a longer cycle (--cycle), a computer with less to do, or look at the "
                      "network")

    def _late(self) -> str:
        """How many of the last cycles had no answer in time, in words."""
        return (f"in {sum(self._missed)} of the last {len(self._missed)} cycles of {1e3 * self.t_ipo:g} ms the "
                f"controller had no answer in time, which takes {1e3 * self._usual():.1f} ms")

    def _usual(self) -> float:
        """Usual time of the last answers [s]."""
        times = self.link.answer_times[-_RECENT:]
        return float(sum(times)) / max(len(times), 1)

    def _counted(self, state: RobotState) -> RobotState:
        """One cycle further; torques of a state that is more than a cycle behind the one before belong to no motion."""
        self._k += self.pace
        self.steps = 1 if self._last is None else max(round((state.t - self._last.t) / self.t_ipo), 1)
        self._told.append(state.t)
        self._played.append(self.t)
        self._last = state
        counted = replace(state, t=self.t, tau=state.tau if self.steps == 1 else np.full_like(state.q, np.nan))
        self.reported.append(counted)
        return counted

    def _made_good(self, state: RobotState) -> RobotState:
        """The state to go on with: the first of those unheard of, which lie between the last two."""
        if not self.link.gone_on or self._last is None:
            return state
        count = min(self.link.gone_on, max(int(_FOR_LOST * self.t_ipo / max(self._usual(), 1e-6)), 1))
        # Some of the lost states may have arrived, too late for an answer.
        heard = [self._last, *(one for one in self.link.unanswered if self._last.t < one.t < state.t), state]
        times, steps = np.array([one.t for one in heard]), self.link.gone_on + 1
        between = times[0] + np.arange(steps - count, steps) / steps * (times[-1] - times[0])
        angles, torques = (interpolated(between, times, np.array(rows))
                           for rows in ([one.q for one in heard], [one.tau for one in heard]))
        self._passed += [replace(state, t=float(t), q=q, tau=tau)
                         for t, q, tau in zip(between, angles, torques, strict=True)]
        self._passed.append(state)
        return self._passed.popleft()

    def play_time(self, host: float) -> float:
        """Time since ``begin`` that belongs to this computer's time ``host`` [s]; NaN before the first cycle."""
        stamps, played = self._told, self._played
        if not stamps:
            return float("nan")
        stamp = self.clock.stamp(host)
        i = bisect_right(stamps, stamp)
        if i == 0:
            return played[0] + stamp - stamps[0]
        if i == len(stamps):
            return played[-1] + stamp - stamps[-1]
        share = (stamp - stamps[i - 1]) / (stamps[i] - stamps[i - 1])
        return played[i - 1] + share * (played[i] - played[i - 1])

    def stood(self, host: float) -> bool:
        """Whether the path waited at this computer's time ``host`` [s], so that sensor data of then have no place."""
        i = bisect_right(self._told, self.clock.stamp(host))
        return 0 < i < len(self._told) and self._played[i] == self._played[i - 1]

    def approach(self, start: Array) -> None:
        """Moves the arm from where it rests to the start ``(n,)`` [rad], which has to be near.

        Raises:
            SceneError: it is not near.
            FollowStoppedError: see ``lead``.
        """
        near_start(self.link.commanded, start, START_TOLERANCE)
        self.lead(moves(self.robot, [self.link.commanded.copy(), start], _APPROACH))

    def lead(self, commands: Array) -> None:
        """Executes commands ``(N, n)`` [rad] from rest to rest, as fast as the guard permits.

        Raises ``FollowStoppedError`` where it has to end; the arm then is at rest and touches nothing.
        """
        def cycle(q_c: Array) -> RobotState:
            self.q_d = q_c
            return self.cycle(q_c)

        if self.guard.watches:
            commands = self.timed(commands)
        try:
            self.guard.go(cycle, commands)
        except StoppedError as error:
            raise FollowStoppedError(f"stopped at {self.t:.3f} s: {error}") from error

    def timed(self, *ways: Array) -> Any:
        """Commands timed as fast as the guard permits, see ``Guard.timed``; one result per path given."""
        timed = self.meanwhile(lambda: [self.guard.timed(way) for way in ways])
        return timed if len(ways) > 1 else timed[0]

    @contextmanager
    def motion(self) -> Iterator[None]:
        """Brings the arm to rest without contact where the motion in the block ends early."""
        with self.guard.motion(self.cycle):
            yield

    @contextmanager
    def doing(self, work: Callable[[], None]) -> Iterator[None]:
        """Within the block also does this work in every cycle, after the command was sent."""
        self.between.append(work)
        try:
            yield
        finally:
            self.between.remove(work)

    def meanwhile(self, work: Callable[[], Worked]) -> Worked:
        """The result of work that takes longer than a cycle; meanwhile the arm is commanded to stay at rest.

        Raises whatever the work does, or ``FollowStoppedError``.
        """
        with self.motion(), ThreadPoolExecutor(1) as beside:
            result = beside.submit(work)
            while not result.done():
                self.check(self.t)
                self.cycle(self.q_d)
        return result.result()


def moves(robot: Robot, postures: list[Array], rest: float) -> Array:
    """Commands ``(N, n)`` from posture to posture with a rest at each.

    Args:
        robot: cycle and limits.
        postures: joint angles ``(n,)`` each [rad]; the arm is at the first one.
        rest: at each [s].
    """
    T = robot.t_ipo
    v = _SLOWEST * np.where(np.isfinite(robot.v_max), robot.v_max, 1.0)
    a = _SHARE * accelerations(robot)
    rows = [postures[0][None]]
    for start, end in pairwise(postures):
        rows += [eased_way(start, end, (v, a), T), np.tile(end, (max(round(rest / T), 1), 1))]
    return np.concatenate(rows)


# An arm with another interpolation cycle, and the response time of its loop.

def at_cycle(arm: Robot, cycle: float) -> Robot:
    """The arm with another interpolation cycle [s]; the inner cycles are shortened until they fit into it.

    Raises:
        InputError: no cycle that a controller has.
    """
    if not (1e-3 <= cycle <= 0.1 and math.isclose(1e3 * cycle, round(1e3 * cycle))):
        raise InputError("expected whole milliseconds from 0.001 to 0.1 s", field="--cycle", value=cycle)
    grid = 1e-6
    position = math.gcd(round(cycle / grid), round(arm.t_position / grid))
    velocity = math.gcd(position, round(arm.t_velocity / grid))
    return replace(arm, t_ipo=cycle, t_position=grid * position, t_velocity=grid * velocity)


def response_of(model: Model, arm: Robot, delay: int = 0) -> Array:
    """Impulse response ``(L, n)`` of each joint behind its identified controller, of commands that come at the cycles.

    Args:
        model: with a command's law or a controller.
        arm: cycle.
        delay: cycles between hand-over of a command and the start of its interpolation.
    """
    length = math.ceil(ANSWERS / arm.t_ipo)
    if model.by_law:
        return CommandInverse(model, arm, delay=delay).response(arm.home, length)
    return np.asarray(LinearLoop.of(loop_model(model, arm, delay=delay), arm.home, length=length).g)


def answers_within(response: Array, t_ipo: float) -> float:
    """Time in which a response ``(L, n)`` has come to 97 % of a command, and half of it more [s]; cycle in [s]."""
    open_until = (np.abs(np.cumsum(response, axis=0) - 1.0) > 0.03).any(axis=1)
    return float(1.5 * t_ipo * (2 + np.flatnonzero(open_until)[-1]))
