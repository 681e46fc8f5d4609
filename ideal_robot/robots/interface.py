"""The manufacturer's positional interface, the only access to the controller."""

from __future__ import annotations

import math
import socket
import time
from abc import ABC, abstractmethod
from array import array
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, ClassVar, Protocol, Self, TypeVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import IdealRobotError, InputError, LimitError
from ideal_robot.jit import jit
from ideal_robot.robots.robot import Robot


@dataclass(frozen=True, slots=True)
class RobotState:
    """The state that the controller reports in one interpolation cycle.

    Attributes:
        t: controller time at which ``q`` and ``tau`` were valid [s].
        q: motor angles on the joint side, shape ``(n,)`` [rad]. Not the arm angles: gears are elastic ([L] 2.1).
        tau: motor torque on the joint side, measured current times drive gain, shape ``(n,)`` [N m].
        columns: further reported quantities, by the recording's column names: a number, or one per joint ``(n,)``. The
            same names in every state of an arm.
    """

    t: float
    q: Array
    tau: Array
    columns: Mapping[str, float | Array] = field(default_factory=dict)


class RobotInterface(Protocol):
    """A position-controlled arm: one command in, one state out, per interpolation cycle.

    A simulated arm is one implementation, a real arm behind KUKA RSI another.
    """

    t_ipo: float
    """Interpolation cycle [s]: 12 ms for a KRC1 ([G] 5.2.1), 4 ms on newer controllers."""

    def cycle(self, q_c: Array) -> RobotState:
        """Sends the commanded joint angles ``q_c (n,)`` [rad] and waits one interpolation cycle.

        Returns the state at the end of the cycle.
        """
        ...


# Checks of every command to an arm behind the positional interface.

def checked_command(robot: Robot, q_c: Array, before: Array, t_ipo: float) -> Array:
    """A command that the controller accepts, as a new array ``(n,)``.

    Args:
        robot, t_ipo: the arm with its limits, and the interpolation cycle [s].
        q_c, before: command, and that of the cycle before ``(n,)`` [rad].

    Raises:
        InputError: wrong size or not finite.
        LimitError: outside the joint limits, or more than twice the velocity limit away from the command before.
    """
    q = np.array(q_c, dtype=float)
    if q.shape != (robot.n,) or not np.isfinite(q).all():
        raise InputError(f"a command must be {robot.n} finite joint angles", field="q_c", value=q.tolist())
    outside = (q < robot.q_min) | (q > robot.q_max)
    if outside.any():
        j = int(np.argmax(outside))
        limit = robot.q_min[j] if q[j] < robot.q_min[j] else robot.q_max[j]
        raise LimitError(j + 1, f"commanded position [{robot.units('rad')[j]}]", q[j], limit,
                         "command positions within the joint limits")
    speed = np.abs(q - before) / t_ipo
    fast = speed > 2.0 * robot.v_max
    if fast.any():
        j = int(np.argmax(fast))
        raise LimitError(j + 1, f"commanded velocity [{robot.units('rad/s')[j]}]", speed[j], 2.0 * robot.v_max[j],
                         "give a path that starts where the arm is and keeps the velocity limits")
    return q


# Whether the measured arm does what was commanded, from the first packet on, and if not what the cause looks like.
#
# An arm under a position controller is, but for a tolerance, between the smallest and the largest of the commands of
# the last while, which is as long as its loop needs to answer. If it is not, the motion of the last cycles is compared
# with the prediction of each cause for the same commands.

TOLERANCE = np.radians(0.3)
"""How far an arm may be outside its commands [rad] …"""
_SHARE = 0.1
"""… and in addition by this share of what they changed by."""
_PATIENCE = 2
"""Cycles in a row after which a deviation counts."""
_LAGS, _DEAD = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0), 4
"""Time constants and longest dead time that are tried [cycles]."""
_EXPLAINS, _SURE = 0.35, 0.12
"""Share of the motion a cause may leave unexplained; less where the arm is then stopped in another way."""
_ADDS_UP = "the controller adds up absolute corrections (--relative, or make its corrections absolute)"


class FollowingWatch:
    """Compares measured with commanded joint angles in every cycle, to find an arm that does not follow.

    Args:
        n: number of joints.
        window: cycles within which the loop answers a command.
        jump: largest believable change in one cycle ``(n,)`` [rad].
        relative: whether we take the corrections as relative.

    Attributes:
        adds_up: whether the controller turned out to add up absolute corrections.
        missing: readings that could not be and were not used.
        tolerance: largest distance of the arm from the range of its commands [rad].
        rest: measured minus commanded at rest, before the first motion ``(n,)`` [rad].
    """

    def __init__(self, n: int, window: int, jump: Array, relative: bool) -> None:
        rows = max(2 * window, 8)
        self.adds_up, self.missing, self.rest = False, 0, np.zeros(n)
        self.tolerance = TOLERANCE
        self._window, self._jump, self._relative = window, jump, relative
        self._commanded, self._measured, self._sum = np.zeros((rows, n)), np.zeros((rows, n)), np.zeros((rows, n))
        self._count = self._outside = self._jumped = 0
        # A first call loads compiled code before an arm waits for it.
        _extremes(self._commanded, 0, 1)

    def begin(self, commanded: Array, measured: Array) -> None:
        """Starts with the first packet's commanded and measured joint angles ``(n,)`` [rad], at rest."""
        self._commanded[:], self._measured[:], self._sum[:] = commanded, measured, 0.0
        self._start, self._last = commanded.copy(), measured.copy()
        # At rest a controller keeps the arm a little beside its command, which is not a following error.
        self.rest = measured - commanded

    def check(self, commanded: Array, measured: Array) -> str | None:
        """Checks one cycle's commanded and measured angles ``(n,)`` [rad]; returns the fault in words, if any."""
        leap = np.abs(measured - self._last)
        if (leap > self._jump * (1 + self._jumped)).any():
            # One such reading is treated as missing; a second means that the arm, or its encoder, is elsewhere.
            self.missing, self._jumped = self.missing + 1, self._jumped + 1
            joint = int(np.argmax(leap / self._jump))
            return None if self._jumped < _PATIENCE else (
                f"the measured position of joint {joint + 1} jumped by {np.degrees(leap[joint]):.0f}°")
        self._last, self._jumped = measured.copy(), 0
        row = self._count % len(self._commanded)
        self._sum[row] = self._sum[row - 1] + commanded - self._start
        self._commanded[row], self._measured[row] = commanded, measured
        self._count += 1
        low, high = _extremes(self._commanded, row, self._window)
        offset = measured - self.rest
        beyond = np.maximum(low - offset, offset - high) - self.tolerance - _SHARE * (high - low)
        self._outside = self._outside + 1 if (beyond > 0).any() else 0
        return self.cause(int(np.argmax(beyond))) if self._outside >= _PATIENCE else None

    def stopping(self, commanded: Array, measured: Array) -> str | None:
        """Checks one cycle of braking; reports an arm that goes on moving, as if it summed constant commands up."""
        still = np.array_equal(commanded, self._commanded[0])
        self._commanded[0], step, self._last = commanded, measured - self._last, measured.copy()
        joint = int(np.argmax(np.abs(step)))
        expected = commanded[joint] - self._start[joint]
        goes_on = still and not self._relative and abs(step[joint] - expected) < 0.5 * abs(expected)
        self._outside = self._outside + 1 if goes_on else 0
        if self._outside < 2 * _PATIENCE or self.adds_up:
            return None
        self.adds_up = True
        return f"joint {joint + 1} goes on while its command stands still: {_ADDS_UP}"

    def cause(self, joint: int) -> str:
        """Likely cause, in words, of a joint's deviation from its commands in the last cycles."""
        order = (self._count + np.arange(len(self._commanded))) % len(self._commanded)
        commanded, measured = self._commanded[order], self._measured[order]
        total = self._sum[order, joint]
        command, moved = commanded[:, joint] - commanded[0, joint], measured[:, joint] - measured[0, joint]
        beside = np.degrees(moved[-1] - command[-1] + measured[0, joint] - self.rest[joint] - commanded[0, joint])
        says = f"joint {joint + 1} is {abs(beside):.2f}° off its command"
        if np.ptp(moved) < 0.1 * np.ptp(command):
            still = np.ptp(measured, axis=0) < 0.1 * np.ptp(commanded, axis=0)
            if self._relative and _left(moved, np.gradient(command)) < _EXPLAINS:
                return f"{says}: the controller takes increments as absolute corrections (--absolute)"
            if still[np.ptp(commanded, axis=0) > TOLERANCE].all():
                return (f"{says}: the arm does not move; check the tag of the corrections (--tag, --rsi-config), the "
                        "sender type, that they are wired to AXISCORR, and its limits")
            return f"{says}: joint {joint + 1} does not move"
        if not self._relative and _left(moved, total - total[0]) <= _SURE:
            self.adds_up = True
            return f"{says}: {_ADDS_UP}"
        if _left(moved, -command) <= _EXPLAINS:
            return f"{says}: it turns against it; check axis_sign in the robot's data"
        return f"{says} and does not follow it; check model, cycle, load and what stands in the way"


@jit()
def _extremes(rows: Array, row: int, count: int) -> tuple[Array, Array]:
    """Least and largest of the last ``count`` rows ``(n,)`` each, of which the last is ``row`` of a ring ``(m, n)``."""
    low, high = rows[row].copy(), rows[row].copy()
    for i in range(1, count):
        for j in range(rows.shape[1]):
            value = rows[(row - i) % len(rows), j]
            low[j], high[j] = min(low[j], value), max(high[j], value)
    return low, high


def _left(moved: Array, expected: Array) -> float:
    """Share of a motion ``(N,)`` that ``expected (N,)`` leaves, at the dead time and lag that fit best."""
    size, N = float(np.linalg.norm(moved)), len(moved)
    shares = [np.inf]
    for lag in _LAGS:
        kernel = np.exp(-np.arange(N) / lag) if lag else np.eye(1, N)[0]
        slow = np.convolve(expected, kernel / kernel.sum())[:N]
        for dead in range(_DEAD + 1):
            late = np.concatenate([np.zeros(dead), slow[: N - dead]])
            shares.append(float(np.linalg.norm(moved - late)) / max(size, 1e-12))
    return min(shares)


# Returns from the controller's actual setpoint to the desired commands after a missed answer.
#
# The sent command is the desired one plus an offset. After a missed answer the offset starts with the difference in
# position ``o``, speed ``d`` and acceleration ``b`` between the controller's setpoint and the desired command, so that
# the controller sees neither a jump nor a kink. Changes of acceleration ``u`` bring it to zero in the fewest cycles N
# in which speed, acceleration and its change keep their limits:
#
# .. math:: \sum_{k=1}^{N} u_k^2 \to \min, \qquad b_k = b_{k-1} + u_k, \quad d_k = d_{k-1} + b_k, \quad
#           o_k = o_{k-1} + d_k, \qquad o_N = d_N = b_N = 0
#
# All of it is linear in ``o, d, b`` and N is the same for all joints, so that they stay synchronous and the arm
# deviates from the path only in time. If the longest plan cannot return the whole offset, it returns the largest
# possible share.

_RISE = 0.03
"""Time in which the acceleration may rise to its limit [s]: some cycles of the slowest controllers."""
_LONGEST, _MOST = 0.4, 400
"""Longest plan [s]: in it an arm stops from full speed with a quarter of its acceleration. In cycles, that of a
controller of 1 ms."""
_FASTER = 0.3
"""Share by which the arm may be faster than wanted meanwhile: the faster it is, the more the next missed answer takes
away at once."""
_CREEP = 0.05
"""Share of the speed limit with which a joint may catch up at least."""
_LONGER = 1.2
"""Times by which the next plan that is looked at is longer."""


class CatchUp:
    """The offset of sent commands from desired ones after a missed answer, which returns smoothly to zero.

    Args:
        a_max: acceleration of the arm ``(n,)`` [rad/s²]; the offset uses at most half of it, less what the desired
            commands exceed.
        v_max: speed the arm may reach with it ``(n,)`` [rad/s].
        t_ipo: cycle [s].

    Attributes:
        active: whether there is an offset still.
    """

    def __init__(self, a_max: Array, v_max: Array, t_ipo: float) -> None:
        self._most, self._fastest, self._jerk = a_max * t_ipo**2, v_max * t_ipo, 0.5 * a_max / _RISE * t_ipo**3
        self._plans = _plans(min(max(round(_LONGEST / t_ipo), 6), _MOST))
        self._state, self._wanted = np.zeros((3, len(a_max))), np.zeros(len(a_max))
        self._left, self.active = 0, False

    def start(self, offset: Array, drift: Array, bend: Array, wanted: Array) -> None:
        """Starts the return from another position and speed.

        Args:
            offset, drift: actual minus desired position and speed of the last cycle ``(n,)`` [rad, rad a cycle].
            bend: actual minus desired acceleration of the coming cycle ``(n,)`` [rad a cycle²].
            wanted: desired speed of the last cycle ``(n,)`` [rad a cycle].
        """
        self._state, self._wanted = np.array([offset, drift, bend]), wanted
        self._left, self.active = 0, True

    def next(self, wanted: Array) -> Array:
        """What has to be added to the next desired position to make the next command ``(n,)`` [rad].

        It goes smoothly to zero within some cycles, and is zero from then on.

        Args:
            wanted: desired speed of that cycle ``(n,)`` [rad a cycle]; the offset uses what it leaves of the limits.
        """
        if self.active:
            speed, change = np.abs(wanted), np.abs(wanted - self._wanted)
            room = np.clip(self._most - change, 0.25 * self._most, 0.5 * self._most)
            faster = np.maximum(np.minimum(_FASTER * speed, self._fastest - speed), _CREEP * self._fastest)
            offset, drift, bend = self._state
            # A larger speed that the offset already has is permitted, too.
            bend = bend + self._change(np.array([[-self._jerk, -room, np.minimum(-faster, drift)],
                                                 [self._jerk, room, np.maximum(faster, drift)]]))
            drift = drift + bend
            self._state, self._wanted = np.array([offset + drift, drift, bend]), wanted
            self._left -= 1
            if not self._left:
                self._state, self.active = np.zeros_like(self._state), False
        return self._state[0]

    def _change(self, limits: Array) -> Array:
        """Change of the acceleration in the coming cycle ``(n,)`` [rad a cycle³].

        Limits are least and most change of the acceleration, acceleration, and speed ``(2, 3, n)``.
        """
        low, high = limits[:, :, None] * (1.0 + 1e-9)
        count = self._left or 3
        while count < len(self._plans):
            move = self._plans[count] @ self._state
            # With fewer than three cycles the plan only ends.
            if count < 3 or ((low <= move) & (move <= high)).all():
                self._left = count
                return np.asarray(move[0, 0])
            count = math.ceil(_LONGER * count)
        self._left, plan = len(self._plans) - 1, self._plans[-1]
        rest, move = plan[..., 1:] @ self._state[1:], plan[..., :1] * self._state[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(move > 0.0, (high - rest) / move, np.where(move < 0.0, (low - rest) / move, np.inf))
        change = rest[0, 0] + np.clip(np.min(shares), 0.0, 1.0) * move[0, 0]
        return np.asarray(change / max(float(np.max(np.abs(change) / self._jerk)), 1.0))


def _plans(longest: int) -> list[Array]:
    """For each number of cycles N how its way follows from ``o, d, b``: change, acceleration, speed ``(3, N, 3)``."""
    A, plans = np.triu(np.ones((3, 3))), [np.zeros((3, 0, 3))]
    power, reach = A, np.ones((3, 1))
    for _ in range(longest):
        change = -np.linalg.pinv(reach) @ power
        bend = np.eye(3)[2] + np.cumsum(change, axis=0)
        plans.append(np.array([change, bend, np.eye(3)[1] + np.cumsum(bend, axis=0)]))
        power, reach = A @ power, np.column_stack([A @ reach[:, 0], reach])
    return plans


# Common part of arms behind the links of controllers.

@dataclass
class LinkCounts:
    """Statistics of a link; counts that a controller's protocol cannot show are 0.

    Attributes:
        cycles: packets that were an interpolation cycle of their own.
        lost: cycles whose packet never came.
        late: cycles of the controller's own whose packet came, and to which no answer was made in time.
        repeated: packets of a cycle already answered.
        outdated: packets of a cycle before the last one.
        partial: messages without all of the arm's joints, as those of a gripper.
        refused: packets that are no message of a controller.
        foreign: packets of other senders.
        implausible: implausible measured positions, which are treated as missing.
    """

    cycles: int = 0
    lost: int = 0
    late: int = 0
    repeated: int = 0
    outdated: int = 0
    partial: int = 0
    refused: int = 0
    foreign: int = 0
    implausible: int = 0


def cycles_since(number: int, before: int) -> int:
    """Cycles between the numbers of two packets, with the overflow of 32-bit numbers.

    >>> cycles_since(2, 2**32 - 1), cycles_since(5, 7)
    (3, -2)
    """
    return (number - before + 2**31) % 2**32 - 2**31


def read_waiting(link: socket.socket, deadline: Deadline, taken: Callable[[bytes, Any], bool], size: int = 65536
                 ) -> bool:
    """Reads all packets waiting at a socket, so that no answer is left for later; false if the deadline passed.

    Args:
        link: of datagrams.
        deadline: end of the wait for an accepted packet.
        taken: called with each packet and its sender; whether it is one that was waited for.
        size: of the largest packet.

    Returns whether one was taken in time.

    Raises:
        OSError: the system does not let the socket be read any more.
    """
    found = False
    while True:
        try:
            link.settimeout(0.0 if found else max(deadline.left, 1e-3))
            packet, sender = link.recvfrom(size)
        except (BlockingIOError, TimeoutError):
            return found
        except ConnectionError:  # an earlier datagram had no receiver
            continue
        found = taken(packet, sender) or found


def _missed(lost: int, late: int) -> str:
    """What became of packets in a row, in words.

    >>> _missed(12, 0), _missed(0, 12), _missed(5, 7)
    ('were lost', 'were read too late', 'were lost (5) or read too late (7)')
    """
    if lost and late:
        return f"were lost ({lost}) or read too late ({late})"
    return "were read too late" if late else "were lost"


_ARRIVALS = 33
"""Packets by whose arrival it is known whether they come evenly …"""
_EVEN, _EVENLY = 0.25, 0.8
"""… which is within this share of the cycle, this share of them."""


_WAITED = 0.75
"""Share of a cycle for which a packet may be late before a command goes out in its place; the rest is for its way. A
controller whose own clock is late by more gets it too soon."""
Packet = TypeVar("Packet")


class LinkedRobot(ABC):
    """A ``RobotInterface`` to an arm behind a link on which cycles may be missed.

    After a missed one, the next commands move from the controller's actual setpoint back to the desired one. An
    interface defines its packets (``_handed_over``, ``_received``); the rest is common: ``_at_rest``, ``_bridged`` and
    ``_looked_at``.

    Args:
        robot: limits and cycle time.
        bridge: how long packets may be lost in a row [s].
        answers_within: time in which the arm's loop answers a command, for the watch over following [s].
        relative: whether the controller adds commands up.

    Attributes:
        t_ipo: interpolation cycle [s].
        commanded: joint angles in force at the controller ``(n,)`` [rad].
        answer_times: from each packet's arrival to its answer [s].
        fault: why the arm does not follow its commands; None while it does. The caller then has to stop it.
        gone_on: cycles before the last packet in which the controller had none of ours and went on as before.
        missed: whether the controller had to do without a command of ours since the last one.
        unanswered: states that came before the last one and too late for an answer, oldest first.
        counts: statistics of the link.
        arrived: time at which the last packet was read, by ``time.perf_counter`` [s].
        horizon: coming cycles of which the link can hand over expected commands; 0 where it cannot.
        speed: share of the path's speed that the controller lets the arm have now: its override.
        paused: why the controller holds the arm for a while; None while it does not.
        notes: the controller's messages to the user.
        clocked: whether the controller keeps time, so that a packet that does not come is lost; a simulated one may
            wait for each answer.
        ahead: expected commands after the next one ``(horizon, n)`` [rad], sent with it; None where unknown, then the
            arm is expected to come to rest.
    """

    counts: Any
    arrived: float = math.nan
    horizon: int = 0
    speed: float = 1.0
    paused: str | None = None
    clocked: bool = True
    notes: tuple[str, ...] = ()
    unanswered: tuple[RobotState, ...] = ()
    ahead: Array | None = None
    lost_link: ClassVar[type[IdealRobotError]] = IdealRobotError
    """What is raised where the link breaks."""
    packets: ClassVar[str] = "packets"
    """What the interface calls them."""

    def __init__(self, robot: Robot, bridge: float, answers_within: float, relative: bool = False) -> None:
        self.robot, self.t_ipo, self.counts = robot, robot.t_ipo, LinkCounts()
        self.max_lost = max(math.ceil(bridge / robot.t_ipo), 1)
        self.fault: str | None = None
        self._lost: str | None = None
        self.commanded = self._wanted = self._step = np.full(robot.n, np.nan)
        self.answer_times = array("d")
        self.gone_on, self.missed, self._led, self._replaced = 0, False, False, False
        # Change of the controller's commands per cycle; zero if the controller keeps the arm in place without one.
        self._wire_speed = np.zeros(robot.n)
        self._told = np.zeros((2, robot.n))
        self._arrivals: deque[float] = deque(maxlen=_ARRIVALS)
        self._stood_in, self._late_ones, self._heard, self._heard_at = 0, 0, 0, math.nan
        self._stood = np.full(robot.n, np.nan)
        # Without acceleration limits, a start from rest is assumed to take a third of a second.
        v_max = np.where(np.isfinite(robot.v_max), robot.v_max, 1.0)
        self._room = np.where(np.isfinite(robot.a_max), 0.5 * robot.a_max, v_max / 0.3)
        self._catch_up = CatchUp(2.0 * self._room, v_max, robot.t_ipo)
        self._watch = FollowingWatch(robot.n, math.ceil(answers_within / robot.t_ipo) + self.max_lost,
                                     np.maximum(3.0 * v_max * robot.t_ipo, np.radians(1.0)), relative)

    def cycle(self, q_c: Array) -> RobotState:
        """Commands ``q_c (n,)`` [rad] and waits for the next packet.

        Raises:
            InputError: wrong size or not finite.
            LimitError: outside the joint limits, or more than twice the velocity limit away from the last command.
            IdealRobotError: see ``receive``.
        """
        self.send(q_c)
        return self.receive()

    def skip(self, q_c: Array) -> None:
        """Notes a desired position that is not commanded; the next command continues there. Raises as ``cycle``."""
        self._want(q_c)
        self.missed = self.missed or not self.horizon

    def _want(self, q_c: Array) -> Array:
        """Notes what is wanted from now on, and by how much that is further than before."""
        self._check_link()
        q_c, self._before = checked_command(self.robot, q_c, self._wanted, self.t_ipo), (self._wanted, self._step)
        self._step, self._wanted = q_c - self._wanted, q_c
        return q_c

    def _led_back(self, q_c: Array, speed: Array) -> Array:
        """The command ``(n,)`` [rad] for a wanted one, from the speed in force [rad a cycle], which is held evenly."""
        if self.missed or self._replaced:
            wanted, before = self._before
            self._catch_up.start(self.commanded - wanted, speed - before, before - self._step, before)
            self.missed = self._replaced = False
        back = self._catch_up.active
        return np.clip(q_c + self._catch_up.next(self._step), self.robot.q_min, self.robot.q_max) if back else q_c

    @property
    def settled(self) -> bool:
        """Whether the controller's setpoint is the desired one, without an offset from missed cycles."""
        return not (self.missed or self._replaced or self._catch_up.active)

    @property
    def tolerance(self) -> float:
        """Largest deviation of the arm from its commands [rad], including the uncertainty after lost commands."""
        return self._watch.tolerance

    def cause(self, joint: int) -> str:
        """Likely cause, in words, of the deviation of a joint, counted from 0."""
        return self._watch.cause(joint)

    @property
    def meta(self) -> dict[str, Any]:
        """Entries on the link for a recording's metadata."""
        return {}

    @abstractmethod
    def connect(self, patience: float = 60.0) -> RobotState:
        """Waits for the controller up to ``patience`` [s]; the state at rest, with its setpoint in ``commanded``."""

    def send(self, q_c: Array) -> None:
        """First half of ``cycle``: sends a command and returns, so that the cycle's time can be used for computing.

        Raises ``lost_link`` before ``connect``, where the link is broken, or where the arm has moved before the first
        command.
        """
        if not np.isfinite(self.commanded).all():
            raise self.lost_link("connect to the controller before sending a command")
        if not self._led:
            self._require_unmoved()
        q_c = self._led_back(self._want(q_c), self._wire_speed)
        self._handed_over(q_c)
        self.answer_times.append(time.perf_counter() - self.arrived)
        self.commanded = q_c

    @abstractmethod
    def _handed_over(self, q_c: Array) -> None:
        """Answers the last packet with a command ``(n,)`` [rad]."""

    def _with_ahead(self, q_c: Array) -> Array:
        """A command ``(n,)`` and those expected of the coming cycles, with it ``(1 + horizon, n)`` [rad]."""
        if self.ahead is None:
            # Comes to rest within the horizon, starting with the last step.
            ahead = np.cumsum(np.linspace(1.0, 0.0, self.horizon)[:, None] * self._step, axis=0) + self._wanted
        else:
            ahead, self.ahead = self.ahead, None
        rows = np.vstack([q_c, ahead + (q_c - self._wanted)])
        self._told = np.clip(rows, self.robot.q_min, self.robot.q_max)
        return self._told

    def _stands_now(self) -> Array | None:
        """Where the arm is now, before the first command ``(n,)`` [rad]; None where the link has heard nothing more."""
        return None

    def _require_unmoved(self) -> None:
        """Raises ``lost_link`` where the arm is not where it was when the controller was reached.

        What is loaded before the first command takes as long as it takes; an arm may be moved by hand meanwhile, or by
        another program, and would be torn back.
        """
        if (now := self._stands_now()) is None:
            return
        off = np.abs(now - self._stood)
        j = int(np.argmax(off))
        if off[j] > self.tolerance:
            size = f"{np.degrees(off[j]):.2f}°" if self.robot.units("rad")[j] == "rad" else f"{1e3 * off[j]:.2f} mm"
            self._lost = (f"joint {j + 1} has moved by {size} since the controller was reached, before anything was "
                          "commanded; begin anew with the arm at rest")
            raise self.lost_link(self._lost)

    def _next_due(self, deadline: Deadline) -> Deadline:
        """Until when the next packet is waited for before an expected command goes out in its place.

        A packet that is lost would leave the controller without a command for a cycle, in which it holds the arm. Where
        packets come evenly this computer's clock shows it within the cycle, which is in time.

        Args:
            deadline: until when it is waited for at all.
        """
        intervals = np.diff(self._arrivals)
        even = np.abs(intervals - self.t_ipo) < _EVEN * self.t_ipo
        if np.count_nonzero(even) < _EVENLY * (_ARRIVALS - 1) or not self.clocked or self._braked:
            return deadline
        due = self._heard_at + (self._stood_in - self._heard + 1.0 + _WAITED) * self.t_ipo
        return Deadline(deadline.seconds, min(due, deadline.end))

    def _awaited(self, deadline: Deadline, read: Callable[[Deadline], Packet | None],
                 hand_over: Callable[[Array, int], None]) -> Packet | None:
        """The next packet; None where it has to be waited for without a command in its place, see ``_next_due``.

        Args:
            deadline: until when it is waited for at all.
            read: reads what is there until another deadline; None where nothing came.
            hand_over: commands joint angles ``(n,)`` [rad] of a cycle, counted from the last packet.
        """
        while (due := self._next_due(deadline)) is not deadline and not deadline.passed:
            if (packet := read(due)) is not None:
                return packet
            if due.passed:
                self._stood_in += 1
                if self._stood_in == len(self._told):
                    # Without a known continuation of the path the arm comes to rest.
                    step = self._told[-1] - self._told[-2]
                    count = max(math.ceil(float(np.max(np.abs(step) / (self._room * self.t_ipo**2)))), 1)
                    self._told = np.vstack([self._told, self._told[-1] + (1.0 - 1.0 / count) * step])
                hand_over(self._told[self._stood_in], self._stood_in)
        return None

    @property
    def _braked(self) -> bool:
        """Whether the commands in place of packets that do not come have come to rest."""
        return self._stood_in > self.horizon and bool(np.array_equal(self._told[-1], self._told[-2]))

    def _came_late(self, since: int) -> None:
        """A packet has come so many cycles behind the last, when its answer had gone out already."""
        self._late_ones += 1
        if self._late_ones > 1:
            # The controller's clock was delayed: the next packet is expected relative to this one.
            self._heard, self._heard_at = since, self.arrived

    def _came(self) -> None:
        """A packet has come that is to be answered."""
        self._arrivals.append(self.arrived)
        self._stood_in, self._late_ones, self._heard, self._heard_at = 0, 0, 0, self.arrived

    def _at_rest(self, commanded: Array, measured: Array) -> None:
        """The controller is there and holds the arm: positions ``(n,)`` each [rad]."""
        self._arrivals.clear()
        self._stood_in = 0
        self._stood = measured
        self.commanded = self._wanted = commanded
        self._step, self._lost, self._led = np.zeros(self.robot.n), None, False
        self._watch.begin(commanded, measured)

    def _bridged(self, since: int, older: int = 0, stood_in: int | None = None) -> None:
        """Counts cycles without an answer before this packet; raises ``lost_link`` for more than are tolerated.

        Until the first command the controller holds the arm where it stands, however long that takes.

        Args:
            since: cycles since the packet before; 1 where none was missed.
            older: packets of these cycles that were read together with this one: they came, but too late for an answer.
            stood_in: cycles of these in which an expected command was in force; all within the horizon if None.
        """
        self.gone_on = 0
        if not self._led:
            self._led = True
            return
        late = min(older, max(since - 1, 0))
        if since - 1 > self.max_lost:
            raise self.lost_link(f"{since - 1} {self.packets} in a row {_missed(since - 1 - late, late)}, more than "
                                 f"{self.max_lost}; check network and load")
        if since > 1:
            self.counts.lost += since - 1 - late
            self.counts.late += late
            at = min(since - 1 if stood_in is None else stood_in, self.horizon)
            self.missed = since - 1 > at or self.missed
            if self.horizon:
                # The expected commands were executed, which may differ from the desired ones; after the last the arm
                # stops.
                self._replaced, self.gone_on = True, at
                self.commanded = self._told[at]
                self._wire_speed = (self._told[at] - self._told[at - 1]) if since - 1 == at else np.zeros(self.robot.n)

    def _looked_at(self, q: Array) -> Array:
        """Looks whether the arm, measured at ``q (n,)`` [rad], does what was commanded; returns ``q``."""
        self.counts.cycles += 1
        if self.fault is None:
            self.fault = self._watch.check(self.commanded, q)
            self.counts.implausible = self._watch.missing
        return q

    def receive(self) -> RobotState:
        """Second half of ``cycle``: waits for the next packet.

        Raises ``lost_link`` where the link is broken, and then in every call: a controller that answers again later was
        restarted, and its arm is not where the old commands ended.
        """
        self._check_link()
        try:
            return self._received()
        except self.lost_link as error:
            self._lost = str(error)
            raise

    def _check_link(self) -> None:
        """Raises ``lost_link`` where the link was lost."""
        if self._lost is not None:
            raise self.lost_link(self._lost)

    @abstractmethod
    def _received(self) -> RobotState:
        """See ``receive``."""

    @abstractmethod
    def close(self) -> None:
        """Closes the link."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()
