"""The ideal robot as a KUKA RSI server: from a joint path to one corrected command for every packet."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.execution.command_limits import require_within_limits
from ideal_robot.execution.planned_path import read_path
from ideal_robot.execution.precorrect import path_at_cycles
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.corrected_arm import ForCorrectedArm
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward, require, settings
from ideal_robot.feedforward.registry import method as described
from ideal_robot.feedforward.registry import methods as known
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop import Loop
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.rsi.corrections import require_led
from scenes.arms import shipped_model
from scenes.methods import ADAPTED
from scenes.online.live_arm import answers_within, at_cycle, response_of
from scenes.online.path_player import PathPlayer, PathRun
from scenes.path.precorrect import robot_of
from scenes.result import Progress, silent


@dataclass(frozen=True, repr=False)
class RsiRun(PathRun):
    """The result of a path executed over RSI.

    Attributes:
        stamps: how the controller's time stamps rise.
    """

    stamps: str = ""

    def json(self) -> dict[str, Any]:
        """Key figures."""
        return {**super().json(), "time_stamps": self.stamps}

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """The main figures as a table: titles and rows."""
        link = self.counts
        rows: list[list[Any]] = [["cycles answered", f"{self.answered} of {self.rows}"],
                                 ["time stamps", self.stamps],
                                 ["packets lost", link["lost"]], ["repeated", link["repeated"]],
                                 ["refused", link["refused"]], ["optional elements ignored", link["ignored"]],
                                 ["answers late by the controller's count", link["late"]],
                                 ["answer after, median ms", self.answer_times_ms["median"]],
                                 ["answer after, worst ms", self.answer_times_ms["max"]]]
        if len(self.recording.t) > self.begun:
            rows.append(["motor error, worst joint mrad rms", float(np.max(self.errors_mrad()))])
        return ["figure", "value"], rows


class RsiServer(PathPlayer):
    """Executes one desired joint path through a feedforward on the controller behind an ``RsiRobot``.

    The arm has to stand at the start of the path. See ``PathPlayer`` for the arguments.
    """

    source = "rsi"
    link: RsiRobot

    def play(self, *, patience: float = 60.0, core: int | None = None, progress: Progress = silent) -> RsiRun:
        """Waits for the controller, then executes the path, see ``PathPlayer.play``.

        Args:
            patience: how long the controller is waited for [s].
            core: processor core to keep to; None for any.
            progress: called now and then with the share that is done.
        """
        run = super().play(patience=patience, core=core, progress=progress)
        return RsiRun(**vars(run), stamps=self.link.stamps.described())


# Checks that path, robot, model and feedforward of an RSI server fit each other.

_TRIED = 20.0
"""How much of the path is tried on the identified loop [s]."""


def methods() -> tuple[str, ...]:
    """Methods that a server can use: those that need at most a model, and those that learn during the run.

    There are no runs beforehand.
    """
    return (*known(Needs.MODEL), ADAPTED, *settings(Needs.MODEL))


@contextmanager
def rsi_server(path: Path, *, robot: str | None = None, model: Path | None = None, method: str = "ideal",
               cycle: float | None = None, delay: bool = False, rest: float = 0.6, **link_options: Any
               ) -> Iterator[RsiServer]:
    """A server that listens within the block.

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
        InputError: an argument cannot be used, or the path leaves the robot's limits.
    """
    if not 0.0 <= rest <= 60.0:
        raise InputError("expected 0 to 60 seconds", field="--rest", value=rest)
    arm, law, identified, file = prepared(robot=robot, model=model, method=method, cycle=cycle, delay=delay)
    given = read_path(path, arm)
    _, q_d, warnings = path_at_cycles(given.t, given.q_d, arm, rest=rest, file=str(path), column=given.column)
    warnings = (*given.warnings, *warnings)
    require_within_limits(q_d, arm, start=-rest, file=path)
    form = link_options.get("form")
    if form is not None and form.pose:
        require_led(q_d, arm, relative=link_options.get("relative", False), file=str(path))
    response = None
    if identified is not None:
        response = response_of(identified, arm, int(delay))
        link_options.setdefault("answers_within", answers_within(response, arm.t_ipo))
        if cycle is not None and not identified.by_law:
            _require_better(law, loop_model(identified, arm, delay=int(delay)), q_d, file)
    meta = {"method": method, "model": None if identified is None else str(file), "path": str(path)}
    with RsiRobot(arm, **link_options) as link:
        yield RsiServer(link, law, q_d, round(rest / arm.t_ipo), meta, warnings,
                        response=response)


def prepared(*, robot: str | None = None, model: Path | None = None, method: str = "ideal",
             cycle: float | None = None, delay: bool = False) -> tuple[Robot, Feedforward, Model | None, Path]:
    """Arm with its cycle, feedforward, model where the method needs or the user gives one, and its file.

    Args:
        robot: shipped robot or URDF; None for the one the model names.
        model: identified model; None for the shipped one of the robot.
        method: one of ``methods()``.
        cycle: interpolation cycle in place of the robot's [s].
        delay: whether the planner's delay of one cycle is in force.

    Raises:
        InputError: anything of this cannot be used.
    """
    require(method, methods(), "--method")
    arm, file = _arm(robot, model, method)
    if cycle is not None:
        arm = at_cycle(arm, cycle)
    # An uncorrected path, too, is monitored better with the arm's identified loop.
    identified = None if described(method).needs == Needs.NOTHING and model is None else Model.load(file)
    if identified is not None and described(method).needs == Needs.NOTHING:
        identified.require_arm(arm, file=file)
        if identified.controller is None and identified.command is None:
            identified = None
    law = feedforward(method, identified, arm, delay=int(delay))
    return arm, law, identified, file


def _require_better(law: Feedforward, loop: Loop, q_d: Array, file: Path) -> None:
    """Refuses another cycle than the robot's where on the identified loop the correction makes the path worse."""
    part = q_d[: round(_TRIED / law.t_ipo)]
    wanted = law.arm.from_rest(part, law.t_ipo) if isinstance(law, ForCorrectedArm) else part
    errors = [float(np.sqrt(np.mean((wanted - simulate(loop, q_c).q_a[:-1]) ** 2))) for q_c in (law.along(part), part)]
    if not errors[0] <= errors[1] + 1e-6:
        raise InputError("the identified loop cannot be inverted at this cycle; identify the arm at it, or use "
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
