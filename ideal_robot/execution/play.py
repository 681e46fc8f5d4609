"""Executes a joint path on any arm behind the positional interface: corrected, recorded, within the limits."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.errors import IdealRobotError, InputError, LimitError, RaisedBy
from ideal_robot.execution.command_governor import CommandGovernor, stops_at_once
from ideal_robot.execution.command_limits import check_limits
from ideal_robot.execution.guard import SHARE
from ideal_robot.execution.path_stop import stopping_rows
from ideal_robot.feedforward.base import Feedforward, tried
from ideal_robot.progress import Progress, silent
from ideal_robot.results import Figure, Summarised, listed, one_unit, over_time, plain
from ideal_robot.robots.interface import RobotInterface, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from ideal_robot.tolerances import UNRESOLVED

_BRAKING_MIN = 0.15
"""Speed over deceleration that braking counts with at least [s]."""
_STANDING = 0.3
"""How long the arm is held after braking [s]."""
LONGEST_STOP = 5.0
"""Longest that braking takes, and coming to rest behind it or behind a path [s]."""


@dataclass(frozen=True, repr=False)
class PlayResult(Summarised):
    """The result of a path's execution, complete or up to a stop.

    Attributes:
        recording: ``t`` [s], ``q_d_i``, ``q_c_i`` handed over at ``t``, ``q_i`` and ``tau_i`` measured at ``t``; from
            the end of the first cycle on, since before nothing was measured.
        q_c: every command handed over ``(M, n)`` [rad].
        compute_times: computing time of the feedforward in each cycle of the path ``(M,)`` [s].
        state: the feedforward's last state.
        failure: why the path was not executed to its end, or None.
        error: the driver's exception, or None.
        units: of a thousandth of each joint's position, mrad or mm ``(n,)``; empty where no robot was given.
    """

    recording: Recording
    q_c: Array = field(repr=False)
    compute_times: Array = field(repr=False)
    state: Any = field(repr=False)
    failure: str | None = None
    error: IdealRobotError | None = field(default=None, repr=False)
    units: tuple[str, ...] = ()

    @property
    def rms_error(self) -> Array:
        """Root mean square of desired position minus motor angle per joint ``(n,)`` [rad]."""
        off = self.recording.joints("q_d") - self.recording.joints("q")
        return np.asarray(np.sqrt(np.mean(off**2, axis=0)))

    def summary(self) -> list[tuple[str, str]]:
        """Executed part of the path, and its errors, as rows of label and value."""
        unit = one_unit(self.units) or "mrad or mm"
        return [("play", f"{len(self.q_c)} cycles, {self.failure or 'played to its end'}"),
                ("rms of desired minus motor position", listed(1e3 * self.rms_error, unit)),
                ("median computing time", f"{1e3 * float(np.median(self.compute_times)):.3g} ms")]

    def plot(self) -> Figure:
        """Desired position minus motor angle, joint by joint."""
        off = 1e3 * (self.recording.joints("q_d") - self.recording.joints("q"))
        units = self.units or ("mrad or mm",) * off.shape[1]
        return over_time(self.recording.t, [(f"joint {j + 1} [{unit}]", [("desired minus motor", off[:, j])])
                                            for j, unit in enumerate(units)], "error of the motor positions")

    def to_dict(self) -> dict[str, Any]:
        """Key figures as plain values; keys with ``mrad`` use each joint's unit in ``units``."""
        return plain({
            "cycles": len(self.q_c), "failure": self.failure, "units": self.units,
            "motor_rms_error_mrad": 1e3 * self.rms_error,
            "compute_time_ms": {"median": 1e3 * float(np.median(self.compute_times)),
                                "max": 1e3 * float(np.max(self.compute_times))},
            "recording_hash": self.recording.hash})


def play(driver: RobotInterface, feedforward: Feedforward, q_d: Array, *, robot: Robot | None = None,
         meta: dict[str, Any] | None = None, progress: Progress = silent) -> PlayResult:
    """Executes a path from rest at its start, where the arm has to be.

    Where a command would leave a limit the arm is brought to rest on the path and the rest of it is given up. An error
    of the driver ends the execution; the recording until then is kept.

    Args:
        driver: the arm.
        feedforward: corrects the path, see ``ideal_robot.feedforward``.
        q_d: desired joint positions at the cycles ``(N, n)`` [rad, or m where a joint slides], rest before and behind
            included.
        robot: limits to keep; None where the driver keeps its own.
        meta: further metadata of the recording.
        progress: called with the share done.

    Raises:
        InputError: an unusable path, or a feedforward made for another cycle.
    """
    path = _checked(q_d, robot)
    tried(feedforward, path[0], driver.t_ipo)
    player = _Player(driver, PathCommands(feedforward, path, robot, driver.t_ipo))
    error, failure = None, None
    try:
        player.hand_over(map(player.commands.row, range(len(path))), progress)
        player.hand_over(player.commands.to_rest(path[-1]))
    except LimitError as limit:
        k = len(player.q_c)
        failure = f"stopped on the path at {k * driver.t_ipo:.3f} s: {limit}"
        error = player.brake(k) if robot is not None and k < len(path) else limit
    except IdealRobotError as raised:
        failure, error = str(raised), raised
    return player.result(meta or {}, failure, error)


class PathCommands:
    """Commands of a feedforward along a path, cycle by cycle, each with its desired position.

    The path may be passed more slowly than it was planned: places on it are fractional row numbers, and the rate is the
    number of rows per cycle.

    Args:
        feedforward: corrects the path; ``observe`` may update its state between two commands.
        path: desired joint positions at the cycles ``(N, n)`` [rad].
        robot: whose limits are kept; None where whoever takes the commands keeps them.
        T: cycle [s].
    """

    def __init__(self, feedforward: Feedforward, path: Array, robot: Robot | None, T: float) -> None:
        self.feedforward, self.robot, self._T, self.length = feedforward, robot, T, len(path)
        self._ahead = held(path, after=feedforward.n_d + 2)
        self.state = feedforward.init(path[0])
        self._last = np.tile(path[0], (2, 1))
        self._governor = None if robot is None else CommandGovernor(robot, path[0], t_ipo=T)

    def row(self, place: float, rate: float = 1.0) -> tuple[Array, Array]:
        """Desired position at a place of the path and its command, ``(n,)`` each [rad].

        Raises LimitError where that would leave a limit.
        """
        horizon = self._horizon(place, rate, self.feedforward.n_d)
        q_c, after = self._step(horizon)
        if self.robot is not None and self._governor is not None:
            check_limits(np.vstack([self._last, q_c]), self.robot, self._T, start=(place - 2) * self._T)
            self._governor.require_room(q_c, start=place * self._T)
            self._governor.passed(q_c)
        return self._handed_over(horizon[0], q_c, after)

    def rate_behind(self, place: float, rate: float, wanted: float) -> float:
        """The rate of the next cycle towards ``wanted``, within the joints' accelerations.

        Args:
            place, rate: of this cycle.
            wanted: rate that is to be reached.
        """
        if self.robot is None or rate == wanted:
            return wanted
        k = min(int(place), self.length - 1)
        speed = np.abs(self._ahead[k + 1] - self._ahead[k]) / self._T
        with np.errstate(divide="ignore"):
            most = self._T * SHARE * float(np.min(np.where(speed > 0.0, self.robot.a_max / speed, np.inf)))
        return float(np.clip(wanted, rate - most, rate + most))

    def brake(self, place: float, rate: float = 1.0) -> Iterator[tuple[Array, Array]]:
        """Yields cycles that brake to rest on the path, starting from a place not yet commanded."""
        if self.robot is None:
            return
        ahead = self._horizon(place, rate, 2)
        # Speed of the path, in units of the joints' braking acceleration.
        speed = float(np.max(np.abs(ahead[1] - ahead[0]) / self._T / self.robot.a_max))
        braking, n_d = max(speed, _BRAKING_MIN), self.feedforward.n_d
        cycles = int(np.ceil((min(1.5 * braking, LONGEST_STOP) + _STANDING) / self._T))
        planned = self._horizon(place, rate, cycles + n_d)
        for rows in islice(stopping_rows(planned, self._T, braking, 1.0), cycles):
            yield self.governed(rows[:n_d])
        yield from self.to_rest(rows[0])

    def _horizon(self, place: float, rate: float, count: int) -> Array:
        """The path at the coming cycles ``(count, n)`` [rad]; at its end where it is over."""
        last = len(self._ahead) - 1
        if rate == 1.0 and float(place).is_integer():
            rows = self._ahead[int(place) : int(place) + count]
            return rows if len(rows) == count else held(rows, after=count - len(rows))
        at = np.minimum(place + rate * np.arange(count), last - 2.0)
        k = at.astype(int)
        u = (at - k)[:, None]
        # Cubic of Catmull and Rom: through the rows, with slopes from their neighbours.
        before, here, there, behind = (self._ahead[np.clip(k + i, 0, last)] for i in (-1, 0, 1, 2))
        return np.asarray(here + 0.5 * u * (there - before + u * (
            2.0 * before - 5.0 * here + 4.0 * there - behind + u * (3.0 * (here - there) + behind - before))))

    def governed(self, horizon: Array) -> tuple[Array, Array]:
        """The command for a horizon ``(n_d, n)`` [rad], limited to the nearest one within the arm's limits."""
        q_c, after = self._step(horizon)
        return self._handed_over(horizon[0], q_c if self._governor is None else self._governor.allowed(q_c), after)

    def observe(self, measured: RobotState) -> None:
        """Passes the controller's report at the end of a cycle to the feedforward."""
        with RaisedBy(f"feedforward {type(self.feedforward).__name__}: observe"):
            self.state = self.feedforward.observe(self.state, measured)

    def _step(self, horizon: Array) -> tuple[Array, Any]:
        with RaisedBy(f"feedforward {type(self.feedforward).__name__}: step"):
            return self.feedforward.step(self.state, horizon)

    def _handed_over(self, q_d: Array, q_c: Array, after: Any) -> tuple[Array, Array]:
        self.state, self._last = after, np.vstack([self._last[1], q_c])
        return q_d, q_c

    def to_rest(self, q_d: Array) -> Iterator[tuple[Array, Array]]:
        """Yields cycles that bring commands from motion to rest at ``q_d (n,)`` [rad] within the limits."""
        if self.robot is None or stops_at_once(self._last[1] - self._last[0], self.robot, self._T):
            return
        for _ in range(int(np.ceil(LONGEST_STOP / self._T))):
            yield self.governed(np.tile(q_d, (self.feedforward.n_d, 1)))
            if np.all(np.abs(self._last[1] - self._last[0]) <= UNRESOLVED):
                return


class _Player:
    """What is known while a path is played."""

    def __init__(self, driver: RobotInterface, commands: PathCommands) -> None:
        self.driver, self.commands, self.robot = driver, commands, commands.robot
        self.q_d: list[Array] = []
        self.q_c: list[Array] = []
        self.measured: list[RobotState] = []
        self.times: list[float] = []

    def hand_over(self, rows: Iterator[tuple[Array, Array]], progress: Progress = silent) -> None:
        """Plays rows cycle by cycle; what the arm reports goes to the feedforward before its next command."""
        begun = time.perf_counter()
        for q_d, q_c in rows:
            seconds = time.perf_counter() - begun
            measured = self.driver.cycle(q_c)
            begun = time.perf_counter()
            for what, values in (("q", measured.q), ("tau", measured.tau)):
                if np.shape(values) != np.shape(q_c):
                    raise InputError(f"cycle of {type(self.driver).__name__} has to return a state with {what} of "
                                     f"shape {np.shape(q_c)}, NaN where it is not measured", field="driver",
                                     value=np.shape(values))
            if self.measured and not measured.t > self.measured[-1].t:
                raise InputError(f"cycle of {type(self.driver).__name__} has to return a state with a later t than the "
                                 "one before, the controller's time [s]; its clock stands still", field="driver",
                                 value=measured.t)
            self.commands.observe(measured)
            self.times.append(seconds + time.perf_counter() - begun)
            self.q_d.append(q_d)
            self.q_c.append(q_c)
            self.measured.append(measured)
            if len(self.q_c) % 50 == 1:
                progress(min(len(self.q_c) / self.commands.length, 1.0), "playing")
            begun = time.perf_counter()

    def brake(self, k: int) -> IdealRobotError | None:
        """Comes to rest on the path from row ``k`` on; returns what the driver raised meanwhile."""
        try:
            self.hand_over(self.commands.brake(k))
        except IdealRobotError as error:
            return error
        return None

    def result(self, meta: dict[str, Any], failure: str | None, error: IdealRobotError | None) -> PlayResult:
        """What was played; the state at the end of a cycle is the one at which the next command is handed over."""
        if not self.measured:
            raise InputError(f"the path was not executed: {failure}", field="q_d") from error
        n, T = len(self.q_c[0]), self.driver.t_ipo
        rows = slice(1, None) if len(self.q_c) > 1 else slice(0, None)
        count = len(self.q_c[rows])
        states = self.measured[:count]
        columns = {"q_d": np.array(self.q_d[rows]), "q_c": np.array(self.q_c[rows]),
                   "q": np.array([state.q for state in states]).reshape(-1, n)}
        tau = np.array([state.tau for state in states]).reshape(-1, n)
        if np.isfinite(tau).all():
            columns["tau"] = tau
        named, units = ({}, ()) if self.robot is None else ({"robot": self.robot.name}, self.robot.units("mrad"))
        recording = Recording.from_arrays(
            np.array([state.t for state in states]), source="play",
            meta={**named, "cycle_time": T, "source": "play",
                  "units": {"t": "s", "q_d": "rad", "q_c": "rad", "q": "rad", "tau": "N m"}, **meta}, **columns)
        return PlayResult(recording, np.array(self.q_c), np.array(self.times), self.commands.state, failure, error,
                          units)


def _checked(q_d: Array, robot: Robot | None) -> Array:
    path = np.array(q_d, dtype=float)
    if path.ndim != 2 or len(path) < 2 or (robot is not None and path.shape[1] != robot.n):
        raise InputError(f"expected desired positions (N, {'n' if robot is None else robot.n}) with N of 2 at least",
                         field="q_d", value=path.shape)
    if not np.isfinite(path).all():
        raise InputError("holds values that are not finite", field="q_d")
    return path
