"""A real arm behind KUKA RSI, as one more implementation of ``RobotInterface``.

The controller is the clock: it sends ``<Rob>`` every interpolation cycle and expects ``<Sen>`` with the same IPOC
before the next. ``cycle`` answers the last packet with the command and waits for the next one.
"""

from __future__ import annotations

import time
from types import TracebackType

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.execution.interface import RobotState
from ideal_robot.robots.limits import checked_command
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi.axes import Axes
from ideal_robot.rsi.link import PacketLink, passed
from ideal_robot.rsi.message import DECIMALS, RobMessage, format_sen
from ideal_robot.rsi.rsi_error import RsiError

_TRIALS = 3
"""Cycles within which the expected cycle time has to show."""


class RsiRobot:
    """A ``RobotInterface`` to an arm whose controller speaks RSI; listens as soon as it is made.

    Absolute corrections are the whole difference from where the arm was commanded when RSI began; relative ones are
    what is added in this cycle. What is sent is rounded, and the rest of the rounding is made good in the next cycle.

    Args:
        robot: number of joints, limits, cycle time, drive gains and ``[rsi]`` axes.
        host: address of ours to listen on.
        port: UDP port; 0 for any free one, see ``address``.
        relative: whether the controller takes the corrections as relative.
        timeout: silence of the controller after which the link counts as broken [s].
        max_lost: cycles in a row of which the packet may be lost; not counted until the first two in a row have come.

    Raises:
        InputError: an address that cannot be listened on, an arm with sliding joints.

    Attributes:
        t_ipo: interpolation cycle [s].
        counts: what happened on the link.
        commanded: joint angles the controller was commanded last ``(n,)`` [rad].
        answer_times: from reading each packet to its answer [s].
    """

    def __init__(self, robot: Robot, *, host: str = "127.0.0.1", port: int = 49152, relative: bool = False,
                 timeout: float = 1.0, max_lost: int = 3) -> None:
        self.robot, self.t_ipo, self.axes = robot, robot.t_ipo, Axes.of(robot)
        self.relative, self.timeout, self.max_lost = relative, timeout, max_lost
        self._link = PacketLink(host, port, robot.n)
        self.counts = self._link.counts
        self.commanded = np.full(robot.n, np.nan)
        self.answer_times: list[float] = []
        self._step = round(1e3 * robot.t_ipo)
        self._first: RobMessage | None = None
        self._elapsed = 0
        self._answer: bytes | None = None

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens: host and port."""
        return self._link.address

    def connect(self, patience: float = 60.0) -> RobotState:
        """Waits for the controller's first packet; who sends it is the controller from then on.

        Returns the state at rest, ``t = 0``. ``commanded`` is then where the controller holds the arm.

        Raises:
            RsiError: no packet within ``patience`` [s].
        """
        # Packets may have queued up since the port was opened.
        first = self._link.newest(self._link.next(time.perf_counter() + patience, patience))
        self._first = self._last = first
        self._late, self._in_step = first.late, False
        held = first.actual if first.setpoint is None else first.setpoint
        self._begin = held.copy()
        self._sent = self._correction = np.zeros(self.robot.n)
        self.commanded = self.axes.joints(held)
        return self._state(first)

    def cycle(self, q_c: Array) -> RobotState:
        """Answers the last packet with the command ``q_c (n,)`` [rad] and waits for the next one.

        Raises:
            InputError: wrong size or not finite.
            LimitError: outside the joint limits, or more than twice the velocity limit away from the last command.
            RsiError: see ``receive``.
        """
        self.send(q_c)
        return self.receive()

    def send(self, q_c: Array) -> None:
        """The first half of ``cycle``: answers and returns, which leaves the cycle's time for computing.

        Raises:
            RsiError: before ``connect``.
        """
        if self._first is None:
            raise RsiError("connect to the controller before a command is handed over")
        q_c = checked_command(self.robot, q_c, self.commanded, self.t_ipo)
        wanted = self.axes.angles(q_c) - self._begin
        correction = np.round(wanted - self._sent if self.relative else wanted, DECIMALS)
        self._sent, self._correction = self._sent + correction if self.relative else correction, correction
        self.commanded = q_c
        self._answer = format_sen(correction, self._last.ipoc)
        self._link.send(self._answer)
        self.answer_times.append(time.perf_counter() - self._link.arrived)

    def receive(self) -> RobotState:
        """The second half of ``cycle``: waits for the next packet.

        Raises:
            RsiError: silence, too many packets lost in a row, another cycle time than the robot's, or with relative
                corrections an answer that came late (where the arm is commanded is then not known any more).
        """
        if self._first is None:
            raise RsiError("connect to the controller first")
        end = time.perf_counter() + self.timeout
        while True:
            message = self._link.next(end, self.timeout)
            since = passed(self._last, message)
            if since == 0:
                self.counts.repeated += 1
                if self._answer is not None:
                    self._link.send(self._answer)
            elif since < 0:
                self.counts.outdated += 1
            else:
                return self._advance(self._link.newest(message))

    def close(self) -> None:
        """Stops listening; the controller holds the arm and reports that its sensor is gone."""
        self._link.close()

    def __enter__(self) -> RsiRobot:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def _advance(self, message: RobMessage) -> RobotState:
        since = passed(self._last, message)
        lost = since // self._step - 1
        self._in_step = self._in_step or lost == 0
        # One large step is a loss, three from the start are another cycle time.
        if since % self._step or not (self._in_step or self.counts.cycles < _TRIALS):
            raise RsiError(f"the controller's time stamp rose by {since} ms in a cycle; {self._step} ms are expected "
                           f"for {self.robot.name} (t_ipo in the robot's data, or --cycle)")
        if self._in_step and lost > self.max_lost:
            raise RsiError(f"{lost} packets in a row were lost, more than {self.max_lost}; check network and load")
        self.counts.lost += lost
        self._elapsed += since
        late, self._late = message.late - self._late, message.late
        self.counts.late += max(late, 0)
        if self.relative and late > lost and self._correction.any():
            raise RsiError("an answer came late: with relative corrections it is not known whether it still counted; "
                           "use absolute ones, or a faster or less loaded computer")
        self._last, self._answer = message, None
        return self._state(message)

    def _state(self, message: RobMessage) -> RobotState:
        """Torque is the current in ampere times the drive gain, NaN where the controller sends no current."""
        self.counts.cycles += 1
        tau = np.full(self.robot.n, np.nan)
        if message.current is not None:
            tau = self.axes.sign * message.current * self.robot.drive_gain
        return RobotState(1e-3 * self._elapsed, self.axes.joints(message.actual), tau)
