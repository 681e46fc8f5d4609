"""Executes a joint path from a file on an arm behind any interface: reading, planning, comparing, writing."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.execution.command_limits import require_within_limits
from ideal_robot.execution.guard import PATIENCE
from ideal_robot.execution.planned_path import read_path
from ideal_robot.execution.precorrect import path_at_cycles
from ideal_robot.feedforward.base import Feedforward, PassThrough
from ideal_robot.interfaces import LinkSettings, connected_arm, interface_of
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.metrics import PathErrors, path_errors
from scenes.online.live_arm import answers_within, response_of
from scenes.online.path_player import Felt, PathPlayer, PathRun
from scenes.online.processes import stopping_on_signals, undisturbed
from scenes.result import Progress, silent
from scenes.rsi.server import prepared
from sensing.force.sensors import open_force


@dataclass(frozen=True)
class PlaySettings:
    """Settings of a path's execution.

    Attributes:
        arm: address of the arm's interface.
        robot: shipped robot or URDF; None for the one that the path's file names.
        method: how the path is corrected while it is played; ``none`` sends the file's commands as they are.
        model: identified model that the method needs; None for the shipped one of the robot.
        cycle: interpolation cycle [s]; None for the interface's, or the robot's.
        rest: rest before the path [s].
        relative, rsi_config, controller: see ``scenes.online.devices.Devices``.
        bridge: how long packets may be lost in a row [s].
        patience: how long the controller is waited for [s].
        core: processor core to keep to; None for any.
        compare: whether the path is first executed without correction.
        force: address of a force sensor; None without one.
        force_delay: from the measurement to its arrival, at least [s].
        most_force: force that the path may meet [N]; 0 where it is to touch nothing.
    """

    arm: str
    robot: str | None = None
    method: str = "none"
    model: Path | None = None
    cycle: float | None = None
    rest: float = 0.6
    relative: bool = False
    rsi_config: Path | None = None
    controller: str | None = None
    bridge: float = 0.1
    patience: float = 60.0
    core: int | None = None
    compare: bool = False
    force: str | None = None
    force_delay: float = 0.0
    most_force: float = 0.0


@dataclass(frozen=True)
class PlannedPath:
    """A path, ready to be executed.

    Attributes:
        arm: with the cycle of the controller.
        law: corrects the path during its execution.
        desired: where the arm shall be at the cycles ``(N, n)`` [rad], rests included.
        commands: input of ``law`` ``(N, n)`` [rad]: the file's commands, or ``desired``.
        rest: rows of rest before the path.
        within: time in which the arm's loop answers a command [s]; None where it is not known.
        response: impulse response of the arm's loop ``(L, n)``; None where it is not known.
        meta: for the recording.
        warnings: warnings for the user before the execution.
    """

    arm: Robot
    law: Feedforward
    desired: Array = field(repr=False)
    commands: Array = field(repr=False)
    rest: int
    within: float | None
    response: Array | None = field(repr=False)
    meta: dict[str, Any]
    warnings: tuple[str, ...] = ()

    @property
    def corrected(self) -> bool:
        """Whether the commands differ from the desired path."""
        return not isinstance(self.law, PassThrough) or not np.array_equal(self.desired, self.commands)

    def plain(self) -> PlannedPath:
        """The path without any correction."""
        return replace(self, law=PassThrough(self.arm.t_ipo), commands=self.desired,
                       meta={**self.meta, "method": "none"})

    def player(self, link: Any, felt: Felt | None = None, patience: float = PATIENCE) -> PathPlayer:
        """The player that executes this path on a connected arm.

        Args:
            link: the arm, connected.
            felt: force sensor; None without one.
            patience: longest time to wait for an arm that stands still [s].
        """
        return PathPlayer(link, self.law, self.commands, self.rest, self.meta, self.warnings, recorded=self.desired,
                          led=True, response=self.response, felt=felt, patience=patience)


def planned_path(path: Path, settings: PlaySettings) -> PlannedPath:
    """Reads a path and checks it before anything is connected.

    With the method ``none`` commands ``q_c`` are sent where the file has them, else ``q_d``, else ``q``; errors are
    relative to ``q_d``, where the file has it. Any other method corrects ``q_d``, else ``q``, else ``q_c``.

    Args:
        path: CSV or Parquet with ``t`` and ``q_c_i``, ``q_d_i`` or ``q_i``, at any sampling.
        settings: settings of the execution.

    Raises:
        InputError: an argument cannot be used, or the path leaves the arm's limits.
    """
    interface, _ = interface_of(settings.arm)
    robot = settings.robot or (None if settings.model is not None else _named(path))
    cycle = settings.cycle if settings.cycle is not None else interface.cycle
    if interface.cycle is not None and round(1e6 * (cycle or 0.0)) % round(1e6 * interface.cycle):
        raise InputError(f"{interface.title} has a cycle of {1e3 * interface.cycle:g} ms; expected a multiple of it",
                         field="--cycle", value=cycle)
    arm, law, identified, model = prepared(robot=robot, model=settings.model, method=settings.method, cycle=cycle)
    response = None if identified is None else response_of(identified, arm)
    within = None if response is None else answers_within(response, arm.t_ipo)
    given = read_path(path, arm)
    t, column = given.t, given.column
    _, desired, warnings = path_at_cycles(t, given.q_d, arm, rest=settings.rest, file=str(path), column=column)
    commands, warnings = desired, (*given.warnings, *warnings)
    if isinstance(law, PassThrough) and column != "q_c" and given.commands is not None:
        _, commands, more = path_at_cycles(t, given.commands, arm, rest=settings.rest, file=str(path), column="q_c")
        warnings, column = (*warnings, *more), "q_c"
    require_within_limits(commands, arm, start=-settings.rest, file=path, column=column)
    meta = {"method": settings.method, "model": None if identified is None else str(model), "path": str(path),
            "interface": settings.arm}
    return PlannedPath(arm, law, desired, commands, round(settings.rest / arm.t_ipo), within, response, meta,
                       warnings)


def _named(path: Path) -> str:
    """The shipped robot that a path's file names; raises InputError where it names none."""
    name = None if path.suffix == ".json" else Recording.read(path).meta.get("robot")
    if name not in SHIPPED:
        raise InputError("give --robot: the path does not name a shipped one", file=path, field="--robot", value=name)
    return str(name)


@dataclass(frozen=True)
class PlayedPath:
    """The result of an executed path.

    Attributes:
        run: the run of the path.
        before: the path without correction, where it was run for comparison.
        arm: name of the arm whose errors these are.
    """

    run: PathRun
    before: PathRun | None
    arm: Robot

    @property
    def failure(self) -> str | None:
        """Why the path was not executed to its end, or None."""
        return self.run.failure if self.before is None else self.before.failure or self.run.failure

    def json(self) -> dict[str, Any]:
        """Key figures."""
        return {**self.run.json(), "flange_error": tool_errors(self.run, self.arm).json_mm(),
                **({} if self.before is None else {"before": {
                    **self.before.json(), "flange_error": tool_errors(self.before, self.arm).json_mm()}})}

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Errors joint by joint and of the tool, before and after where both were run."""
        runs = [run for run in (self.before, self.run) if run is not None]
        columns = ["error", *(["before", "after"] if len(runs) == 2 else ["rms"])]
        units = self.arm.units("mrad")
        errors = [run.errors_mrad() for run in runs]
        rows: list[list[Any]] = [[f"joint {j + 1} [{units[j]}]", *(float(error[j]) for error in errors)]
                                 for j in range(self.arm.n)]
        rows.append(["all joints", *(float(np.sqrt(np.mean(error**2))) for error in errors)])
        tool = [tool_errors(run, self.arm) for run in runs]
        rows.append(["tool, time-matched [mm]", *(1e3 * each.time_matched.E_car for each in tool)])
        rows.append(["tool, aligned [mm]", *(1e3 * each.aligned.E_car for each in tool)])
        return columns, rows


def tool_errors(run: PathRun, arm: Robot) -> PathErrors:
    """Errors of the tool by the motor angles, without the rest before the path."""
    data, rec = arm.pinocchio.createData(), run.recording

    def positions(q: Array) -> Array:
        points = np.empty((len(q), 3))
        for row, posture in enumerate(q):
            pin.framesForwardKinematics(arm.pinocchio, data, posture)
            points[row] = data.oMf[arm.tool_id].translation
        return points

    rows = slice(run.begun, None)
    x_d, x = (positions(rec.joints(name, rows)) for name in ("q_d", "q"))
    return path_errors(rec.t[rows], x_d, rec.t[rows], x)


def played_path(planned: PlannedPath, settings: PlaySettings, progress: Progress = silent) -> PlayedPath:
    """Executes a path: slowly to its start, along it, to rest; before that without correction, if set.

    Args:
        planned: the path.
        settings: settings of the execution.
        progress: called with the share done.

    Raises:
        InputError: a path that is not corrected and was to be compared.
        IdealRobotError: no controller connects, or the arm cannot be moved to the start.
    """
    if settings.compare and not planned.corrected:
        raise InputError("the path is sent as it is desired, there is nothing to compare; give a path that precorrect "
                         "wrote, or --method", field="--compare")
    link_settings = LinkSettings(settings.bridge, planned.within, settings.relative, settings.rsi_config,
                                 settings.controller)
    with ExitStack() as stack:
        felt = None
        if settings.force is not None:
            source = open_force(settings.force, settings.force_delay)
            stack.callback(source.close)
            felt = Felt(source, settings.most_force)
        granted = stack.enter_context(undisturbed(settings.core))
        link = stack.enter_context(connected_arm(settings.arm, planned.arm, link_settings, settings.patience))
        plans = [planned.plain(), planned] if settings.compare else [planned]
        players = [plan.player(link, felt, settings.patience) for plan in plans]

        def stop(reason: str) -> None:
            for player in players:
                player.stop(reason)

        with stopping_on_signals(stop):
            runs = list[PathRun]()
            for player in players:
                runs.append(player.played(granted, progress))
                if runs[-1].failure is not None:
                    break
    return PlayedPath(runs[-1], runs[0] if len(runs) == 2 else None, planned.arm)
