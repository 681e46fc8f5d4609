"""Identification motions: planned, written, and run on the simulated arm."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.identification.excitation import (
    FourierMotion,
    Workspace,
    approach,
    clear_of_obstacles,
    design_excitation,
)
from ideal_robot.identification.program import Program, finite_limits, plan_two_step, require_within_limits
from ideal_robot.results import Summarised
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import write_text
from sim.arm.arm import SimulatedArm
from sim.arm.world import World

_TRIES = 40
"""How often a motion is looked for: to an arm of five joints, one of a dozen can be driven from its home posture."""
_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Of slow reversals at the end of a motion that are tried where they leave the workspace."""


@dataclass(frozen=True, repr=False)
class Plan(Summarised):
    """A planned identification motion.

    Attributes:
        method: ``joint`` or ``two-step``.
        commands: ``(N, n)`` [rad], every ``t_ipo``, from the robot's home posture.
        t_ipo: interpolation cycle [s].
        source: the Fourier motion or the program.
    """

    method: str
    commands: Array
    t_ipo: float
    source: FourierMotion | Program

    def summary(self) -> list[tuple[str, str]]:
        """Method and length of the motion as rows of label and value."""
        samples, joints = self.commands.shape
        return [("method", f"{self.method!r}, {joints} joints"), ("duration", f"{samples * self.t_ipo:.1f} s")]

    def json(self) -> dict[str, Any]:
        """The plan's figures, and the program of the two-step method."""
        content: dict[str, Any] = {"method": self.method, "cycle_s": self.t_ipo, "samples": len(self.commands),
                                   "duration_s": len(self.commands) * self.t_ipo}
        if isinstance(self.source, Program):
            return {**content, "operating_points": len(self.source.points), "moves": len(self.source.moves),
                    "program": self.source.to_dict()}
        return {**content, "condition_number": self.source.condition_number, "period_s": self.source.period,
                "centre": self.source.centre, "a": self.source.a, "b": self.source.b}

    def write(self, folder: Path) -> list[Path]:
        """Writes commands and program; returns the files."""
        table = io.StringIO()
        rows = np.column_stack([np.arange(1, len(self.commands) + 1) * self.t_ipo, self.commands])
        names = ["t", *(f"q_c_{i + 1}" for i in range(self.commands.shape[1]))]
        np.savetxt(table, rows, fmt="%.9g", delimiter=",", header=",".join(names), comments="")
        files = [write_text(folder / "commands.csv", table.getvalue())]
        if isinstance(self.source, Program):
            files += [write_text(folder / "program.json", json.dumps(self.source.to_dict(), indent=1) + "\n"),
                      write_text(folder / "program.txt", self.source.text())]
        return files


def plan(robot: Robot, method: str, *, seed: int = 1, period: float = 20.0, points: int = 10,
         workspace: Workspace | None = None) -> Plan:
    """Plans a motion from the robot's home posture; InputError where limits, workspace and cell permit none.

    Args:
        robot: the arm.
        method: ``joint`` (a Fourier motion) or ``two-step`` ([G] 3.1.2).
        seed: of the search for a motion.
        period: of the Fourier motion [s].
        points: operating points of the two-step program.
        workspace: where the arm may move; in proportion to its reach if None.
    """
    if method not in ("joint", "two-step"):
        raise InputError("expected joint or two-step", field="method", value=method)
    rng, workspace = np.random.default_rng(seed), workspace or Workspace.of(robot)
    room = workspace.on_the_way(robot)
    failure: InputError | None = None
    # With large motions most random ones hit the floor, and the path to one may lead through obstacles.
    for _ in range(_TRIES):
        try:
            motion = _one(robot, method, rng, period, points, workspace)
            require_within_limits(robot, motion.commands, room)
            return motion
        except InputError as error:
            failure = error
    assert failure is not None
    raise failure


def _one(robot: Robot, method: str, rng: np.random.Generator, period: float, points: int, workspace: Workspace) -> Plan:
    if method == "two-step":
        program = plan_two_step(robot, rng, points=points, workspace=workspace)
        return Plan(method, program.commands(robot.home, robot.t_ipo, robot), robot.t_ipo, program)
    motion = design_excitation(robot, rng, period=period, workspace=workspace)
    return Plan(method, fourier_commands(robot, motion, robot.home, robot.t_ipo, workspace.on_the_way(robot)),
                robot.t_ipo, motion)


def fourier_commands(robot: Robot, motion: FourierMotion, start: Array, t_ipo: float,
                     workspace: Workspace | None = None) -> Array:
    """Commands ``(N, n)`` [rad] from rest through one period of the motion and slow reversals about its end.

    Args:
        robot, motion: the arm, with its limits, and its motion.
        start: joint angles at rest ``(n,)`` [rad].
        t_ipo: cycle of the commands [s].
        workspace: region in which the reversals stay; the amplitude is reduced where they would not. Unlimited if None.
    """
    v_max, a_max = finite_limits(robot)
    t = np.asarray(np.arange(1, round(motion.period / t_ipo) + 1) * t_ipo, dtype=float)
    q = motion.at(t)[0]
    first = motion.at(np.zeros(1))[0][0]
    hold = np.repeat(first[None], round(0.3 / t_ipo), axis=0)
    return np.concatenate([approach(start, first, t_ipo, v_max, a_max), hold, q, hold,
                           _slow_reversals(q[-1], robot, t_ipo, workspace)])


def _slow_reversals(q0: Array, robot: Robot, t_ipo: float, workspace: Workspace | None) -> Array:
    """Eight seconds of all joints about ``q0`` at up to eight per cent of their speed: what paths of tools look like.

    A joint that has not the room for it moves less, and all of them where they would leave the workspace.
    """
    duration = 8.0
    t = np.arange(1, round(duration / t_ipo) + 1) * t_ipo
    w = 2.0 * np.pi / duration * np.array([2.0, 3.0, 5.0, 7.0, 4.0, 6.0])[np.arange(len(q0)) % 6]
    envelope = np.sin(np.pi * t / duration)[:, None] ** 2
    swing = envelope * (0.08 * finite_limits(robot)[0] / w) * np.sin(np.outer(t, w))
    room = np.maximum(np.minimum(robot.q_max - q0, q0 - robot.q_min), 1e-9)
    swing = swing / np.maximum(np.abs(swing).max(axis=0) / room, 1.0)
    for share in _SHARES:
        if workspace is None or clear_of_obstacles(robot, q0 + share * swing, workspace).all():
            return np.asarray(q0 + share * swing)
    return np.asarray(q0 + swing)


def play_plan(planned: Plan, robot: Robot, seed: int, progress: Callable[[float], None] = lambda share: None,
              world: World | None = None) -> Recording:
    """Runs a plan on the simulated arm and returns what the controller logged.

    Args:
        planned: the motion.
        robot, world: the arm by its data sheet, and its simulated world; the default one if None.
        seed: of the world's noise.
        progress: called with the share done.
    """
    world = World.default(robot) if world is None else world
    with SimulatedArm(robot, world, np.random.default_rng(seed), robot.home) as arm:
        for k, q_c in enumerate(planned.commands):
            arm.cycle(q_c)
            if k % 100 == 0:
                progress(k / len(planned.commands))
        return arm.recording(external=True)
