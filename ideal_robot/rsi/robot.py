"""A real arm behind KUKA RSI, as one more implementation of ``RobotInterface``.

The controller is the clock: it sends ``<Rob>`` every interpolation cycle and expects ``<Sen>`` with the same IPOC
before the next. ``cycle`` answers the last packet with the command and waits for the next one.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.interfaces import LinkSettings
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi.corrections import Corrections, corrections_of
from ideal_robot.rsi.link import PacketLink, Stamps
from ideal_robot.rsi.message import Axes, RobMessage, RsiError, RsiFormat, format_sen

# The correction that the controller uses, from sent answers and late ones.

class InForce:
    """The correction that the controller uses: ``position`` as a whole, and ``step``, its last change, ``(m,)``.

    In a cycle without an answer the controller repeats the last increment if it ``repeats``, or stays at its setpoint.

    Args:
        corrections: the rule by which increments follow each other.
        repeats: see above.
    """

    def __init__(self, corrections: Corrections, repeats: bool) -> None:
        self.position = self.step = self._nothing = np.zeros(len(corrections.names))
        self.repeats, self._corrections = repeats, corrections
        self._sent: Array | None = None

    def send(self, position: Array) -> None:
        """Stores that the answer to this cycle commands ``position (m,)``."""
        self._sent = position

    def advance(self, used: bool, missed: int) -> bool:
        """Advances the position in force to the next packet; returns whether it differs from the commanded one.

        Args:
            used: whether the controller used the last answer.
            missed: number of cycles after that one whose packets never came.
        """
        if used and self._sent is not None:
            self.position, self.step = self._sent, self._corrections.between(self.position, self._sent)
        else:
            missed += 1
        self._sent = None
        if missed and self.repeats:
            for _ in range(missed):
                self.position = self._corrections.behind(self.position, self.step)
        elif missed:
            self.step = self._nothing
        return missed > 0

    @property
    def asks(self) -> bool:
        """Whether the answer to this cycle changes the position in use."""
        return self._sent is not None and not np.array_equal(self._sent, self.position)

    def is_at(self, position: Array) -> None:
        """Sets the position to ``position (m,)``, at which the controller was measured at rest."""
        self.position, self.step, self._sent = position, self._nothing, None


_APART = 1.0
"""How far measured and commanded axes may be apart before anything moves [deg]."""
_QUEUED = 100_000
"""Packets that may have queued up before the first answer."""
_AHEAD = 3
"""Packets in a row whose time stamp lies too far ahead, after which it is believed."""
_GRACE = 2
"""Cycles in which a second controller would show before the first answer."""
_PACE = 25
"""Packets whose arrival tells the cycle where time stamps do not."""
_TOO_FAST = 2.5
"""Times the expected pace at which the controller's cycle counts as another one."""
_RESTED = 1e-6
"""Change of the command in a cycle below which the arm counts as commanded to rest [rad]."""
_REST_TIME = 0.3
"""Rest after which the measured position tells where relative corrections have led [s]."""
_UNTOLD = 3.0
"""Times the usual tolerance of following where the controller does not tell which increments came too late."""
_RESYNC = 1e-3
"""Difference of measured and commanded position at rest that is made good [rad]; less is the controller's own."""
_EXTERNAL_MOVES = 0.05
"""Change of an external axis' position beyond which it moves [deg or mm]."""


class RsiRobot(LinkedRobot):
    """A ``RobotInterface`` to an arm whose controller speaks RSI; listens from its creation on.

    Absolute corrections are the whole difference from where the arm was commanded when RSI began; relative ones are
    what is added in this cycle, of the axes or of the tool's pose, as ``form`` has it. Sent values are rounded; the
    rounding error is added in the next cycle.

    Args:
        robot: number of joints, limits, cycle time, drive gains and ``[rsi]`` axes.
        host: address of ours to listen on.
        port: UDP port; 0 for any free one, see ``address``.
        relative: whether the controller takes the corrections as relative.
        form: tags, sender type, decimals and what the controller does without an answer.
        controller: address of the controller; None for whoever sends the first sound packet.
        timeout: silence of the controller after which the link is taken as broken [s].
        bridge: longest loss of packets in a row [s]; it applies once two in a row have come.
        answers_within: time in which the arm's loop answers a command, for the watch over following [s].

    Raises:
        InputError: an address that cannot be listened on, an arm with sliding joints, absolute corrections of which
            the controller says that it gives them up without an answer, corrections of the pose of an arm that has not
            six joints.

    Attributes:
        counts: statistics of the link.
        corrections: conversion of joint angles to corrections.
        stamps: how the controller's time stamps rise.
        too_fast: multiple of the expected packet rate that indicates another cycle time, where stamps do not show it.
    """

    def __init__(self, robot: Robot, *, host: str = "127.0.0.1", port: int = 49152, relative: bool = False,
                 form: RsiFormat | None = None, controller: str | None = None, timeout: float = 1.0,
                 bridge: float = 0.1, answers_within: float = 0.3) -> None:
        self.form = form or RsiFormat()
        if not relative and self.form.hold_on is False:
            raise InputError("without an answer the controller would return to the start; set HOLDON to 1 for absolute "
                             "corrections, or use --relative", field="HOLDON", value=0)
        super().__init__(robot, bridge, answers_within, relative)
        self.axes, self.relative, self.timeout = Axes.of(robot), relative, timeout
        self.too_fast = _TOO_FAST
        self.stamps = Stamps(round(1e3 * robot.t_ipo))
        self.corrections = corrections_of(robot, self.axes, self.form.pose)
        self._link = PacketLink(host, port, robot.n, controller, self.form)
        self.counts = self._link.counts
        self._brake = 1.8 * self._room * robot.t_ipo**2
        self._in_force = InForce(self.corrections, relative and self.form.hold_on is True)
        self._shrinks: tuple[Array, int] | None = None
        self._first: RobMessage | None = None
        self._elapsed = self._ahead = self._still = self._late = self._back = self._older = 0
        self._in_doubt = False
        self._answer: bytes | None = None

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which it listens."""
        return self._link.address

    @property
    def arrived(self) -> float:  # type: ignore[override]
        """When the last packet came, by ``time.perf_counter`` [s]."""
        return self._link.arrived

    @property
    def settled(self) -> bool:
        """Whether the controller's setpoint is the desired one, without an offset from missed cycles."""
        return super().settled and not self._in_doubt

    @property
    def meta(self) -> dict[str, Any]:
        """Kind of corrections, for the recording's metadata."""
        return {"corrections": ("relative" if self.relative else "absolute")
                               + (" of the pose" if self.form.pose else "")}

    def connect(self, patience: float = 60.0) -> RobotState:
        """Waits for the controller's first packet; its sender is the controller from then on.

        Returns the state at rest, ``t = 0``. ``commanded`` is then the controller's setpoint.

        Raises:
            RsiError: no packet within ``patience`` [s]; a second controller sends, too; the measured arm is elsewhere
                than its controller says.
        """
        # Packets may have queued up since the port was opened.
        oldest = self._link.next(Deadline.within(patience))
        time.sleep(_GRACE * self.t_ipo)
        first, _ = self._link.newest(oldest, self.stamps, _QUEUED)
        if self.counts.second:
            raise RsiError(f"two controllers send, {self._link.controller} and {self.counts.last_foreign}; name yours "
                           "with --controller, or end the other")
        held = first.actual if first.setpoint is None else first.setpoint
        apart = np.abs(held - first.actual)
        if (apart > _APART).any():
            axis = int(np.argmax(apart))
            raise RsiError(f"axis {axis + 1} is measured at {first.actual[axis]:.2f}° and commanded to "
                           f"{held[axis]:.2f}° (AIPos, ASPos) before anything was sent; start RSI anew, from rest")
        self._first = self._last = first
        self._late = first.late or 0
        self.corrections.begin(held, first)
        self._step, self._lost = np.zeros(self.robot.n), None
        self.commanded = self._wanted = self.axes.joints(held)
        if self.relative and first.late is None:
            # Lost increments may go unnoticed and add up until the next rest.
            self._watch.tolerance *= _UNTOLD
        self._watch.begin(self.commanded, self.axes.joints(first.actual))
        return self._state(first)

    def send(self, q_c: Array) -> None:
        """First half of ``cycle``: sends the answer and leaves time for computing; RsiError before ``connect``."""
        if self._first is None:
            raise RsiError("connect to the controller before sending a command")
        q_c = self._want(q_c)
        if self._watch.adds_up:
            self._answer_with(self._slowed())
            return
        self._resynchronise(self._step)
        q_c = self._led_back(q_c, self._speed() if self.missed else self._step)
        self.fault = self.fault or self.corrections.unusable(q_c, self.relative)
        self.commanded = q_c
        self._handed_over(q_c)

    def _handed_over(self, q_c: Array) -> None:
        position, correction = self._in_force.position, self.corrections.of(q_c)
        if self.relative:
            correction = np.round(self.corrections.between(position, correction), self.form.decimals)
            self._in_force.send(self.corrections.behind(position, correction))
        else:
            correction = np.round(correction, self.form.decimals)
            self._in_force.send(correction)
        self._answer_with(correction)

    def _received(self) -> RobotState:
        """See ``LinkedRobot.receive``: waits for the next packet.

        Raises RsiError for silence, packets lost for longer than can be bridged, another cycle time than the robot's.
        """
        if self._first is None:
            raise RsiError("connect to the controller first")
        deadline = Deadline.within(self.timeout)
        while True:
            message = self._link.next(deadline)
            since = self.stamps.cycles(self._last.ipoc, message.ipoc)
            if since == 0:
                self.counts.repeated += 1
                if self._answer is not None:
                    self._link.send(self._answer)
            elif since < 0:
                self.counts.outdated += 1
                self._went_back(message.ipoc)
            elif self.stamps.in_step and since - 1 > self.max_lost:
                self._too_far(since)
            else:
                return self._advance(message, since)

    def close(self) -> None:
        """Stops listening; the controller keeps the arm in place and reports a lost sensor."""
        self._link.close()

    def _answer_with(self, correction: Array) -> None:
        self._answer = format_sen(correction, self._last.ipoc, self.form)
        self._link.send(self._answer)
        self.answer_times.append(time.perf_counter() - self._link.arrived)

    def _speed(self) -> Array:
        """What the joints move in a cycle by the corrections in force ``(n,)`` [rad]."""
        position = self._in_force.position
        return np.asarray(self.corrections.joints(self.corrections.behind(position, self._in_force.step))
                          - self.corrections.joints(position))

    def _slowed(self) -> Array:
        """Corrections that shrink to nothing within the acceleration limit: the controller adds them up."""
        if self._shrinks is None:
            # In joint angles, as the controller turns the joints by the whole correction in one cycle.
            moves = np.abs(self.commanded - self.corrections.joints(np.zeros(len(self.corrections.names))))
            self._shrinks = self._in_force.position, max(int(np.ceil(np.max(moves / self._brake))), 1)
            self._slower = 0
        correction, cycles = self._shrinks
        self._slower = min(self._slower + 1, cycles)
        shrunk = np.round(correction * (1.0 - self._slower / cycles), self.form.decimals)
        self._in_force.send(shrunk)
        return shrunk

    def _resynchronise(self, step: Array) -> None:
        """Takes the measured position for the commanded one, once the arm rests after increments that may be lost."""
        moving = np.max(np.abs(step)) > _RESTED or self.missed or self._catch_up.active
        self._still = 0 if moving or not self._in_doubt else self._still + 1
        if self._still * self.t_ipo >= _REST_TIME:
            self._still, self._in_doubt = 0, False
            beside = self._measured - self._watch.rest - self.commanded
            if np.max(np.abs(beside)) > _RESYNC:
                self.commanded = self.commanded + beside
                self._in_force.is_at(self.corrections.of(self.commanded))
                self.missed = True
                self.counts.resynchronised += 1

    def _too_far(self, since: int) -> None:
        """Refuses a packet whose time stamp is too far ahead; raises RsiError where several in a row are."""
        self._ahead += 1
        self.counts.refuse(f"its time stamp lies {since} cycles ahead")
        if self._ahead >= _AHEAD:
            raise RsiError(f"{since - 1} packets in a row were lost, more than {self.max_lost}; check network and load")

    def _went_back(self, stamp: int) -> None:
        """Counts earlier time stamps that rise; raises RsiError for many in a row: the controller has begun anew."""
        self._back = self._back + 1 if self._back and self.stamps.newer(self._older, stamp) else 1
        self._older = stamp
        if self._back > self.max_lost:
            raise RsiError(f"the controller's time stamps begin anew (IPOC {stamp} after {self._last.ipoc}): RSI was "
                           "started again; start the run again")

    def _advance(self, message: RobMessage, since: int) -> RobotState:
        newest, waited = self._link.newest(message, self.stamps)
        further = self.stamps.cycles(message.ipoc, newest.ipoc) if newest is not message else 0
        if since + further - 1 > self.max_lost and self.stamps.in_step:
            # A packet far ahead in the queue is ignored until more of the kind have come.
            newest, further = message, 0
        since += further
        # Stamps that never rise do not show losses, so packets that waited in the queue are taken as lost.
        lost = max(since - 1, waited if self.stamps.rise == 0 else 0)
        self.counts.lost += lost
        self._elapsed += 1 + lost
        self._ahead = self._back = 0
        self.gone_on = lost if self._in_force.repeats else 0
        late = 0 if newest.late is None else max(newest.late - self._late, 0)
        self._late = self._late if newest.late is None else newest.late
        self.counts.late += late
        # A zero increment may be lost without harm.
        untold = newest.late is None and self._in_force.asks
        self._in_doubt = self._in_doubt or (self.relative and (late + lost > 0 or untold))
        if self._in_force.advance(used=late <= lost, missed=lost):
            self.missed = True
            self.commanded = self.corrections.joints(self._in_force.position)
        self._last, self._answer = newest, None
        self._check_pace()
        return self._state(newest)

    def _check_pace(self) -> None:
        """Checks by the clock that the cycle is not much shorter, where time stamps do not show it."""
        if self.counts.cycles == 1:
            # Counted from the first packet after an answer, as the one before may have waited for the program to be
            # ready.
            self._began = self._link.arrived
        if self.stamps.rise in (None, self.stamps.step) or self.counts.cycles != _PACE:
            return
        pace = (self._link.arrived - self._began) / (self.counts.cycles - 1)
        if pace * self.too_fast < self.t_ipo:
            raise RsiError(f"packets come every {1e3 * pace:.1f} ms, {1e3 * self.t_ipo:.0f} ms are expected; tell the "
                           "controller's cycle with --cycle")

    def _state(self, message: RobMessage) -> RobotState:
        """Torque is the current in ampere times the drive gain, NaN where the controller sends no current."""
        self.counts.cycles += 1
        self._measured = self.axes.joints(message.actual)
        if self.fault is None:
            self.fault = self._watch.check(self.commanded, self._measured)
            self.counts.implausible = self._watch.missing
        else:
            self.fault = self._watch.stopping(self.commanded, self._measured) or self.fault
        self.fault = self.fault or self.corrections.contradiction(message) or self._external(message)
        current = np.full(self.robot.n, np.nan)
        if message.current is not None:
            current = self.axes.sign * message.current
        return RobotState(self.t_ipo * self._elapsed, self._measured, current * self.robot.drive_gain,
                          {"current": current})

    def _external(self, message: RobMessage) -> str | None:
        """Message about an external axis that has moved since RSI began; None where none has."""
        begun = None if self._first is None else self._first.external
        if begun is None or message.external is None or len(begun) != len(message.external):
            return None
        moved = np.abs(message.external - begun)
        axis = int(np.argmax(moved))
        return None if moved[axis] <= _EXTERNAL_MOVES else (
            f"external axis E{axis + 1} moves (by {moved[axis]:.3g}); it has to stand still while the arm is led")


PORT = 49152
"""Of KUKA's example of RSI."""


def opened(address: Address, robot: Robot, settings: LinkSettings) -> RsiRobot:
    """Listens on ``rsi://host:port`` of this computer for a controller; raises InputError where it cannot.

    Args:
        address, robot, settings: see ``ideal_robot.interfaces``.
    """
    address.knows()
    host, port = address.at(PORT)
    form = RsiFormat(hold_on=True if settings.relative else None)
    if settings.rsi_config is not None:
        form = RsiFormat.read(settings.rsi_config, robot.n)
    return RsiRobot(robot, host=host, port=port, relative=settings.relative, form=form, controller=settings.controller,
                    **settings.given())
