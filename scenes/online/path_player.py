"""Executes a joint path on an arm behind any maker's interface: slowly to its start, along it, to rest, recorded.

The guard of ``ideal_robot.execution.guard`` checks every cycle: whether the arm follows its commands, the force of a
connected sensor, the state of the link. When the arm stands still, the path waits and continues from where it is; any
other finding brings the arm to rest, and back until there is no contact.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ideal_robot.arrays import Array, eased, held, interpolated
from ideal_robot.errors import IdealRobotError, LimitError
from ideal_robot.execution.command_governor import CommandGovernor
from ideal_robot.execution.following import Following
from ideal_robot.execution.guard import PATIENCE, Guard
from ideal_robot.execution.play import LONGEST_STOP, PathCommands
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.registry import in_words
from ideal_robot.results import Summarised, shown_cell
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.interface import LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import RowLog
from ideal_robot.signals.recording import OF_JOINTS, Recording
from scenes.metrics import spread_ms
from scenes.online.felt_force import FeltForce
from scenes.online.live_arm import moves, near_start
from scenes.online.live_sensors import LiveForce
from scenes.online.processes import undisturbed
from scenes.result import Progress, silent
from scenes.scene_files.scene import SceneError
from sensing.clock_relation import ClockRelation
from sensing.force.sensors import WrenchSource

NEAR = np.radians(0.5)
"""How far from the start of the path the arm may stand where it is not led there [rad]; the rest before the path takes
it."""
_SETTLING = 2.0
"""How long the arm is held at most behind the path until nothing that was missed is left to be made good [s]."""
_READ = 3.0
"""How long a force sensor may take until it has shown what it feels at rest [s]."""
_RESTS = 0.3
"""Rest at the start of the path, behind the way there [s]."""

Worked = TypeVar("Worked")


@dataclass(frozen=True, repr=False)
class PathRun(Summarised):
    """The result of a path executed on an arm.

    Attributes:
        recording: ``t`` [s] of the controller since it was connected, ``q_d_i``, ``q_c_i`` (handed over at ``t``),
            ``q_i`` and whatever else the controller reported at ``t``.
        failure: why it ended before the end of the path, or None.
        counts: statistics of the link.
        answer_times_ms: median, 99th percentile and maximum from reading a packet to its answer; NaN without any.
        precautions: privileges for even timing that the system granted.
        begun: rows of rest before the path.
        rows: rows of the path, rests included.
        answered: rows of the recording that were answered in time.
        details: of the interface, for figures.
    """

    recording: Recording
    failure: str | None
    counts: dict[str, Any]
    answer_times_ms: dict[str, float]
    precautions: list[str]
    begun: int
    rows: int
    answered: int
    details: dict[str, Any] = field(default_factory=dict)

    def summary(self) -> list[tuple[str, str]]:
        """Rows of label and value: cycles answered, packets lost or late, and how well the arm followed."""
        _, rows = self.table()
        return [("path", f"{rows[0][1]} cycles answered{f', ended early: {self.failure}' if self.failure else ''}"),
                *((str(label), shown_cell(value)) for label, value in rows[1:])]

    def json(self) -> dict[str, Any]:
        """Key figures for JSON."""
        return {**self.recording.meta, "failure": self.failure, "cycles": self.answered,
                "path_cycles": self.rows, "link": self.counts, **self.details,
                "answer_time_ms": self.answer_times_ms, "timing": self.precautions,
                "motor_rms_error_mrad": None if len(self.recording.t) <= self.begun else self.errors_mrad()}

    def errors_mrad(self) -> Array:
        """Root mean square of desired position minus motor angle, without the rest before the path ``(n,)`` [mrad]."""
        off = (self.recording.joints("q_d") - self.recording.joints("q"))[self.begun :]
        return np.asarray(1e3 * np.sqrt(np.mean(off**2, axis=0)))

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """The main figures as a table: titles and rows."""
        rows: list[list[Any]] = [["cycles answered", f"{self.answered} of {self.rows}"],
                                 *([in_words(key), value] for key, value in self.counts.items()
                                   if key != "cycles" and isinstance(value, int)),
                                 ["answer after, median ms", self.answer_times_ms["median"]],
                                 ["answer after, worst ms", self.answer_times_ms["max"]]]
        if len(self.recording.t) > self.begun:
            rows.append(["motor error, worst joint mrad rms", float(np.max(self.errors_mrad()))])
        if (slowest := self.details.get("guard", {}).get("least_speed", 1.0)) < 1.0:
            rows.append(["least override, %", 100.0 * slowest])
        rows += [["note", text] for text in self.details.get("notes", ())]
        return ["figure", "value"], rows


@dataclass(frozen=True)
class _Cycle:
    """What is desired, commanded and expected to be commanded next ``(n,)``, ``(n,)``, ``(m, n)`` [rad]."""

    q_d: Array
    q_c: Array
    ahead: Array | None = None


@dataclass(frozen=True)
class Felt:
    """A connected force sensor that is watched during a path.

    Attributes:
        source: its readings.
        most: force that the path may meet [N]; 0 where it is to touch nothing.
    """

    source: WrenchSource
    most: float = 0.0


class _Shared:
    """The player's clock as the force sensor sees it: the controller's time since the path began, cycle by cycle."""

    def __init__(self, t_ipo: float) -> None:
        self.clock, self.at_begin, self.zero, self.t_ipo = ClockRelation(), list[Callable[[], None]](), 0.0, t_ipo

    def play_time(self, host: float) -> float:
        """Time of the controller that belongs to this computer's time ``host`` [s]."""
        return self.clock.stamp(host) - self.zero


class PathPlayer:
    """Executes one desired joint path through a feedforward on an arm behind a link.

    The command of the next cycle is computed while the controller is busy with this one, so that a packet is answered
    at once; a feedforward that observes computes it between packet and answer. In a lost cycle the path waits if the
    controller stopped the arm, and continues if the arm continued. Where a command would leave a limit the arm is
    brought to rest on the path and the rest of the path is given up. Where the controller's override is below 100 % the
    path is passed more slowly by that factor.

    Args:
        link: the arm, not yet connected.
        feedforward: corrects the path.
        q_d: desired positions at the interpolation cycle ``(N, n)`` [rad], rest before and behind the path included.
        rest: rows of rest before the path.
        meta: further metadata of the recording.
        warnings: warnings for the user before the path is executed.
        recorded: desired positions for the recording where ``q_d`` already are commands ``(N, n)`` [rad].
        led: whether the arm is moved to the start from any place; otherwise it has to rest there.
        response: impulse response of the arm's loop ``(L, n)``; None where none was identified.
        felt: force sensor; None without one.
        patience: longest time to wait for an arm that stands still [s].

    Attributes:
        guard: looks at every cycle.
    """

    source = "play"
    """What the recording's metadata name as its source."""

    def __init__(self, link: LinkedRobot, feedforward: Feedforward, q_d: Array, rest: int,
                 meta: dict[str, Any] | None = None, warnings: tuple[str, ...] = (), *,
                 recorded: Array | None = None, led: bool = False, response: Array | None = None,
                 felt: Felt | None = None, patience: float = PATIENCE) -> None:
        self.link, self.feedforward, self.rest, self.led = link, feedforward, rest, led
        self.q_d, self.meta, self.warnings = np.array(q_d, dtype=float), meta or {}, warnings
        self._shift = np.zeros_like(self.q_d) if recorded is None else recorded - self.q_d
        self.guard, self._response, self._felt = Guard(link.robot, self.q_d[0]), response, felt
        self.guard.patience = patience
        self._time = _Shared(link.t_ipo)
        self._force: FeltForce | None = None
        self._state: RobotState | None = None
        self._commands: PathCommands | None = None
        self._in_force = _InForce(link)
        self._slowest = 1.0
        self._waited, self._answers, self._where = 0, 0, "stopped on the way to the start"

    @property
    def _reason(self) -> str | None:
        return self.guard.reason

    def stop(self, reason: str) -> None:
        """Brings the arm to rest on the path from the next cycle on; may be called from any thread."""
        self.guard.stop(reason)

    def play(self, *, patience: float = 60.0, core: int | None = None, progress: Progress = silent) -> PathRun:
        """Waits for the controller up to ``patience`` [s], then executes the path; returns what happened.

        Args:
            patience: how long the controller is waited for [s].
            core: processor core to keep to; None for any.
            progress: called now and then with the share that is done.

        Raises:
            IdealRobotError: no controller came.
            SceneError: the arm does not stand at the start of the path, or cannot be moved there. The arm has not moved
                then.
        """
        self.guard.patience = patience
        self._loaded()
        with undisturbed(core) as granted:
            self.link.connect(patience)
            return self.played(granted, progress)

    def played(self, granted: list[str], progress: Progress = silent) -> PathRun:
        """Executes the path on a connected link.

        Args:
            granted: privileges for even timing that the system granted.
            progress: called now and then with the share that is done.

        Raises:
            SceneError: see ``play``.
        """
        self._loaded()
        # The first answer repeats the command, which needs no computing.
        self.guard.begin(self.link.commanded)
        self.link.send(self.link.commanded)
        self._state = state = self.link.receive()
        self._time.zero = state.t
        self._time.clock.add(state.t, self.link.arrived)
        names = {name: np.shape(value) for name, value in state.columns.items()}
        # Per cycle: time, desired and commanded position, measured position and torque, and further reports.
        log = RowLog(1 + 4 * self.link.robot.n + sum(int(np.prod(shape)) for shape in names.values()))
        log.reserve(len(self.q_d) + round((_SETTLING + 2.0 * LONGEST_STOP) / self.link.t_ipo))
        with self._watched():
            if self.led:
                self._lead(progress)
            q_d, self._where = self._from(self.link.commanded), "stopped on the path"
            try:
                self._answer(q_d, log, progress)
            except IdealRobotError as error:
                self.stop(str(error))
                return self._run(log, names, granted, self._answered())
            # Another path may follow on the same link: until then the arm is commanded to rest, which is not recorded.
            run = partial(self._run, log, names, granted, self._answered())
            return self._meanwhile(run) if self.led else run()

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """The guard's watches look within the block; before it the force sensor shows what it feels at rest."""
        link = self.link
        with ExitStack() as stack:
            if self._felt is not None:
                force = LiveForce(self._felt.source, self._time)
                stack.callback(force.close)
                self._force = FeltForce(force, link.robot, None, 0.0, meets=self._felt.most)
                self.guard.watches.append(self._force)
                for _ in range(round(_READ / link.t_ipo)):
                    if self._force.zeroed or self._reason is not None:
                        break
                    self._cycle(link.commanded)
                if self._reason is not None or not self._force.zeroed:
                    raise SceneError(self._reason or f"no sound reading of the force sensor for {_READ:.0f} s: "
                                     f"{force.why_silent()}")
            self.guard.watches.append(Following(lambda: self._in_force.commanded, link.robot, self._response,
                                                sure=False, tolerance=link.tolerance, cause=link.cause,
                                                paused=lambda: link.paused is not None))
            yield

    def _cycle(self, q_c: Array, ahead: Array | None = None) -> RobotState:
        """One cycle with a command ``(n,)`` [rad], which the guard looks at; returns its state."""
        self.link.ahead = ahead
        self.link.send(q_c)
        return self._received(q_c)

    def _received(self, q_c: Array) -> RobotState:
        """The next state, looked at by the guard; cycles unheard of lie evenly between two states."""
        last, state = self._state, self.link.receive()
        self._state = state
        self._time.clock.add(state.t, self.link.arrived)
        before = self._reason
        if self.link.fault is not None:
            self.stop(self.link.fault)
        steps = 1 if last is None else max(round((state.t - last.t) / self.link.t_ipo), 1)
        heard = (*(() if last is None else (last,)), *self.link.unanswered, state)
        for i in range(1, steps + 1):
            share = i / steps
            self._in_force.between(share)
            t, q = state.t, state.q
            if last is not None and i < steps:
                t = last.t + share * (state.t - last.t)
                q = interpolated(np.array([t]), np.array([one.t for one in heard]), np.array([one.q for one in heard])
                                 )[0]
            self.guard.look(t - self._time.zero, q_c, q)
        self._in_force.taken()
        if self.link.paused is not None:
            self.guard.held = self.guard.held or self.link.paused
        if before is None and self._reason is not None:
            self.guard.reason = f"{self._where} at {state.t:.3f} s: {self._reason}"
        return state

    def _loaded(self) -> None:
        """Compiled code is loaded before the first packet has to be answered."""
        self.feedforward.step(self.feedforward.init(self.q_d[0]), self.q_d[: self.feedforward.n_d])
        robot = self.link.robot
        anywhere = np.clip(robot.home, robot.q_min, robot.q_max)
        CommandGovernor(robot, anywhere, t_ipo=self.link.t_ipo).allowed(anywhere)
        Following(lambda: anywhere, robot, self._response, sure=False)

    def _lead(self, progress: Progress) -> None:
        """Leads the arm from where it is held to the start of the path.

        Raises SceneError where the way touches something, or the arm does not follow.
        """
        stands = self.link.commanded.copy()
        way = self._meanwhile(partial(_way, self.link.robot, stands, self.q_d[0]))
        for k, q_c in enumerate(self.guard.along(self._meanwhile(partial(self.guard.timed, way)))):
            self._cycle(q_c)
            if k % 50 == 0:
                progress(0.0, self.guard.held or "to the start")
        for _ in range(round(_SETTLING / self.link.t_ipo)):
            if self.link.settled or self._reason is not None:
                break
            self._cycle(self.q_d[0])
        if self._reason is not None:
            for q_c in self.guard.leaving():
                self._cycle(q_c)
            raise SceneError(str(self._reason))

    def _meanwhile(self, work: Callable[[], Worked]) -> Worked:
        """The result of work that takes longer than a cycle; the arm is held at rest meanwhile."""
        rest = self.link.commanded.copy()
        with ThreadPoolExecutor(1) as beside:
            result = beside.submit(work)
            while not result.done():
                self._cycle(rest)
        return result.result()

    def _answer(self, q_d: Array, log: RowLog, progress: Progress) -> None:
        """Answers packet by packet; the command of the next cycle is computed while the controller is busy, if it can.

        Args:
            q_d: the path from where the arm is held ``(N, n)`` [rad].
            log: what is recorded.
            progress: called now and then with the share that is done.
        """
        cycles = self._cycles(q_d)
        coming = next(cycles, None)
        while coming is not None:
            state, now = self._state, coming
            assert state is not None
            self.link.ahead = now.ahead
            self.link.send(now.q_c)
            self.guard.hand_over(now.q_c)
            log.append(_row(state, now))
            self._answers += 1
            if len(log) % 50 == 0:
                progress(min(len(log) / len(q_d), 1.0), self.guard.held or "")
            observes = self.feedforward.observes
            if not observes and (coming := next(cycles, None)) is None:
                return
            before, state = state, self._received(now.q_c)
            if observes:
                # Measurements change the next command, which is therefore computed between packet and answer.
                assert self._commands is not None
                self._commands.observe(state)
                coming = next(cycles, None)
            passed = list[_Cycle]()
            for _ in range(self.link.gone_on):
                # The controller continued meanwhile, and so does the path.
                if coming is not None and (later := next(cycles, None)) is not None:
                    self.link.skip(coming.q_c)
                    passed.append(coming)
                    coming = later
            for older in self.link.unanswered:
                # States that came too late for an answer are valid measurements.
                i = round((older.t - before.t) / self.link.t_ipo) - 1
                log.append(_row(older, passed[i] if i < len(passed) else now))

    def _ahead(self, q_d: Array, k: int, q_c: Array) -> Array | None:
        """Commands expected behind that of row ``k``: they go on as the path does; None where they are not known."""
        if not self.link.horizon:
            return None
        return np.asarray(held(q_d[k : k + 1 + self.link.horizon], after=self.link.horizon)[1 : 1 + self.link.horizon]
                          - q_d[k] + q_c)

    def _from(self, stands: Array) -> Array:
        """The path from where the arm is held: the offset to its start fades within the rest before it."""
        offset = near_start(stands, self.q_d[0], NEAR)
        share = np.clip(np.arange(len(self.q_d)) / max(self.rest - 1, 1), 0.0, 1.0)[:, None]
        return np.asarray(self.q_d + offset * (1.0 - eased(share)))

    def _cycles(self, q_d: Array) -> Iterator[_Cycle]:
        """Every cycle of the path; to rest, and back until nothing is felt, where a limit or ``stop`` ends it."""
        rows, shift = q_d, self._shift
        while True:
            commands = self._commands = PathCommands(self.feedforward, rows, self.link.robot, self.link.t_ipo)
            held_at = yield from self._leg(commands, rows, shift)
            if held_at is None:
                return
            for q_c in self.guard.waiting():
                self._waited += 1
                yield _Cycle(q_c, q_c)
            if self._reason is not None:
                return
            rows, shift = self.guard.resumed(rows, held_at, shift)

    def _leg(self, commands: PathCommands, rows: Array, shift: Array) -> Generator[_Cycle, None, int | None]:
        """Cycles of a path to its end, returns None; or until the arm is held, returns the row in which it is."""
        T, last = self.link.t_ipo, len(rows) - 1
        place, rate = 0.0, 1.0
        while True:
            k = int(place)
            if self.guard.held is not None and self._reason is None:
                return k
            beside = shift[k] + (place - k) * (shift[min(k + 1, last)] - shift[k])
            try:
                row = commands.row(place, rate) if self._reason is None else None
            except LimitError as error:
                row = None
                self.stop(f"stopped on the path at {place * T:.3f} s: {error}")
            if row is None:
                yield from self._stopped(commands, place, beside, rate)
                return None
            yield _Cycle(row[0] + beside, row[1], self._ahead(rows, k, row[1]))
            if place >= last:
                break
            rate = commands.rate_behind(place, rate, float(np.clip(self.link.speed, 0.0, 1.0)))
            self._slowest = min(self._slowest, rate)
            place = min(place + rate, float(last))
        yield from (_Cycle(desired + shift[-1], q_c) for desired, q_c in commands.to_rest(rows[-1]))
        for _ in range(round(_SETTLING / T)):
            if self.link.settled or self._reason is not None:
                break
            desired, q_c = commands.governed(np.tile(rows[-1], (self.feedforward.n_d, 1)))
            yield _Cycle(desired + shift[-1], q_c)
        # The effects of the path's last cycles are only measured now.
        if self._reason is not None:
            yield from (_Cycle(q_c, q_c) for q_c in self.guard.leaving())
        return None if self._reason is not None or self.guard.held is None else len(rows) - 1

    def _stopped(self, commands: PathCommands, place: float, shift: Array, rate: float) -> Iterator[_Cycle]:
        """To rest on the path from a place on, or to where the arm stands; then back until nothing is felt."""
        if self.guard.astray:
            yield from (_Cycle(q_c, q_c) for q_c in self.guard.leaving())
            return
        yield from (_Cycle(desired + shift, q_c) for desired, q_c in commands.brake(place, rate))
        yield from (_Cycle(q_c, q_c) for q_c in self.guard.back())

    def _answered(self) -> tuple[dict[str, Any], dict[str, float]]:
        """What happened on the link until now, and how long answers took [ms]."""
        return asdict(self.link.counts), spread_ms(np.array(self.link.answer_times))

    def _run(self, log: RowLog, names: dict[str, tuple[int, ...]], granted: list[str],
             answered: tuple[dict[str, Any], dict[str, float]]) -> PathRun:
        guarded: dict[str, Any] = {"acceleration_share": self._in_force.largest,
                                   "waited_s": self._waited * self.link.t_ipo, "least_speed": self._slowest}
        if self._force is not None:
            guarded["largest_force_N"] = self._force.largest
        return PathRun(self._recording(log, names), self._reason, *answered, granted, self.rest, len(self.q_d),
                       self._answers, details={"guard": guarded, "notes": list(self.link.notes)})

    def _recording(self, log: RowLog, names: dict[str, tuple[int, ...]]) -> Recording:
        robot = self.link.robot
        meta = {"robot": robot.name, "cycle_time": robot.t_ipo, "source": self.source,
                "units": {"t": "s", "q_d": "rad", "q_c": "rad", "q": "rad", "tau": "N m", "current": "A"},
                "clock": "controller", **self.link.meta, **self.meta}
        values = log.mapped()
        t, q_d, q_c, q, tau = np.split(values[:, : 1 + 4 * robot.n], 1 + robot.n * np.arange(4), axis=1)
        columns = {"q_d": q_d, "q_c": q_c, "q": q}
        if np.isfinite(tau).all():
            columns["tau"] = tau
        first = 1 + 4 * robot.n
        for name, shape in names.items():
            last = first + int(np.prod(shape))
            column = values[:, first:last] if shape else values[:, first]
            finite = np.isfinite(column)
            if finite.all() if name in OF_JOINTS else finite.any():
                columns[name] = column
            first = last
        return Recording.from_arrays(t[:, 0], meta=meta, source=self.source, **columns)


def _row(state: RobotState, now: _Cycle) -> Array:
    """What is recorded of a cycle: the state, and what was desired and commanded at its time."""
    return np.concatenate([[state.t], now.q_d, now.q_c, state.q, state.tau,
                           *[np.ravel(value) for value in state.columns.values()]])


class _InForce:
    """The commands in force at the controller, and what accelerations they make.

    Args:
        link: whose ``commanded`` they are.

    Attributes:
        commanded: in the cycle that is looked at ``(n,)`` [rad].
        largest: acceleration so far, as a share of the arm's limit, the worst joint's.
    """

    def __init__(self, link: LinkedRobot) -> None:
        self._link, self.largest = link, 0.0
        self._last: deque[Array] = deque(maxlen=3)
        self._before: Array | None = None
        self.commanded = np.full(link.robot.n, np.nan)

    def between(self, share: float) -> None:
        """The cycle so far on the way [0 to 1] from the state before to the last one."""
        now = self._link.commanded
        self.commanded = now.copy() if self._before is None else self._before + share * (now - self._before)
        self._last.append(self.commanded)
        if len(self._last) == 3:
            bend = np.abs(self._last[2] - 2.0 * self._last[1] + self._last[0]) / self._link.t_ipo**2
            self.largest = max(self.largest, float(np.max(bend / self._link.robot.a_max)))

    def taken(self) -> None:
        """The last state was looked at."""
        self._before = self._link.commanded.copy()


def _way(robot: Robot, stands: Array, start: Array) -> Array:
    """Slow commands ``(N, n)`` from where an arm is held to the start of a path ``(n,)`` [rad].

    Raises SceneError where the arm would touch itself or its base plane on the way, though it does not where it stands.
    """
    shapes = Shapes(robot)
    if shapes.first_touch(stands[None]) is None and (touch := shapes.touch_between(stands, start)) is not None:
        raise SceneError(f"on the joints' straight way from where the arm stands to the start of the path {touch}; "
                         "move the arm nearer to the start")
    return moves(robot, [stands, start], _RESTS)
