r"""One guard around every motion of an arm: what is looked at in each cycle, how it is stopped, how it lets go.

A motion says where it wants to go; nothing of what guards it differs from one motion to the next. Each of the guard's
watches (a force sensor, the arm's following, a camera) is asked in every cycle whether the motion may go on, and before
a motion how fast each part of it may be. Where one says no, the arm is braked on what lies ahead and then led back
along its trail, the way it came, until nothing is felt any more: what it came through is free. No other motion
follows.

A path whose rows may be passed with a share :math:`r_k \le 1` of their speed is timed anew. With :math:`\sigma` the
path's own time,

.. math:: \dot\sigma \le r_k, \qquad |\ddot\sigma| \le \alpha_k = \min_j \frac{\eta\, a_{max,j}}{|dq_j/d\sigma|},

which one pass forwards and one backwards over :math:`\dot\sigma_{k+1}^2 = \dot\sigma_k^2 \pm 2 \alpha_k \Delta\sigma`
give.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np

from ideal_robot.arrays import Array, eased_way, interpolated
from ideal_robot.errors import IdealRobotError
from ideal_robot.execution.command_governor import stopping_rows
from ideal_robot.robots.interface import RobotInterface, RobotState
from ideal_robot.robots.robot import Robot

Cycle = Callable[[Array], RobotState]
"""Hands over a command ``(n,)`` [rad] and waits a cycle, as ``RobotInterface.cycle`` does."""

SHARE = 0.5
"""Share η of the joints' accelerations for braking and for changes of the speed along a path: half is left for the
path's own."""
AWAY = 0.02
"""Speed of the tool back along the trail [m/s]; it speeds up to it within ``_RAMP``."""
_RAMP = 0.1
MARGIN = 0.01
"""Way that the tool goes on when nothing is felt any more [m]: a force sensor's error of 2 N is a contact of 2 mm where
a surface gives way by a millimetre a newton."""
BLIND = 0.03
"""Way back where it is not known whether anything is felt [m]."""
_SPACING = 1e-4
"""Change of a joint from one place of the trail to the next [rad, m]: a tenth of a millimetre a metre away."""
_LENGTH = 40_000
"""Places of the trail: four radians of the quickest joint."""
_SLOWEST = 1e-3
"""Share of its speed with which a path goes on at least."""
_FASTEST_UNKNOWN = 5.0
"""Acceleration of a joint whose limit is not known [rad/s²]."""
_REST = 1e-9
"""Change of a command in a cycle below which it rests [rad]."""


class StoppedError(IdealRobotError):
    """A motion had to end: the arm rests, and presses on nothing.

    Args:
        reason: what was noticed, with value, limit and remedy.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class Watch(ABC):
    """Something that is looked at in every cycle of every motion."""

    @abstractmethod
    def look(self, t: float, q_c: Array, q: Array) -> str | None:
        """Why a motion has to end behind this cycle; None where it may go on.

        Args:
            t: end of the cycle [s].
            q_c: command that was handed over in it ``(n,)`` [rad].
            q: motor angles at its end ``(n,)`` [rad].
        """

    @property
    def touching(self) -> bool | None:
        """Whether something is touched; None where it is not known."""
        return False

    @property
    def stands(self) -> Array | None:
        """Command ``(n,)`` [rad] that belongs to where an arm is that has left its commands; None where it follows."""
        return None

    def rates(self, rows: Array, T: float) -> Array:
        """Largest share of its speed with which each row of a path may be passed ``(N,)``.

        Args:
            rows: joint angles at the cycles ``(N, n)`` [rad].
            T: cycle [s].
        """
        return np.ones(len(rows))


class Guard:
    """Stops the motions of one arm, and lets go.

    Args:
        robot: limits and tool.
        q: where the arm rests ``(n,)`` [rad].

    Attributes:
        watches: what is looked at.
        reason: why no motion may go on any more; None while they may.
    """

    def __init__(self, robot: Robot, q: Array) -> None:
        self.watches: list[Watch] = []
        self.reason: str | None = None
        self._robot, self._T = robot, robot.t_ipo
        self._a_max = np.where(np.isfinite(robot.a_max), robot.a_max, _FASTEST_UNKNOWN)
        self._last = np.tile(np.asarray(q, dtype=float), (2, 1))
        self._came: deque[Array] = deque([self._last[0]], maxlen=_LENGTH)

    def stop(self, reason: str) -> None:
        """No motion may go on; the first reason counts. To be called from anywhere."""
        self.reason = self.reason or reason

    def check(self) -> None:
        """Raises ``StoppedError`` where no motion may go on."""
        if self.reason is not None:
            raise StoppedError(self.reason)

    def look(self, t: float, q_c: Array, q: Array) -> None:
        """Asks every watch, behind each cycle.

        Args:
            t: end of the cycle [s].
            q_c: command that was handed over in it ``(n,)`` [rad].
            q: motor angles at its end ``(n,)`` [rad].
        """
        self._last = np.array([self._last[1], q_c])
        for watch in self.watches:
            if (reason := watch.look(t, q_c, q)) is not None:
                self.stop(reason)
        if self.touching is False and np.max(np.abs(q_c - self._came[-1])) > _SPACING:
            self._came.append(np.array(q_c))

    @property
    def touching(self) -> bool | None:
        """Whether any watch feels a touch; None where none does and one does not know."""
        felt = [watch.touching for watch in self.watches]
        return True if True in felt else None if None in felt else False

    def back_to_arm(self, q_c: Array) -> Array | None:
        """Way ``(n,)`` [rad] from a command ``(n,)`` [rad] to where the arm stands; None where it follows.

        Commanded there it does not leap when it is let go on.
        """
        stands = next((watch.stands for watch in self.watches if watch.stands is not None), None)
        return None if stands is None else stands - q_c

    def around(self, arm: RobotInterface) -> Cycle:
        """The cycles of an arm, each of which is looked at."""
        def cycle(q_c: Array) -> RobotState:
            state = arm.cycle(q_c)
            self.look(state.t, q_c, state.q)
            return state

        return cycle

    def timed(self, rows: Array) -> Array:
        """The path of ``rows (N, n)`` [rad], from rest to rest, no faster than every watch lets it be ``(M, n)``."""
        T = self._T
        if len(rows) < 3 or not self.watches:
            return rows
        rate = np.minimum.reduce([watch.rates(rows, T) for watch in self.watches])
        if (rate >= 1.0).all():
            return rows
        rate = np.clip(rate, _SLOWEST, 1.0)
        # Of the two steps beside each row the faster one: between rows the path is straight.
        step = np.abs(np.diff(rows, axis=0)) / T
        speed = np.maximum(np.vstack([step[:1], step]), np.vstack([step, step[-1:]]))
        with np.errstate(divide="ignore"):
            change = SHARE * np.min(np.divide(self._a_max, speed, out=np.full_like(speed, np.inf), where=speed > 1e-9),
                                    axis=1)
        for order in (range(1, len(rows)), range(len(rows) - 2, -1, -1)):
            for k in order:
                before = k - order.step
                rate[k] = min(rate[k], np.sqrt(rate[before] ** 2 + 2.0 * min(change[k], change[before]) * T))
        instants = np.concatenate([[0.0], np.cumsum(2.0 * T / (rate[1:] + rate[:-1]))])
        cycles = T * np.arange(np.ceil(instants[-1] / T - 1e-9) + 1)
        return interpolated(cycles, instants, rows)

    def lead(self, cycle: Cycle, rows: Array) -> None:
        """Leads an arm through ``rows (N, n)`` [rad] from rest to rest, as fast as it may be.

        Raises ``StoppedError`` where it had to end; the arm then rests on the path, or as far back on it as it had to
        go to touch nothing.
        """
        self.go(cycle, self.timed(rows))

    def go(self, cycle: Cycle, rows: Array) -> None:
        """``lead`` for rows that are ``timed`` already."""
        self.check()
        with self.motion(cycle):
            for k, q_c in enumerate(rows):
                cycle(q_c)
                if self.reason is not None:
                    for braking in self.braking(rows[k:]):
                        cycle(braking)
                    self.check()

    @contextmanager
    def motion(self, cycle: Cycle) -> Iterator[None]:
        """Whatever ends the motion in the block early, the arm is at rest behind it and touches nothing."""
        try:
            yield
        except IdealRobotError:
            # Where the arm is gone there is nothing to be led back.
            with suppress(IdealRobotError):
                self.release(cycle)
            raise

    def release(self, cycle: Cycle) -> None:
        """Brakes, and leads the arm back along its trail until nothing is felt any more.

        The commands of an arm that has not followed them are led to where it stands.
        """
        for q_c in self.braking():
            cycle(q_c)
        now = self._last[1]
        if (way := self.back_to_arm(now)) is not None:
            for q_c in eased_way(now, now + way, (np.full(len(way), np.inf), SHARE * self._a_max), self._T):
                cycle(q_c)
        for q_c in self._back():
            cycle(q_c)

    def braking(self, ahead: Array | None = None) -> Iterator[Array]:
        """Commands ``(n,)`` [rad] to rest along the rows ``ahead (m, n)`` of the motion, straight on without them."""
        last, now = self._last
        step = now - last
        if np.max(np.abs(step)) < _REST:
            return
        lasts = float(np.max(np.abs(step) / self._T / self._a_max)) / SHARE
        count = 6 + int(lasts / self._T)
        if ahead is None or len(ahead) < 4:
            ahead = now + step * np.arange(float(count))[:, None]
        for horizon in stopping_rows(ahead[:count], self._T, lasts, 1.0):
            if np.max(np.abs(horizon[1] - horizon[0])) < _REST:
                return
            yield horizon[1]

    def _back(self) -> Iterator[Array]:
        """Commands ``(n,)`` [rad] back along the trail; its places are worked out as they come."""
        touching = self.touching
        if touching is False:
            return
        trail = _Trail(self._robot, self._last[1], self._came)
        way = speed = 0.0
        until = BLIND if touching is None else np.inf
        while (way < until or speed > 0.0) and not trail.ended:
            touching = self.touching
            if until == np.inf and touching is False:
                until = way + MARGIN
            elif touching is True:
                until = np.inf
            most = AWAY if way < until else 0.0
            speed += float(np.clip(most - speed, -AWAY * self._T / _RAMP, AWAY * self._T / _RAMP))
            way += speed * self._T
            yield trail.further(speed * self._T)


class _Trail:
    """Goes back over places: from ``q (n,)`` [rad] through those that an arm ``came`` through, the last one first."""

    def __init__(self, robot: Robot, q: Array, came: deque[Array]) -> None:
        self._robot, self._q, self._came, self._place = robot, q, came, robot.tool_places(q[None])[0]

    @property
    def ended(self) -> bool:
        """Whether the begin of the trail is reached."""
        return not self._came

    def further(self, way: float) -> Array:
        """Joint angles ``(n,)`` [rad] so much further back [m]; a turn by a radian counts as a tenth of a metre."""
        while self._came:
            q = self._came[-1]
            place = self._robot.tool_places(q[None])[0]
            length = max(float(np.linalg.norm(place - self._place)), 0.1 * float(np.max(np.abs(q - self._q))))
            if length > way:
                share = way / length
                self._q, self._place = self._q + share * (q - self._q), self._place + share * (place - self._place)
                break
            way -= length
            self._q, self._place = q, place
            self._came.pop()
        return self._q
