r"""The guard around every motion of an arm: what is checked in each cycle, how the arm stops and retracts.

All motions are guarded in the same way. In every cycle each of the guard's watches (a force sensor, the arm's
following, a camera) says whether the motion may continue, and before a motion how fast each part of it may be. If one
refuses, the arm brakes along the path ahead and then returns along its trail until there is no contact, as the trail is
free. No other motion follows.

An arm that stands still against its commands, because it is paused or its brakes are closed, need not retract: its
commands move to where it stands and stay there, so that it does not jump when it is released. Then the path is tried so
slowly that an arm released meanwhile is not jerked, and continues from the arm's place as soon as it follows.

A path whose rows may be passed with a share :math:`r_k \le 1` of their speed is timed anew. With :math:`\sigma` the
path's own time,

.. math:: \dot\sigma \le r_k, \qquad |\ddot\sigma| \le \alpha_k = \min_j \frac{\eta\, a_{max,j}}{|dq_j/d\sigma|},

which one pass forwards and one backwards over :math:`\dot\sigma_{k+1}^2 = \dot\sigma_k^2 \pm 2 \alpha_k \Delta\sigma`
give.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np

from ideal_robot.arrays import Array, eased, eased_way, interpolated
from ideal_robot.errors import IdealRobotError
from ideal_robot.execution.command_governor import Bounds, governed
from ideal_robot.execution.path_stop import stopping_rows
from ideal_robot.jit import jit
from ideal_robot.robots.interface import RobotInterface, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import FINEST, ROUNDING, SLOWEST_RATE, TRAIL_LENGTH, TRAIL_SPACING, UNRESOLVED

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
_FASTEST_UNKNOWN = 5.0
"""Acceleration of a joint whose limit is not known [rad/s²]."""
_TIMES = 3
"""How often the commands follow an arm that goes on meanwhile: one that sinks, or is moved by hand."""
_RISE = 0.03
"""Time in which the acceleration of that way rises to its limit [s], as in ``robots.interface``."""
_LONGEST = 3.0
"""Time in which an arm comes to rest with that at any speed [s]."""
_RAMPS = 1.0
"""Time of a path in which it reaches its speed again [s]."""
PATIENCE = 60.0
"""How long an arm that stands still is waited for [s]: as long as for a controller that has not come yet."""
_PAUSE = 0.5
"""How long commands are held at an arm that stands before the path is tried again [s]."""
_CALM = 3.0
"""Time without another standstill after which the next one is waited for as long again [s]; a try takes less."""
LATELY = 0.6
"""Time in which commands can be ahead of an arm whose standstill is noticed [s]: that of a loop that answers slowly."""


class StoppedError(IdealRobotError):
    """A motion had to end: the arm is at rest without contact.

    Args:
        reason: the finding, with value, limit and remedy.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class Watch(ABC):
    """Interface of a check in every cycle of every motion."""

    @abstractmethod
    def look(self, t: float, q_c: Array, q: Array) -> str | None:
        """Why a motion has to end after this cycle; None where it may continue.

        Args:
            t: end of the cycle [s].
            q_c: command that was handed over in it ``(n,)`` [rad].
            q: motor angles at its end ``(n,)`` [rad].
        """

    @property
    def touching(self) -> bool | None:
        """Whether there is contact; None where it is not known."""
        return False

    @property
    def stands(self) -> Array | None:
        """Command ``(n,)`` [rad] of the place where an arm stands that has left its commands; None where it follows."""
        return None

    @property
    def unsure(self) -> bool:
        """Whether the motion may differ from its commands, so that other checks cannot rely on them."""
        return False

    @property
    def passes(self) -> bool:
        """Whether the finding may pass by itself, so that the motion can then continue."""
        return False

    def begin_again(self) -> None:
        """Restarts the check with the arm at rest at its commands, after a finding that may pass; see ``passes``."""
        return

    def rates(self, rows: Array, T: float) -> Array:
        """Largest permitted share of the speed for each row of a path ``(N,)``.

        Args:
            rows: joint angles at the cycles ``(N, n)`` [rad].
            T: cycle [s].
        """
        return np.ones(len(rows))


class Guard:
    """Stops the motions of one arm, and retracts it from contact.

    Args:
        robot: limits and tool.
        q: joint angles at which the arm rests ``(n,)`` [rad].

    Attributes:
        watches: the checks of every cycle.
        reason: why no motion may go on any more; None while they may.
        held: why the motion waits; None while it goes on.
        patience: how long a motion waits at most [s].
    """

    def __init__(self, robot: Robot, q: Array) -> None:
        self.watches: list[Watch] = []
        self.reason: str | None = None
        self.held: str | None = None
        self.patience, self._waited = PATIENCE, 0.0
        self._robot, self._T = robot, robot.t_ipo
        self._a_max = accelerations(robot)
        self._v_max = np.where(np.isfinite(robot.v_max), robot.v_max, 1.0)
        self._came: deque[Array] = deque(maxlen=TRAIL_LENGTH)
        self._given: deque[Array] = deque(maxlen=round(LATELY / self._T) + 1)
        self._went_on, self._going_back, self._handed = 0, False, False
        self.begin(q)
        # A first call loads compiled code before an arm waits for it.
        slowed(np.zeros((3, robot.n)), np.ones(3), self._a_max, self._T)

    def begin(self, q: Array) -> None:
        """Restarts with the arm at rest at ``q (n,)`` [rad]: everything but the reason of a stop is reset."""
        self._last = np.tile(np.asarray(q, dtype=float), (2, 1))
        self._given.clear()
        self._given.append(self._last[0])
        self._came.clear()
        self._came.append(self._last[0])

    def stop(self, reason: str) -> None:
        """Ends all motion, from any thread; of several reasons the first is reported."""
        self.reason = self.reason or reason

    def check(self) -> None:
        """Raises ``StoppedError`` where no motion may continue."""
        if self.reason is not None:
            raise StoppedError(self.reason)

    def hand_over(self, q_c: Array) -> None:
        """Stores a command ``(n,)`` [rad] that was sent; ``look`` follows at the end of its cycle.

        Needed only if the next command is computed before ``look``; otherwise ``look`` stores it.
        """
        self._last = np.array([self._last[1], q_c])
        self._given.append(self._last[1])
        self._handed = True

    def look(self, t: float, q_c: Array, q: Array) -> None:
        """Runs the checks of every watch at the end of a cycle.

        Args:
            t: end of the cycle [s].
            q_c: command that was handed over in it ``(n,)`` [rad].
            q: motor angles at its end ``(n,)`` [rad].
        """
        if not self._handed:
            self.hand_over(q_c)
        self._handed = False
        for watch in self.watches:
            if (reason := watch.look(t, q_c, q)) is not None:
                if watch.passes:
                    self.held = self.held or reason
                else:
                    self.stop(reason)
        self._went_on = 0 if self.held is not None else self._went_on + 1
        if self._went_on * self._T > _CALM:
            self._waited = 0.0
        # While it retracts, the places are on the trail already.
        if not self._going_back and self.touching is False and np.max(np.abs(q_c - self._came[-1])) > TRAIL_SPACING:
            self._came.append(np.array(q_c))

    @property
    def unsure(self) -> bool:
        """Whether any watch finds that the motion may differ from its commands."""
        return any(watch.unsure for watch in self.watches)

    @property
    def touching(self) -> bool | None:
        """Whether any watch finds contact; None where none does and at least one cannot determine it."""
        felt = [watch.touching for watch in self.watches]
        return True if True in felt else None if None in felt else False

    def back_to_arm(self, q_c: Array) -> Array | None:
        """Displacement ``(n,)`` [rad] from a command ``(n,)`` [rad] to where the arm stands; None where it follows.

        Commanded there, the arm does not jump when it is released.
        """
        stands = self._stands
        return None if stands is None else stands - q_c

    @property
    def astray(self) -> bool:
        """Whether the arm has left its commands."""
        return self._stands is not None

    @property
    def _stands(self) -> Array | None:
        """See ``Watch.stands``."""
        return next((watch.stands for watch in self.watches if watch.stands is not None), None)

    def around(self, arm: RobotInterface) -> Cycle:
        """An arm's cycle function with the guard's check after each cycle."""
        def cycle(q_c: Array) -> RobotState:
            state = arm.cycle(q_c)
            self.look(state.t, q_c, state.q)
            return state

        return cycle

    def timed(self, rows: Array) -> Array:
        """The path ``rows (N, n)`` [rad] retimed from rest to rest, as fast as every watch permits ``(M, n)``."""
        T = self._T
        if len(rows) < 3 or not self.watches:
            return rows
        rate = np.minimum.reduce([watch.rates(rows, T) for watch in self.watches])
        if (rate >= 1.0).all():
            return rows
        return at_cycles(rows, slowed(rows, rate, self._a_max, T), T)

    def lead(self, cycle: Cycle, rows: Array) -> None:
        """Moves an arm along ``rows (N, n)`` [rad] from rest to rest, as fast as every watch permits.

        Raises ``StoppedError`` where it had to end; the arm then is at rest on the path, or further back on it without
        contact.
        """
        self.go(cycle, self.timed(rows))

    def go(self, cycle: Cycle, rows: Array) -> None:
        """Moves an arm along rows that ``timed`` has already retimed; see ``lead``."""
        self.check()
        with self.motion(cycle):
            for q_c in self.along(rows):
                cycle(q_c)
            self.check()

    def along(self, rows: Array) -> Iterator[Array]:
        """Yields commands ``(n,)`` [rad] along rows ``(N, n)`` [rad], each to be sent before the next.

        While the arm is paused they wait and then continue; after a stop they brake on the path and end.
        """
        for q_c, *_ in self.steps(rows):
            yield q_c

    def steps(self, rows: Array, *beside: Array) -> Iterator[tuple[Array, ...]]:
        """Yields commands along ``rows`` as ``along`` does, each with the rows of ``beside (N, …)`` at its place.

        While the arm is paused, these stay the rows of the place at which it stands.
        """
        k = 0
        while k < len(rows):
            here = tuple(values[k] for values in beside)
            yield rows[k], *here
            if self.reason is not None:
                for q_c in self.braking(rows[k:]):
                    yield q_c, *here
                return
            k += 1
            if self.held is not None:
                for q_c in self.waiting():
                    yield q_c, *here
                if self.reason is not None:
                    return
                (rows, *others), k = self.resumed(rows, k, *beside), 0
                beside = tuple(others)

    @contextmanager
    def motion(self, cycle: Cycle) -> Iterator[None]:
        """Brings the arm to rest without contact where the motion in the block ends early."""
        try:
            yield
        except IdealRobotError:
            # If the link to the arm is lost, it cannot be moved back.
            with suppress(IdealRobotError):
                for q_c in self.leaving():
                    cycle(q_c)
            raise

    def leaving(self) -> Iterator[Array]:
        """Yields commands ``(n,)`` [rad] to rest, and back along the trail until there is no contact.

        If the arm has not followed, its commands move to where it stands instead of braking ahead.
        """
        yield from self.braking() if self._stands is None else self._to_arm()
        yield from self.back()

    def waiting(self) -> Iterator[Array]:
        """Yields commands ``(n,)`` [rad] to where a paused arm stands, and there for a while.

        Then the motion may be tried again, unless it was stopped meanwhile, as after ``patience``.
        """
        yield from self._to_arm()
        now = self._last[1]
        for _ in range(round(_PAUSE / self._T)):
            if self.reason is not None:
                return
            yield now
        # The arm was moved by hand meanwhile, or is released just now.
        yield from self._to_arm()
        for watch in self.watches:
            watch.begin_again()
        self._waited += _PAUSE
        if self._waited > self.patience:
            self.stop(f"{self.held}; waited for it for {self.patience:.0f} s")
        self.held = None

    def resumed(self, rows: Array, k: int, *beside: Array) -> tuple[Array, ...]:
        """The rest of a path from where a paused arm stands, and the rest of the arrays beside it.

        It begins at the place that is nearest to the arm, slowly until the arm has shown that it follows.

        Args:
            rows: joint angles at the cycles ``(N, n)`` [rad].
            k: row at which the arm was paused.
            beside: further arrays with one entry per row ``(N, …)``.
        """
        now, T, small = self._last[1], self._T, probed(self._a_max, self._T)
        begin = max(k - round(LATELY / T), 0)
        nearest = max(begin + int(np.argmin(np.max(np.abs(rows[begin : k + 1] - now), axis=1))) - 1, 0)
        # Interpolated so finely that several places lie within the slow begin of the motion.
        part = rows[nearest : nearest + round(_RAMPS / T) + 2]
        fine = int(np.clip(np.ceil(np.max(np.abs(np.diff(part, axis=0)), initial=0.0) / (0.25 * small)), 1, FINEST))
        places = np.arange(fine * (len(part) - 1) + 1) / fine
        part = interpolated(places, np.arange(float(len(part))), part)
        first = int(np.argmin(np.max(np.abs(part[: 2 * fine + 1] - now), axis=1)))
        part, places = part[first:], nearest + places[first:]
        step = np.max(np.abs(np.diff(part, axis=0, append=part[-1:])), axis=1) * fine / T
        way = np.max(np.abs(part - part[0]), axis=1)
        trying = np.where(way < PROVED * small, probing_speed(self._a_max, T), np.inf)
        rate = np.minimum(trying / np.maximum(step, 1e-12), 1.0)
        rate[0] = 0.0
        instants = slowed(part, rate, self._a_max, T / fine)
        rest = np.arange(places[-1] + 1.0, len(rows))
        instants = np.concatenate([instants, instants[-1] + T * np.arange(1.0, len(rest) + 1.0)])
        passed = interpolated(T * np.arange(np.ceil(instants[-1] / T - ROUNDING) + 1), instants,
                              np.concatenate([places, rest])[:, None])[:, 0]
        left, *others = (interpolated(passed, np.arange(float(len(rows))), values.reshape(len(rows), -1)
                                      ).reshape(-1, *values.shape[1:]) for values in (rows, *beside))
        # The paused arm may be beside the path and approaches it as slowly.
        off = now - left[0]
        lasts = max(float(np.max(np.abs(off))) / (0.5 * probing_speed(self._a_max, T)), T)
        share = np.minimum(T * np.arange(1.0, len(left) + 1.0) / lasts, 1.0)[:, None]
        return np.asarray(left + off * (1.0 - eased(share))), *others

    def _to_arm(self) -> Iterator[Array]:
        """Commands ``(n,)`` [rad] to where an arm stands that has left them, braked and back in one motion.

        They stay on the way they came, as quickly as the joints' accelerations allow: until they are there the arm has
        something to make good, and if it is let go on meanwhile it keeps to its path.
        """
        for _ in range(_TIMES):
            stands, (last, now) = self._stands, self._last
            if stands is None:
                return
            if np.max(np.abs(now - stands)) < UNRESOLVED and np.max(np.abs(now - last)) < ROUNDING:
                return
            came = np.array(self._given)
            beside = np.max(np.abs(came - stands), axis=1)
            # The trail begins at the last command near that place.
            came = came[int(np.flatnonzero(beside <= beside.min() + probed(self._a_max, self._T))[-1]) :]
            begin = float(len(came) - 1)
            # The arm continues straight on while it brakes.
            line = np.vstack([came, now + (now - last) * np.arange(1.0, _LONGEST / self._T)[:, None]])
            step = np.max(np.abs(np.diff(line, axis=0)), axis=0)
            if begin == 0.0 or np.max(step) < ROUNDING:
                limits = (0.1 * self._v_max, SHARE * self._a_max)
                yield from eased_way(now, stands, limits, self._T)
                continue
            a = float(np.min(self._a_max * self._T**2 / np.maximum(step, 1e-12)))
            v = float(np.min(self._v_max * self._T / np.maximum(step, 1e-12)))
            bounds = Bounds(*(np.array([value]) for value in (0.0, len(line) - 1.0, max(v, 1.0), a,
                                                              a * self._T / _RISE)))
            way, rows = np.array([[begin - 2.0], [begin - 1.0], [begin]]), np.arange(float(len(line)))
            while abs(way[2, 0]) > ROUNDING or abs(way[2, 0] - way[1, 0]) > ROUNDING:
                at = governed(np.zeros(1), way, 1.0, bounds)
                way = np.vstack([way[1:], at])
                off = (stands - line[0]) * (1.0 - eased(np.clip(at / begin, 0.0, 1.0)))
                yield interpolated(at, rows, line)[0] + off

    def braking(self, ahead: Array | None = None) -> Iterator[Array]:
        """Yields commands ``(n,)`` [rad] to rest along the rows ``ahead (m, n)``, straight on without them."""
        last, now = self._last
        step = now - last
        if np.max(np.abs(step)) < ROUNDING:
            return
        lasts = float(np.max(np.abs(step) / self._T / self._a_max)) / SHARE
        count = 6 + int(lasts / self._T)
        if ahead is None or len(ahead) < 4:
            ahead = now + step * np.arange(float(count))[:, None]
        for horizon in stopping_rows(ahead[:count], self._T, lasts, 1.0):
            if np.max(np.abs(horizon[1] - horizon[0])) < ROUNDING:
                return
            yield horizon[1]

    def back(self) -> Iterator[Array]:
        """Yields commands ``(n,)`` [rad] from rest back along the trail until there is no contact.

        They are computed one by one.
        """
        touching = self.touching
        if touching is False:
            return
        trail = _Trail(self._robot, self._last[1], self._came)
        self._going_back, way, speed = True, 0.0, 0.0
        until = BLIND if touching is None else np.inf
        while (way < until or speed > 0.0) and not trail.ended:
            touching = self.touching
            if touching is True:
                until = np.inf
            elif until == np.inf:
                until = way + (MARGIN if touching is False else BLIND)
            most = AWAY if way < until else 0.0
            speed += float(np.clip(most - speed, -AWAY * self._T / _RAMP, AWAY * self._T / _RAMP))
            way += speed * self._T
            yield trail.further(speed * self._T)
        self._going_back = False


# Slowing a path down, and trying whether an arm follows.

PROVED = 4.0
"""Ways by which a standstill is noticed while the path is tried, after which an arm that goes along follows."""
SEEN = np.radians(0.02)
"""Way of a joint that stands out of the noise of its encoder and of the friction it starts against [rad]."""
_ANSWERED = 0.1
"""Time after which nearly every loop has answered a command [s]."""


def accelerations(robot: Robot) -> Array:
    """Acceleration limits of the joints ``(n,)`` [rad/s²], ``_FASTEST_UNKNOWN`` where unknown."""
    return np.where(np.isfinite(robot.a_max), robot.a_max, _FASTEST_UNKNOWN)


def probed(a_max: Array, T: float) -> float:
    """Largest distance of a tried path ahead of an arm that stands still [rad].

    A controller released just then covers it in one cycle with half of the weakest joint's acceleration. Encoders
    resolve it for cycles of 5 ms and longer.

    Args:
        a_max: accelerations of the joints ``(n,)`` [rad/s²].
        T: cycle [s].
    """
    return max(0.5 * float(np.min(a_max)) * T**2, float(SEEN))


def probing_speed(a_max: Array, T: float) -> float:
    """Speed of the joints at which a path is tried [rad/s]: ``probed`` within the time of a slow loop's response."""
    return probed(a_max, T) / _ANSWERED


@jit()
def _passed(rate: Array, change: Array, T: float) -> None:
    """Lowers the rates ``(N,)`` to what the changes ``(N,)`` [1/s] let them be, from either side."""
    for k in range(1, len(rate)):
        rate[k] = min(rate[k], math.sqrt(rate[k - 1] ** 2 + 2.0 * min(change[k], change[k - 1]) * T))
    for k in range(len(rate) - 2, -1, -1):
        rate[k] = min(rate[k], math.sqrt(rate[k + 1] ** 2 + 2.0 * min(change[k], change[k + 1]) * T))


def slowed(rows: Array, rate: Array, a_max: Array, T: float) -> Array:
    """Instants ``(N,)`` [s] of the rows of a path when each is passed with at most a share of its speed.

    Args:
        rows: joint angles at the cycles ``(N, n)`` [rad].
        rate: largest share of its speed with which each row may be passed ``(N,)``.
        a_max: accelerations of the joints ``(n,)`` [rad/s²], of which changes of the speed take ``SHARE``.
        T: cycle [s].
    """
    if len(rows) < 3:
        return np.asarray(T * np.arange(float(len(rows))))
    rate = np.clip(rate, SLOWEST_RATE, 1.0)
    # The faster of the two steps at each row, as the path is straight between rows.
    step = np.abs(np.diff(rows, axis=0)) / T
    speed = np.maximum(np.vstack([step[:1], step]), np.vstack([step, step[-1:]]))
    with np.errstate(divide="ignore"):
        along = np.divide(a_max, speed, out=np.full_like(speed, np.inf), where=speed > ROUNDING)
        change = SHARE * np.min(along, axis=1)
    _passed(rate, change, T)
    return np.concatenate([[0.0], np.cumsum(2.0 * T / (rate[1:] + rate[:-1]))])


def at_cycles(values: Array, instants: Array, T: float) -> Array:
    """Values ``(M, …)`` interpolated from other instants to the cycles.

    Args:
        values: at the instants ``(N, …)``.
        instants: rising, the first is 0 ``(N,)`` [s].
        T: cycle [s].
    """
    return np.asarray(interpolated(T * np.arange(np.ceil(instants[-1] / T - ROUNDING) + 1), instants, values))


class _Trail:
    """Goes back over places: from ``q (n,)`` [rad] through those that an arm ``came`` through, the last one first."""

    def __init__(self, robot: Robot, q: Array, came: deque[Array]) -> None:
        self._robot, self._q, self._came, self._place = robot, q, came, robot.tool_places(q[None])[0]

    @property
    def ended(self) -> bool:
        """Whether the begin of the trail is reached."""
        return not self._came

    def further(self, way: float) -> Array:
        """Goes back by ``way`` [m]; returns the joint angles there ``(n,)`` [rad]. A turn by 1 rad counts as 0.1 m."""
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
