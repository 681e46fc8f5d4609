"""From what the command line gives to an RSI server: path, robot, model and feedforward that fit each other."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.passthrough import PassThrough
from ideal_robot.feedforward.precorrection import Precorrection
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.signals.recording import Recording
from scenes.models import shipped_model
from scenes.path.precorrect import check_limits, desired_path, robot_of
from scenes.rsi.server import RsiServer

METHODS = ("ideal", "precorrected", "none")


@contextmanager
def rsi_server(path: Path, *, robot: str | None = None, model: Path | None = None, method: str = "ideal",
               host: str = "127.0.0.1", port: int = 49152, relative: bool = False, cycle: float | None = None,
               delay: bool = False, rest: float = 0.6) -> Iterator[RsiServer]:
    """A server that listens, and stops listening at the end of the block.

    Args:
        path: CSV or Parquet with ``t`` and ``q_d_i`` or ``q_i``.
        robot: shipped robot or URDF; None for the one the model names.
        model: identified model; None for the shipped one of the robot. Not needed for ``none``.
        method: one of ``METHODS``.
        host, port, relative: see ``RsiRobot``.
        cycle: interpolation cycle in place of the robot's [s].
        delay: whether the planner's delay of one cycle is in force.
        rest: rest before the path [s].

    Raises:
        InputError: anything of this cannot be used, or the path leaves the robot's limits.
    """
    if method not in METHODS:
        raise InputError(f"expected one of {', '.join(METHODS)}", field="--method", value=method)
    if not 0.0 <= rest <= 60.0:
        raise InputError("expected 0 to 60 seconds", field="--rest", value=rest)
    if cycle is not None and not (1e-3 <= cycle <= 0.1 and math.isclose(1e3 * cycle, round(1e3 * cycle))):
        raise InputError("expected whole milliseconds from 0.001 to 0.1 s", field="--cycle", value=cycle)
    arm, file = _arm(robot, model, method)
    if cycle is not None:
        arm = replace(arm, t_ipo=cycle)
    _, q_d = desired_path(Recording.read(path), arm, path, rest)
    check_limits(q_d, arm, arm.t_ipo, file=path, start=-rest)
    law = _feedforward(method, arm, file, int(delay))
    meta = {"method": method, "model": None if method == "none" else str(file), "path": str(path)}
    with RsiRobot(arm, host=host, port=port, relative=relative) as link:
        yield RsiServer(link, law, q_d, round(rest / arm.t_ipo), meta)


def _arm(robot: str | None, model: Path | None, method: str) -> tuple[Robot, Path]:
    """The robot and the file of the model for it."""
    if robot is None:
        if model is None:
            raise InputError("give --robot, or a model that names it", field="--robot")
        return robot_of(Model.load(model), None, model), model
    arm = Robot.load(robot)
    file = model or shipped_model(arm.name)
    if method != "none" and not file.is_file():
        raise InputError("no such model file" if model else
                         f"no model is shipped for {arm.name}; identify one and give its path, or use --method none",
                         field="--model", value=str(model or arm.name))
    return arm, file


def _feedforward(method: str, arm: Robot, file: Path, delay: int) -> Feedforward:
    if method == "none":
        return PassThrough(arm.t_ipo)
    model = Model.load(file)
    if method == "precorrected":
        return Precorrection.complete(model, arm, delay=delay)
    return IdealRobot.of(model, arm, delay=delay)
