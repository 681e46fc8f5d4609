"""The task that all scenes share, simulated or on devices: sense, estimate, plan, command ([L] Fig. 1).

Following a line, a surface, a contour or a line on a surface differs in the sensors and in the follower. Simulation and
devices differ in the ``RobotInterface``, the ``Camera`` and the ``ForceSensor``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError, RaisedBy
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from planning.follower import Follower
from scenes.methods import SceneMethod
from scenes.online.live_arm import LiveArm
from scenes.online.log import TaskLog
from scenes.online.pacing import Pacing


class Work(IntEnum):
    """Progress on a sensor's data: nothing done, a part done, or fused into the map."""

    NOTHING = 0
    PREPARED = 1
    FUSED = 2


BESIDE = 2.0
"""Cycles behind a standstill in which poses are interpolated from those before it."""


class Sensor(ABC):
    """A sensor of the deviation from the reference, with its own direction and errors.

    Attributes:
        at_once: cycle from which on there is time to fuse between a controller's packet and its answer [s].
        in_one: cycle from which on there is time to fuse and to plan anew behind one command [s]; in shorter ones only
            one of these is done per cycle.
        owes: whether data have been fused since the last health check.
    """

    at_once = 0.0
    in_one = 0.0
    owes = False

    def take(self, t: float) -> None:
        """Reads what must be known at ``t`` [s] before the command, such as a force above its limit.

        Raises:
            PlanningError: the sensor data require a stop.
        """
        return

    @abstractmethod
    def fuse(self, t: float) -> Work:
        """Fuses what has arrived by ``t`` [s], or does the next part of it."""

    def look(self) -> None:
        """Checks the device's health by what was fused since the last call."""
        return

    def check(self, t: float) -> None:
        """Raises ``PlanningError`` where the line or the surface has been lost by ``t`` [s]."""
        return

    def bears(self, t: float, q_d: Array) -> None:
        """Raises ``PlanningError`` where a horizon ``(n_d, n)`` [rad] must not be commanded at ``t`` [s]."""
        return

    def request(self, t0: float, t1: float) -> None:
        """Requests the device's measurements of the cycle from ``t0`` to ``t1`` [s]."""
        return

    def stood(self, t: float) -> None:
        """Notes that the arm stood still: data from before ``t`` [s] belong to unexpected places."""
        return

    def ended(self, t0: float, measured: RobotState, torque: Array | None) -> None:
        """Notes the end of the cycle that began at ``t0`` [s].

        Args:
            t0: its begin [s].
            measured: motor angles reported at its end.
            torque: joint torques of the contact that were expected ``(n_d, n)`` [N m].
        """
        return

    def away(self, q_d: Array) -> Array | None:
        """Change of the joint angles that releases a contact, see ``Task.away``; None without contact."""
        return None


class ArmAngles(Protocol):
    """Interface of estimates of arm angles from motor angles."""

    def at(self, t: float, q: Array, q_d: Array, torque: Array | None, steps: int) -> Array:
        """Arm angles ``(n,)`` [rad] of the arm as drawn at the begin of a cycle.

        Args:
            t: begin of the cycle [s].
            q: motor angles ``(n,)`` [rad].
            q_d: horizon of the last cycle ``(n_d, n)`` [rad].
            torque: joint torques of the contact that were expected then ``(n_d, n)`` [N m].
            steps: cycles of the controller since the last motor angles.
        """


class Baseline(Protocol):
    """A baseline instead of planning and ideal robot: no correction, or direct feedback."""

    def horizon(self, t: float, q_d: Array) -> Array:
        """Desired positions ``(n_d, n)`` [rad] from ``t`` [s] on, given ``q_d`` of the cycle before."""

    def command(self, t: float, q_d: Array) -> Array | None:
        """Commanded joint angles ``(n,)`` [rad]; None where the feedforward computes them from the plan."""

    def done(self, t: float) -> bool:
        """Whether the cycle that began at ``t`` [s] is the last one; see ``Follower.done``."""


PRESSING = 0.1
"""Speed from which an arm that presses is braked at least [m/s]: a stop at rest takes some time, too."""


class Task:
    """Following with one method; ``scenes.online.cycle.play_cycles`` runs its cycles.

    Args:
        follower: plans the desired path from the sensors' fused map.
        sensors: the more urgent first.
        method: the method that computes ``q_c`` from ``q_d``.
        feedforward: of the method.
        arm_angles: estimates arm angles behind the gears.
        log: is written to.
        baseline: in the place of the planned path; None where the follower's is gone.

    Attributes:
        arm: the connected arm; None in simulation.
        ahead: computation ahead of a cycle; None where all is done in the cycle.
    """

    def __init__(self, follower: Follower, sensors: Sequence[Sensor], method: SceneMethod, feedforward: Feedforward,
                 arm_angles: ArmAngles, log: TaskLog, baseline: Baseline | None = None) -> None:
        self.follower, self.sensors, self.method, self.log = follower, list(sensors), method, log
        self.feedforward, self.n_d, self._baseline = feedforward, follower.n_d, baseline
        self._angles = arm_angles
        self._state = feedforward.init(follower.q_start)
        self._torque = follower.contact_torque(np.tile(follower.q_start, (self.n_d, 1)))
        self._lets_go = False
        self._passed: Array | None = None
        self.arm: LiveArm | None = None
        self.ahead: Ahead | None = None

    def lead(self, arm: LiveArm) -> None:
        """Sets the connected arm, which rests at the start until its first cycle is planned."""
        ahead = Ahead(self, arm)
        if ahead.plans:
            arm.meanwhile(ahead.begin)
        self.arm, self.ahead = arm, ahead
        arm.between.append(ahead.work)

    def learn(self, moved: Iterable[RobotState]) -> None:
        """Lets an adaptive feedforward learn from the controller's reports of the last motion."""
        with RaisedBy(f"method {self.method.key}: observe"):
            for measured in moved:
                self._state = self.feedforward.observe(self._state, measured)

    @property
    def q_start(self) -> Array:
        """Where the arm rests before the first cycle ``(n,)`` [rad]."""
        return self.follower.q_start

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """Adds the motor angles at the begin of a cycle.

        Args:
            t: begin of the cycle [s].
            q: motor angles ``(n,)`` [rad].
            q_d: horizon of the last cycle ``(n_d, n)`` [rad].
        """
        if self._passed is None:
            self.passed(t, q, q_d)
        passed, self._passed = self._passed, None
        assert passed is not None
        self.follower.observe(t, passed)

    def passed(self, t: float, q: Array, q_d: Array) -> None:
        """Notes the end of a controller cycle; one cycle of the path may have several.

        Args:
            t: of the path at its end [s].
            q: motor angles then ``(n,)`` [rad].
            q_d: horizon of the cycle ``(n_d, n)`` [rad].
        """
        self._passed = self._angles.at(t, q, q_d, self._torque, 1 if self.arm is None else self.arm.steps)

    def plan(self, t: float, q_d: Array) -> Array:
        """The horizon ``(n_d, n)`` [rad] from ``t`` on, from what the sensors have delivered by ``t``.

        Raises:
            PlanningError, LimitError: the path cannot be continued; the arm is then stopped on the last plan.
        """
        if self.arm is not None:
            self.arm.check(t)
        for sensor in self.sensors:
            sensor.take(t)
        prepared = None if self.ahead is None else self.ahead.taken(t)
        for sensor in self.sensors if self.ahead is None or self.ahead.idle else self.ahead.at_once:
            sensor.fuse(t)
        for sensor in self.sensors:
            sensor.check(t)
        q_d = self._planned(t, q_d) if prepared is None else prepared
        for sensor in self.sensors:
            sensor.bears(t, q_d)
        return q_d

    def _planned(self, t: float, q_d: Array) -> Array:
        return self.follower.horizon(t) if self._baseline is None else self._baseline.horizon(t, q_d)

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint angles ``(n,)`` [rad] of a horizon ``(n_d, n)`` [rad] at ``t`` [s]."""
        if self.arm is not None:
            self.arm.q_d = q_d[0]
        torque = self.follower.contact_torque(q_d)
        self._torque = torque = np.zeros_like(q_d) if self._lets_go and torque is not None else torque
        if self._baseline is not None and (q_c := self._baseline.command(t, q_d)) is not None:
            return q_c
        n_d = self.feedforward.n_d
        with RaisedBy(f"method {self.method.key}: step"):
            q_c, self._state = self.feedforward.step(self._state, q_d[:n_d], None if torque is None else torque[:n_d])
        return q_c

    def request(self, t0: float, t1: float) -> None:
        """Requests the sensors' measurements of the cycle from ``t0`` to ``t1`` [s]."""
        log, follower = self.log, self.follower
        log.phase.append(follower.phase.value)
        log.s.append(follower.s_at(t0))
        log.planned.append(follower.desired_deviation(t0))
        for sensor in self.sensors:
            sensor.request(t0, t1)

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """Notes the end of a cycle; an adaptive feedforward learns from it.

        Args:
            t0: its begin [s].
            t1: its end [s].
            measured: motor angles reported at its end.
        """
        self.learn([measured])
        for sensor in self.sensors:
            sensor.ended(t0, measured, self._torque)

    def pacing(self, limits: Robot) -> Pacing | None:
        """The pacing that continues the path after a stop, within ``limits``; None in simulation."""
        return None if self.arm is None else Pacing(self.arm, limits, self)

    def stood(self, t: float) -> None:
        """Notes that the arm stood still and continues at ``t`` [s]."""
        for sensor in self.sensors:
            sensor.stood(t + BESIDE * self.follower.robot.t_ipo)

    def away(self, q_d: Array) -> Array | None:
        """Change of the joint angles ``(n,)`` [rad] while the arm brakes, so that it has no contact at rest.

        Starts from the measured place where the arm has not followed its commands; None where no change is needed.
        ``q_d``: where it comes to rest ``(m, n)`` [rad].
        """
        ways = [sensor.away(q_d) for sensor in self.sensors]
        self._lets_go = self._lets_go or any(way is not None for way in ways)
        ways += [] if self.arm is None else [self.arm.guard.back_to_arm(q_d[0])]
        away = [way for way in ways if way is not None]
        return sum(away[1:], start=away[0]) if away else None

    def speed(self, t: float) -> float:
        """Path speed at ``t`` [m/s], from which the arm is braked."""
        speed = self.follower.speed_at(t)
        return speed if self._torque is None else max(speed, PRESSING)

    def done(self, t: float) -> bool:
        """Whether the cycle that began at ``t`` [s] was the last one."""
        return (self.follower if self._baseline is None else self._baseline).done(t)


class Ahead:
    """Computes a cycle ahead, after the command of the cycle before, so that the answer is not delayed.

    After each command, the sensors are fused for which there is no time before an answer, see ``Sensor.at_once``. If
    there is no time for any, the coming cycle is planned there as well. In the shortest cycles only one thing is done
    per cycle: a sensor is fused, the most urgent first, or its health is checked. The same applies where answers are
    late; then only the most urgent sensor is fused. A measurement takes effect one cycle later for it, which does not
    matter to a map over places ([L] 4.3).

    Args:
        task: the task whose sensor data are fused and whose path is planned.
        arm: the connected arm.

    Attributes:
        at_once: sensors that are fused between packet and answer.
        plans: whether each cycle is planned in the one before.
        pieces: whether one thing is done at a time behind a command.
    """

    def __init__(self, task: Task, arm: LiveArm) -> None:
        T = arm.t_ipo
        self._task, self._arm, self._T = task, arm, T
        self.at_once = [sensor for sensor in task.sensors if sensor.at_once <= T]
        self._later = [sensor for sensor in task.sensors if sensor.at_once > T]
        self.plans = not self.at_once
        self.pieces = self.plans and any(sensor.in_one > T for sensor in task.sensors)
        self._prepared: tuple[int, Array] | None = None
        self._failed: IdealRobotError | None = None

    def begin(self) -> None:
        """Plans the first cycle, as a whole new plan takes longer than an answer may."""
        self._prepared = 0, self._task.follower.horizon(0.0)

    def taken(self, t: float) -> Array | None:
        """The horizon ``(n_d, n)`` [rad] that was prepared for ``t`` [s]; None where there is none.

        Of several lost cycles that are caught up at once, only the first has one. Raises an error that occurred
        meanwhile.
        """
        if self._failed is not None:
            raise self._failed
        (number, q_d), self._prepared = self._prepared or (-1, None), None
        return q_d if number == round(t / self._T) else None

    @property
    def idle(self) -> bool:
        """Whether nothing is computed ahead, as the path does not advance by one cycle in each."""
        return self._arm.paced

    def work(self) -> None:
        """Does the computation after a command; an error is raised in the next cycle."""
        if self.idle:
            self._prepared = None
            return
        try:
            if self.plans:
                self.prepare(self._arm.t + self._T)
            else:
                for sensor in self._task.sensors:
                    sensor.look()
                for sensor in self._later if not self._arm.behind else ():
                    sensor.fuse(self._arm.t)
        except IdealRobotError as error:
            self._failed = error

    def prepare(self, t: float) -> None:
        """Fuses the data that have arrived, and plans the cycle that begins at ``t`` [s]."""
        busy = self._done(t) == Work.FUSED and (self.pieces or self._arm.behind)
        self._prepared = round(t / self._T), self._task.follower.horizon(t, anew=not busy)

    def _done(self, t: float) -> Work:
        """Does the most urgent thing that is to be done before ``t`` [s], or all of it where there is time."""
        done = Work.NOTHING
        for number, sensor in enumerate(self._task.sensors):
            if number and (self._arm.behind or any(one.owes for one in self._task.sensors[:number])):
                break
            if (done := max(done, sensor.fuse(t))) and self.pieces:
                return done
        if not self._arm.behind:
            for sensor in self._task.sensors:
                sensor.look()
        return done
