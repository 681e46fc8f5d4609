"""Plays a joint path on an arm behind any maker's interface: slowly to its start, the path, to rest, all recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ideal_robot.arrays import Array, eased, held
from ideal_robot.errors import IdealRobotError, LimitError
from ideal_robot.execution.command_governor import CommandGovernor
from ideal_robot.execution.play import LONGEST_STOP, PathCommands
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.results import Summarised, shown_cell
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.interface import LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import RowLog
from ideal_robot.signals.recording import OF_JOINTS, Recording
from scenes.metrics import spread_ms
from scenes.online.live_arm import moves, near_start
from scenes.online.processes import undisturbed
from scenes.result import Progress, silent
from scenes.scene_files.scene import SceneError

NEAR = np.radians(0.5)
"""How far from the start of the path the arm may stand where it is not led there [rad]; the rest before the path takes
it."""
_SETTLING = 2.0
"""How long the arm is held at most behind the path until nothing that was missed is left to be made good [s]."""
_RESTS = 0.3
"""Rest at the start of the path, behind the way there [s]."""

Worked = TypeVar("Worked")


@dataclass(frozen=True, repr=False)
class PathRun(Summarised):
    """A path played on an arm.

    Attributes:
        recording: ``t`` [s] of the controller since it was connected, ``q_d_i``, ``q_c_i`` (handed over at ``t``),
            ``q_i`` and whatever else the controller reported at ``t``.
        failure: why it ended before the end of the path, or None.
        counts: what happened on the link.
        answer_times_ms: median, 99th percentile and maximum from reading a packet to its answer; NaN without any.
        precautions: what the system granted for even timing.
        begun: rows of rest before the path.
        rows: rows of the path, rests included.
        details: of the interface, for figures.
    """

    recording: Recording
    failure: str | None
    counts: dict[str, Any]
    answer_times_ms: dict[str, float]
    precautions: list[str]
    begun: int
    rows: int
    details: dict[str, Any] = field(default_factory=dict)

    def summary(self) -> list[tuple[str, str]]:
        """What came of the cycles."""
        _, rows = self.table()
        return [("path", f"{rows[0][1]} cycles answered{f', ended early: {self.failure}' if self.failure else ''}"),
                *((str(label), shown_cell(value)) for label, value in rows[1:])]

    def json(self) -> dict[str, Any]:
        """Key figures."""
        return {**self.recording.meta, "failure": self.failure, "cycles": len(self.recording.t),
                "path_cycles": self.rows, "link": self.counts, **self.details,
                "answer_time_ms": self.answer_times_ms, "timing": self.precautions,
                "motor_rms_error_mrad": None if len(self.recording.t) <= self.begun else self.errors_mrad()}

    def errors_mrad(self) -> Array:
        """Root mean square of desired position minus motor angle, rest before the path left out ``(n,)`` [mrad]."""
        off = (self.recording.joints("q_d") - self.recording.joints("q"))[self.begun :]
        return np.asarray(1e3 * np.sqrt(np.mean(off**2, axis=0)))

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """What a person wants first."""
        rows: list[list[Any]] = [["cycles answered", f"{len(self.recording.t)} of {self.rows}"],
                                 *([key.replace("_", " "), value] for key, value in self.counts.items()
                                   if key != "cycles" and isinstance(value, int)),
                                 ["answer after, median ms", self.answer_times_ms["median"]],
                                 ["answer after, worst ms", self.answer_times_ms["max"]]]
        if len(self.recording.t) > self.begun:
            rows.append(["motor error, worst joint mrad rms", float(np.max(self.errors_mrad()))])
        return ["figure", "value"], rows


class PathPlayer:
    """Plays one desired joint path through a feedforward to an arm behind a link.

    The command of the next cycle is computed while the controller is busy with this one, so that a packet is answered
    at once. Where a cycle is lost the path waits for it if the controller held the arm, and goes on if it did. Where a
    command would leave a limit the arm is brought to rest on the path and the rest of the path is given up.

    Args:
        link: the arm, not yet connected.
        feedforward: what corrects the path.
        q_d: desired positions at the interpolation cycle ``(N, n)`` [rad], rest before and behind the path included.
        rest: rows of rest before the path.
        meta: what the recording's metadata shall hold besides.
        warnings: what its user shall know of the path before it is played.
        recorded: what the recording shall have as desired where ``q_d`` are commands already ``(N, n)`` [rad].
        led: whether the arm is led to the start from wherever it stands; else it has to stand there.
    """

    source = "play"
    """What the recording's metadata name as its source."""

    def __init__(self, link: LinkedRobot, feedforward: Feedforward, q_d: Array, rest: int,
                 meta: dict[str, Any] | None = None, warnings: tuple[str, ...] = (), *,
                 recorded: Array | None = None, led: bool = False) -> None:
        self.link, self.feedforward, self.rest, self.led = link, feedforward, rest, led
        self.q_d, self.meta, self.warnings = np.array(q_d, dtype=float), meta or {}, warnings
        self._shift = np.zeros_like(self.q_d) if recorded is None else recorded - self.q_d
        self._reason: str | None = None

    def stop(self, reason: str) -> None:
        """Brings the arm to rest on the path from the next cycle on; to be called from anywhere."""
        self._reason = self._reason or reason

    def play(self, *, patience: float = 60.0, core: int | None = None, progress: Progress = silent) -> PathRun:
        """Waits for the controller up to ``patience`` [s], then plays the path; what happened is in the result.

        Args:
            patience: how long the controller is waited for [s].
            core: processor core to keep to; None for any.
            progress: called now and then with the share that is done.

        Raises:
            IdealRobotError: no controller came.
            SceneError: the arm does not stand at the start of the path, or cannot be led there. Nothing has moved then.
        """
        self._loaded()
        with undisturbed(core) as granted:
            self.link.connect(patience)
            return self.played(granted, progress)

    def played(self, granted: list[str], progress: Progress = silent) -> PathRun:
        """Plays the path on a link that is connected.

        Args:
            granted: what the system granted for even timing.
            progress: called now and then with the share that is done.

        Raises:
            SceneError: see ``play``.
        """
        self._loaded()
        # The first answer changes nothing and needs no computing.
        self.link.send(self.link.commanded)
        state = self.link.receive()
        names = {name: np.shape(value) for name, value in state.columns.items()}
        # Of each cycle time, desired and commanded position, measured position and torque, and what else is reported.
        log = RowLog(1 + 4 * self.link.robot.n + sum(int(np.prod(shape)) for shape in names.values()))
        log.reserve(len(self.q_d) + round((_SETTLING + 2.0 * LONGEST_STOP) / self.link.t_ipo))
        if self.led:
            state = self._lead(state, progress)
        q_d = self._from(self.link.commanded)
        try:
            self._answer(q_d, state, log, progress)
        except IdealRobotError as error:
            self._reason = self._reason or str(error)
            return self._run(log, names, granted, self._answered())
        # Another path may follow on the same link: until then the arm is held, which is counted no more.
        run = partial(self._run, log, names, granted, self._answered())
        return self._meanwhile(run) if self.led else run()

    def _loaded(self) -> None:
        """Compiled code is loaded before the first packet has to be answered."""
        self.feedforward.step(self.feedforward.init(self.q_d[0]), self.q_d[: self.feedforward.n_d])
        robot = self.link.robot
        anywhere = np.clip(robot.home, robot.q_min, robot.q_max)
        CommandGovernor(robot, anywhere, t_ipo=self.link.t_ipo).allowed(anywhere)

    def _lead(self, state: RobotState, progress: Progress) -> RobotState:
        """Leads the arm from where it is held to the start of the path; returns the last state.

        Raises SceneError where the way touches something, or the arm does not follow.
        """
        stands = self.link.commanded.copy()
        for k, q_c in enumerate(self._meanwhile(partial(_way, self.link.robot, stands, self.q_d[0]))):
            if self.link.fault is not None or self._reason is not None:
                raise SceneError(f"stopped on the way to the start: {self.link.fault or self._reason}")
            self.link.send(q_c)
            state = self.link.receive()
            if k % 50 == 0:
                progress(0.0, "to the start")
        for _ in range(round(_SETTLING / self.link.t_ipo)):
            if self.link.settled:
                break
            self.link.send(self.q_d[0])
            state = self.link.receive()
        return state

    def _meanwhile(self, work: Callable[[], Worked]) -> Worked:
        """What work that takes longer than a cycle gives; the arm, at rest, is held where it is until then."""
        rest = self.link.commanded.copy()
        with ThreadPoolExecutor(1) as beside:
            result = beside.submit(work)
            while not result.done():
                self.link.send(rest)
                self.link.receive()
        return result.result()

    def _answer(self, q_d: Array, state: RobotState, log: RowLog, progress: Progress) -> None:
        """Answers packet by packet; the command of the next cycle is computed while the controller is busy."""
        commands, k = self._commands(q_d), 0
        command = next(commands, None)
        while command is not None:
            self.link.ahead = self._ahead(q_d, k, command[1])
            self.link.send(command[1])
            k += 1
            more = [np.ravel(value) for value in state.columns.values()]
            log.append(np.concatenate([[state.t], *command, state.q, state.tau, *more]))
            if len(log) % 50 == 0:
                progress(min(len(log) / len(q_d), 1.0), "")
            if self.link.fault is not None:
                self.stop(f"stopped on the path at {state.t:.3f} s: {self.link.fault}")
            if (command := next(commands, None)) is not None:
                state = self.link.receive()
            for _ in range(self.link.gone_on):
                # The controller went on meanwhile, and so does the path.
                if command is not None and (later := next(commands, None)) is not None:
                    self.link.skip(command[1])
                    command, k = later, k + 1

    def _ahead(self, q_d: Array, k: int, q_c: Array) -> Array | None:
        """Commands expected behind that of cycle ``k``: they go on as the path does; None while the arm is braked."""
        if not self.link.horizon or self._reason is not None or k >= len(q_d):
            return None
        return np.asarray(held(q_d[k : k + 1 + self.link.horizon], after=self.link.horizon)[1 : 1 + self.link.horizon]
                          - q_d[k] + q_c)

    def _from(self, stands: Array) -> Array:
        """The path from where the arm is held: the offset to its start fades within the rest before it."""
        offset = near_start(stands, self.q_d[0], NEAR)
        share = np.clip(np.arange(len(self.q_d)) / max(self.rest - 1, 1), 0.0, 1.0)[:, None]
        return np.asarray(self.q_d + offset * (1.0 - eased(share)))

    def _commands(self, q_d: Array) -> Iterator[tuple[Array, Array]]:
        """Desired position and command of every cycle; braking from where a limit or ``stop`` ends the path."""
        T, commands = self.link.t_ipo, PathCommands(self.feedforward, q_d, self.link.robot, self.link.t_ipo)
        for k in range(len(q_d)):
            try:
                row = commands.row(k) if self._reason is None else None
            except LimitError as error:
                row = None
                self.stop(f"stopped on the path at {k * T:.3f} s: {error}")
            shift = self._shift[k]
            if row is None:
                yield from ((desired + shift, q_c) for desired, q_c in commands.brake(k))
                return
            yield row[0] + shift, row[1]
        yield from ((desired + shift, q_c) for desired, q_c in commands.to_rest(q_d[-1]))
        for _ in range(round(_SETTLING / T)):
            if self.link.settled or self._reason is not None:
                return
            desired, q_c = commands.governed(np.tile(q_d[-1], (self.feedforward.n_d, 1)))
            yield desired + shift, q_c

    def _answered(self) -> tuple[dict[str, Any], dict[str, float]]:
        """What happened on the link until now, and how long answers took [ms]."""
        return asdict(self.link.counts), spread_ms(np.array(self.link.answer_times))

    def _run(self, log: RowLog, names: dict[str, tuple[int, ...]], granted: list[str],
             answered: tuple[dict[str, Any], dict[str, float]]) -> PathRun:
        return PathRun(self._recording(log, names), self._reason, *answered, granted, self.rest, len(self.q_d))

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


def _way(robot: Robot, stands: Array, start: Array) -> Array:
    """Slow commands ``(N, n)`` from where an arm is held to the start of a path ``(n,)`` [rad].

    Raises SceneError where the arm would touch itself or its base plane on the way, though it does not where it stands.
    """
    shapes = Shapes(robot)
    if shapes.first_touch(stands[None]) is None and (touch := shapes.touch_between(stands, start)) is not None:
        raise SceneError(f"on the joints' straight way from where the arm stands to the start of the path {touch}; "
                         "move the arm nearer to the start")
    return moves(robot, [stands, start], _RESTS)
