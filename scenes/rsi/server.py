"""The ideal robot as a KUKA RSI server: a joint path in, one corrected command for every packet out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array, eased
from ideal_robot.errors import IdealRobotError, InputError, LimitError
from ideal_robot.execution.command_governor import CommandGovernor, require_within_limits
from ideal_robot.execution.play import LONGEST_STOP, PathCommands
from ideal_robot.execution.precorrect import path_at_cycles
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.corrected_arm import ForCorrectedArm
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward
from ideal_robot.feedforward.registry import method as described
from ideal_robot.feedforward.registry import methods as known
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.results import Summarised, shown_cell
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import RowLog
from ideal_robot.rsi import RsiRobot
from ideal_robot.signals.recording import Recording
from scenes.arms import shipped_model
from scenes.metrics import spread_ms
from scenes.online.live_arm import answers_within, at_cycle, near_start
from scenes.online.processes import undisturbed
from scenes.path.precorrect import columns_of, robot_of
from scenes.result import Progress, silent


@dataclass(frozen=True, repr=False)
class RsiRun(Summarised):
    """A path played over RSI.

    Attributes:
        recording: ``t`` [s] since the first packet, which is answered by no correction, ``q_d_i``, ``q_c_i`` (handed
            over at ``t``), ``q_i`` and, where the controller sends currents, ``current_i`` and ``tau_i``.
        failure: why it ended before the end of the path, or None.
        counts: what happened on the link.
        stamps: how the controller's time stamps rise.
        answer_times_ms: median, 99th percentile and maximum from reading a packet to its answer; NaN without any.
        precautions: what the system granted for even timing.
        begun: rows of rest before the path.
        rows: rows of the path, rests included.
    """

    recording: Recording
    failure: str | None
    counts: dict[str, Any]
    stamps: str
    answer_times_ms: dict[str, float]
    precautions: list[str]
    begun: int
    rows: int

    def summary(self) -> list[tuple[str, str]]:
        """What came of the cycles."""
        _, rows = self.table()
        return [("path", f"{rows[0][1]} cycles answered{f', ended early: {self.failure}' if self.failure else ''}"),
                *((str(label), shown_cell(value)) for label, value in rows[1:])]

    def json(self) -> dict[str, Any]:
        """Key figures."""
        return {**self.recording.meta, "failure": self.failure, "cycles": len(self.recording.t),
                "path_cycles": self.rows, "link": self.counts, "time_stamps": self.stamps,
                "answer_time_ms": self.answer_times_ms, "timing": self.precautions,
                "motor_rms_error_mrad": None if len(self.recording.t) <= self.begun else self.errors_mrad()}

    def errors_mrad(self) -> Array:
        """Root mean square of desired position minus motor angle, rest before the path left out ``(n,)`` [mrad]."""
        off = (self.recording.joints("q_d") - self.recording.joints("q"))[self.begun :]
        return np.asarray(1e3 * np.sqrt(np.mean(off**2, axis=0)))

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """What a person wants first."""
        link = self.counts
        rows: list[list[Any]] = [["cycles answered", f"{len(self.recording.t)} of {self.rows}"],
                                 ["time stamps", self.stamps],
                                 ["packets lost", link["lost"]], ["repeated", link["repeated"]],
                                 ["refused", link["refused"]], ["optional elements ignored", link["ignored"]],
                                 ["answers late by the controller's count", link["late"]],
                                 ["answer after, median ms", self.answer_times_ms["median"]],
                                 ["answer after, worst ms", self.answer_times_ms["max"]]]
        if len(self.recording.t) > self.begun:
            rows.append(["motor error, worst joint mrad rms", float(np.max(self.errors_mrad()))])
        return ["figure", "value"], rows


START_TOLERANCE = np.radians(0.5)
"""How far from the start of the path the arm may stand [rad]; the rest before the path takes it there."""
_SETTLING = 2.0
"""How long the arm is held at most behind the path until nothing that was missed is left to be made good [s]."""


class RsiServer:
    """Plays one desired joint path through a feedforward to the controller behind a ``RsiRobot``.

    The command of the next cycle is computed while the controller is busy with this one, so that a packet is answered
    at once. A lost packet delays the path by a cycle; nothing is skipped. Where a command would leave a limit the arm
    is brought to rest on the path and the rest of the path is given up.

    Args:
        link: the arm behind RSI, not yet connected.
        feedforward: what corrects the path.
        q_d: desired positions at the interpolation cycle ``(N, n)`` [rad], rest before and behind the path included.
        rest: rows of rest before the path.
        meta: what the recording's metadata shall hold besides.
        warnings: what its user shall know of the path before it is played.
    """

    def __init__(self, link: RsiRobot, feedforward: Feedforward, q_d: Array, rest: int,
                 meta: dict[str, Any] | None = None, warnings: tuple[str, ...] = ()) -> None:
        self.link, self.feedforward, self.rest = link, feedforward, rest
        self.q_d, self.meta, self.warnings = np.array(q_d, dtype=float), meta or {}, warnings
        self._reason: str | None = None

    def stop(self, reason: str) -> None:
        """Brings the arm to rest on the path from the next cycle on; to be called from anywhere."""
        self._reason = self._reason or reason

    def play(self, *, patience: float = 60.0, core: int | None = None, progress: Progress = silent) -> RsiRun:
        """Waits for the controller up to ``patience`` [s], then plays the path; what happened is in the result.

        Args:
            patience: how long the controller is waited for [s].
            core: processor core to keep to; None for any.
            progress: called now and then with the share that is done.

        Raises:
            RsiError: no controller came.
            SceneError: the arm does not stand at the start of the path. Nothing has moved then.
        """
        # Compiled code is loaded before the first packet has to be answered.
        self.feedforward.step(self.feedforward.init(self.q_d[0]), self.q_d[: self.feedforward.n_d])
        robot = self.link.robot
        anywhere = np.clip(robot.home, robot.q_min, robot.q_max)
        CommandGovernor(robot, anywhere, t_ipo=self.link.t_ipo).allowed(anywhere)
        # Of each cycle time, desired and commanded position, measured position and torque.
        log = RowLog(1 + 4 * robot.n)
        log.reserve(len(self.q_d) + round((_SETTLING + 2.0 * LONGEST_STOP) / self.link.t_ipo))
        with undisturbed(core) as granted:
            self.link.connect(patience)
            q_d = self._from(self.link.commanded)
            try:
                self._answer(q_d, log, progress)
            except IdealRobotError as error:
                self._reason = self._reason or str(error)
        return self._run(log, granted)

    def _answer(self, q_d: Array, log: RowLog, progress: Progress) -> None:
        """Answers packet by packet; the command of the next cycle is computed while the controller is busy."""
        commands = self._commands(q_d)
        # The first answer changes nothing and needs no computing.
        self.link.send(self.link.commanded)
        command = next(commands, None)
        state = self.link.receive()
        while command is not None:
            self.link.send(command[1])
            log.append(np.concatenate([[state.t], *command, state.q, state.tau]))
            if len(log) % 50 == 0:
                progress(min(len(log) / len(q_d), 1.0), "")
            if self.link.fault is not None:
                self.stop(f"stopped on the path at {state.t:.3f} s: {self.link.fault}")
            if (command := next(commands, None)) is not None:
                state = self.link.receive()

    def _from(self, held: Array) -> Array:
        """The path from where the arm is held: the offset to its start fades within the rest before it."""
        offset = near_start(held, self.q_d[0], START_TOLERANCE)
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
            if row is None:
                yield from commands.brake(k)
                return
            yield row
        yield from commands.to_rest(q_d[-1])
        for _ in range(round(_SETTLING / T)):
            if self.link.settled or self._reason is not None:
                return
            yield commands.governed(np.tile(q_d[-1], (self.feedforward.n_d, 1)))

    def _run(self, log: RowLog, granted: list[str]) -> RsiRun:
        robot, counts = self.link.robot, asdict(self.link.counts)
        meta = {"robot": robot.name, "cycle_time": robot.t_ipo, "source": "rsi",
                "units": {"t": "s", "q_d": "rad", "q_c": "rad", "q": "rad", "tau": "N m", "current": "A"},
                "corrections": "relative" if self.link.relative else "absolute", **self.meta}
        t, q_d, q_c, q, tau = np.split(log.mapped(), 1 + robot.n * np.arange(4), axis=1)
        columns = {"q_d": q_d, "q_c": q_c, "q": q}
        if np.isfinite(tau).all():
            columns |= {"current": tau / robot.drive_gain, "tau": tau}
        recording = Recording.from_arrays(t[:, 0], meta=meta, source="rsi", **columns)
        return RsiRun(recording, self._reason, counts, self.link.stamps.described(),
                      spread_ms(np.array(self.link.answer_times)), granted, self.rest, len(self.q_d))


# From what the command line gives to an RSI server: path, robot, model and feedforward that fit each other.

_TRIED = 20.0
"""How much of the path is tried on the identified loop [s]."""


def methods() -> tuple[str, ...]:
    """Methods that a server can play: those that need no more than a model, for nothing is rehearsed."""
    return known(Needs.MODEL)


@contextmanager
def rsi_server(path: Path, *, robot: str | None = None, model: Path | None = None, method: str = "ideal",
               cycle: float | None = None, delay: bool = False, rest: float = 0.6, **link_options: Any
               ) -> Iterator[RsiServer]:
    """A server that listens, and stops listening at the end of the block.

    Args:
        path: CSV or Parquet with ``t`` and ``q_d_i`` or ``q_i``.
        robot: shipped robot or URDF; None for the one the model names.
        model: identified model; None for the shipped one of the robot. Not needed for ``none``.
        method: one of ``methods()``.
        cycle: interpolation cycle in place of the robot's [s]; the identified loop is brought to it.
        delay: whether the planner's delay of one cycle is in force.
        rest: rest before the path [s].
        link_options: see ``RsiRobot``.

    Raises:
        InputError: anything of this cannot be used, or the path leaves the robot's limits.
    """
    if not 0.0 <= rest <= 60.0:
        raise InputError("expected 0 to 60 seconds", field="--rest", value=rest)
    arm, law, loop, file = prepared(robot=robot, model=model, method=method, cycle=cycle, delay=delay)
    t, q_d, column = columns_of(path, arm)
    _, q_d, warnings = path_at_cycles(t, q_d, arm, rest=rest, file=str(path), column=column)
    require_within_limits(q_d, arm, start=-rest, file=path)
    if loop is not None:
        link_options.setdefault("answers_within", answers_within(loop, arm))
        if cycle is not None:
            _require_better(law, loop, q_d, file)
    meta = {"method": method, "model": None if loop is None else str(file), "path": str(path)}
    with RsiRobot(arm, **link_options) as link:
        yield RsiServer(link, law, q_d, round(rest / arm.t_ipo), meta, warnings)


def prepared(*, robot: str | None = None, model: Path | None = None, method: str = "ideal",
             cycle: float | None = None, delay: bool = False) -> tuple[Robot, Feedforward, LoopModel | None, Path]:
    """Arm, feedforward and identified loop at one cycle, and the file of the model.

    Args:
        robot: shipped robot or URDF; None for the one the model names.
        model: identified model; None for the shipped one of the robot.
        method: one of ``methods()``.
        cycle: interpolation cycle in place of the robot's [s].
        delay: whether the planner's delay of one cycle is in force.

    Raises:
        InputError: anything of this cannot be used.
    """
    if method not in methods():
        raise InputError(f"expected one of {', '.join(methods())}", field="--method", value=method)
    arm, file = _arm(robot, model, method)
    if cycle is not None:
        arm = at_cycle(arm, cycle)
    identified = None if described(method).needs == Needs.NOTHING else Model.load(file)
    law = feedforward(method, identified, arm, delay=int(delay))
    return arm, law, None if identified is None else loop_model(identified, arm, delay=int(delay)), file


def _require_better(law: Feedforward, loop: LoopModel, q_d: Array, file: Path) -> None:
    """Refuses another cycle than the robot's where on the identified loop the correction makes the path worse."""
    part = q_d[: round(_TRIED / law.t_ipo)]
    wanted = law.arm.from_rest(part, law.t_ipo) if isinstance(law, ForCorrectedArm) else part
    errors = [float(np.sqrt(np.mean((wanted - simulate(loop, q_c).q_a[:-1]) ** 2))) for q_c in (law.along(part), part)]
    if not errors[0] <= errors[1] + 1e-6:
        raise InputError("at this cycle the identified loop cannot be inverted; identify the arm at it, or use "
                         "--method none", file=file, field="--cycle", value=law.t_ipo)


def _arm(robot: str | None, model: Path | None, method: str) -> tuple[Robot, Path]:
    """The robot and the file of the model for it."""
    if robot is None:
        if model is None:
            raise InputError("give --robot, or a model that names it", field="--robot")
        return robot_of(Model.load(model), None, model), model
    arm = Robot.load(robot)
    file = model or shipped_model(arm.name)
    if described(method).needs > Needs.NOTHING and not file.is_file():
        raise InputError("no such model file" if model else
                         f"no model is shipped for {arm.name}; identify one and give its path, or use --method none",
                         field="--model", value=str(model or arm.name))
    return arm, file
