"""Runs the interpolation cycles: observe, plan, command; and stops on the planned path on an error."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.errors import LimitError
from ideal_robot.execution.command_governor import CommandGovernor, stops_at_once
from ideal_robot.execution.path_stop import moved_away, stopping_rows
from ideal_robot.robots.interface import RobotInterface, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import RowLog
from planning import PlanningError
from scenes.online.pacing import Pacing
from scenes.online.processes import kept_from_collector
from scenes.result import Progress

PARTED = 0.02
"""A wanted command so far from the one that keeps the limits ends the play, on the path [rad, or m]."""
LONGEST_STOP = 10.0
"""Longest that a stop of a play that is not done takes [s]."""
_LOOKED = 256
"""Cycles after which it is looked whether the disk takes what is written down."""
STANDSTILL = 1e-9
"""Change of the desired angles within a horizon below which the arm rests [rad]."""


class Cycled(Protocol):
    """Interface of tasks for ``play_cycles``; ``scenes.online.task.Task`` implements and documents it.

    Attributes:
        n_d: desired positions in a horizon, the current one included.
    """

    n_d: int

    def pacing(self, limits: Robot) -> Pacing | None:
        """The pacing that continues the path after a stop, within ``limits``; see ``Task.pacing``."""

    @property
    def q_start(self) -> Array:
        """Where the arm rests before the first cycle ``(n,)`` [rad]; see ``Task``."""

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """Adds the motor angles at the begin of a cycle; see ``Task.observe``."""

    def plan(self, t: float, q_d: Array) -> Array:
        """The horizon ``(n_d, n)`` [rad] from ``t`` on; see ``Task.plan``."""

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint angles ``(n,)`` [rad] of a horizon ``(n_d, n)`` [rad] at ``t`` [s]; see ``Task.command``."""

    def request(self, t0: float, t1: float) -> None:
        """Requests the sensors' measurements of the cycle from ``t0`` to ``t1`` [s]; see ``Task.request``."""

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """Notes the end of a cycle; an adaptive feedforward learns from it; see ``Task.collect``."""

    def away(self, q_d: Array) -> Array | None:
        """Change of the joint angles ``(n,)`` [rad] while the arm brakes; see ``Task.away``."""

    def speed(self, t: float) -> float:
        """Path speed at ``t`` [m/s], from which the arm is braked; see ``Task.speed``."""

    def done(self, t: float) -> bool:
        """Whether the cycle that began at ``t`` [s] was the last one; see ``Task.done``."""


@dataclass
class CycleLog:
    """The log of a run's cycles.

    Attributes:
        t: begin of each cycle [s].
        q_d: desired position of each cycle ``(n,)`` [rad].
        q_c: command of each cycle ``(n,)`` [rad].
        cycles: computing time of each cycle, sensors' simulation not included [s].
        limited: cycles whose command had to be changed to keep the arm's limits.
        failure: why the run ended early, or None.
    """

    t: RowLog = field(default_factory=RowLog)
    q_d: RowLog = field(default_factory=RowLog)
    q_c: RowLog = field(default_factory=RowLog)
    cycles: RowLog = field(default_factory=RowLog)
    limited: int = 0
    failure: str | None = None

    @property
    def refused(self) -> str | None:
        """Why the log is kept in memory, as the disk is full or broken; None while it is written to the disk."""
        return next((str(log.refused) for log in vars(self).values() if isinstance(log, RowLog) and log.refused), None)


@dataclass(frozen=True)
class CycleSettings:
    """How long a run may last, and how it ends.

    Attributes:
        braking: deceleration of a stop on the path [m/s²].
        rest: time for which the run continues after a stop [s].
        longest: largest duration of a run [s].
        expected: usual length, for the progress [s].
        text: name of the activity, for the progress.
    """

    braking: float
    rest: float
    longest: float
    expected: float
    text: str


def play_cycles(robot: RobotInterface, limits: Robot, task: Cycled, log: CycleLog, settings: CycleSettings,
                progress: Progress) -> None:
    """Runs cycle after cycle until the task is done, or the arm has come to rest because it could not continue.

    Args:
        robot: the arm, at rest at the task's start.
        limits: limits of the commands.
        task: the task.
        log: is written to.
        settings: how the run ends.
        progress: called now and then.
    """
    with kept_from_collector():
        _cycles(robot, limits, task, log, settings, progress)


def _cycles(robot: RobotInterface, limits: Robot, task: Cycled, log: CycleLog, settings: CycleSettings,
            progress: Progress) -> None:
    T, q = robot.t_ipo, task.q_start
    q_d = np.tile(q, (task.n_d, 1))
    stopping: Iterator[Array] | None = None
    still, before = 0, q
    governor, pacing = CommandGovernor(limits, q, t_ipo=T), task.pacing(limits)
    last = int(settings.longest / T)
    for k in range(last + int(LONGEST_STOP / T)):
        t = k * T
        begin = time.perf_counter()
        if pacing is None or not pacing.active:
            task.observe(t, q, q_d)
        else:
            task.observe(pacing.at(t), q, pacing.horizon)
        if stopping is None:
            try:
                if k % _LOOKED == 0 and (refused := log.refused) is not None:
                    raise PlanningError(f"stopped on the path at {t:.3f} s: {refused}")
                if k >= last:
                    raise PlanningError(f"not done after {settings.longest:.0f} s; stopped on the path")
                q_d = _planned(task, t, q_d)
            except (PlanningError, LimitError) as error:
                stopping = _stopped(error, log, task, q_d, (task.speed(t), settings.braking), limits, T)
        if stopping is not None:
            q_d = held(next(stopping), after=1)
        if pacing is not None and stopping is None:
            pacing.desired(k, q_d[0])
            if pacing.active:
                log.cycles.append(time.perf_counter() - begin)
                log.t.append(t)
                log.q_d.append(q_d[0].copy())
                log.q_c.append(before)
                task.request(t, t + T)
                q_d, q, before, governor = _paced(pacing, k + 1, q_d, t)
                if task.done(t):
                    return
                continue
        try:
            wanted = task.command(t, q_d)
            q_c = governor.allowed(wanted)
            if stopping is None and not (allowed := np.abs(q_c - wanted) < PARTED).all():
                j = int(np.argmin(allowed))
                why = PlanningError(f"joint {j + 1}: the command {wanted[j]:.4g} leaves the arm's limits at {t:.3f} s; "
                                    "stopped on the path")
                stopping = _stopped(why, log, task, q_d, (task.speed(t), settings.braking), limits, T)
            log.limited += not np.array_equal(q_c, wanted)
            log.cycles.append(time.perf_counter() - begin)
            log.t.append(t)
            log.q_d.append(q_d[0].copy())
            log.q_c.append(q_c)
            task.request(t, t + T)
            q = (measured := robot.cycle(q_c)).q
        except (PlanningError, LimitError) as error:
            # A command beyond the arm's limits, as from too high a gain: the controller refuses it.
            log.failure = log.failure or str(error)
            return
        task.collect(t, t + T, measured)
        if pacing is not None and pacing.needed and stopping is None:
            q_d, q, before, governor = _paced(pacing, k + 1, q_d, t)
            continue
        # The plan may be at rest while the command, within its limits, still moves towards it.
        resting, before = stops_at_once(q_c - before, limits, T), q_c
        still = (still + 1) * (stopping is not None and resting and np.allclose(q_d, q_d[0], atol=STANDSTILL))
        if still * T > settings.rest:
            return
        if stopping is None and task.done(t):
            if (away := task.away(q_d)) is None:
                return
            # The path has ended, and the tip is still in contact.
            stopping = _let_go(away, q_d, (task.speed(t), settings.braking), limits, T)
        if k % 16 == 0:
            progress(min(1.0, t / settings.expected), settings.text)


def _paced(pacing: Pacing, k: int, q_d: Array, t: float) -> tuple[Array, Array, Array, CommandGovernor]:
    """Leads an arm that stood to cycle k; the horizon then, motor angles, last command, and the commands' governor."""
    stands = pacing.reach(k, q_d, t)
    assert pacing.measured is not None
    horizon = q_d if stands is None else np.tile(stands, (len(q_d), 1))
    return horizon, pacing.measured.q, pacing.now, pacing.governor


def _planned(task: Cycled, t: float, q_d: Array) -> Array:
    """The task's plan ``(n_d, n)`` [rad]; refused where it holds values that are not numbers."""
    planned = task.plan(t, q_d)
    if not np.isfinite(planned).all():
        raise PlanningError(f"the plan at {t:.3f} s holds values that are not numbers; stopped on the path")
    return planned


def _stopped(error: Exception, log: CycleLog, task: Cycled, q_d: Array, motion: tuple[float, float], limits: Robot,
             T: float) -> Iterator[Array]:
    """Notes why the arm stops; yields rows of the last plan ``q_d (n_d, n)`` [rad] that bring it to rest.

    In the end it lets go of what it touches.
    ``motion``: speed on the path [m/s], and how it brakes [m/s²].
    """
    log.failure = str(error)
    # After a horizon as long as the plan, the arm comes to rest at its last row.
    rests = next(islice(stopping_rows(q_d[1:], T, *motion), len(q_d), None))[-1:]
    return _let_go(task.away(rests), q_d, motion, limits, T)


def _let_go(away: Array | None, q_d: Array, motion: tuple[float, float], limits: Robot, T: float) -> Iterator[Array]:
    """Rows of a plan ``q_d (n_d, n)`` [rad] on which the arm comes to rest, moved ``away (n,)`` [rad] in the end."""
    rows = stopping_rows(q_d[1:], T, *motion)
    return rows if away is None else moved_away(rows, away, limits.a_max, T)


# Acceleration when a controller gets no more absolute corrections: it keeps the last command.

def holding_share(q_c: Array, robot: Robot) -> float:
    """Acceleration that stopping commands ``(N, n)`` [rad] within one cycle takes, at their fastest.

    As a multiple of the arm's limit, the worst joint's: the whole speed is lost within one cycle.
    """
    if len(q_c) < 2:
        return 0.0
    return float(np.max(np.abs(np.diff(q_c, axis=0)) / robot.t_ipo**2 / robot.a_max))
