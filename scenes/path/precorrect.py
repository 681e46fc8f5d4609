"""Corrects a joint path from a file, for the command line: the page and the table about it."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.execution.planned_path import read_path
from ideal_robot.execution.precorrect import PrecorrectedPath, precorrect
from ideal_robot.model.cascade import given_controller
from ideal_robot.model.model import Model
from ideal_robot.results import one_unit
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.robot import Robot
from scenes.report.page import Report
from sim.arm.arm import SimulatedArm
from sim.arm.world import World


def precorrected_path(path: Path, model_file: Path, *, robot: str | None = None, method: str = "ideal",
                      delay: bool = False, rest: float = 0.6, controller: str | None = None, slow: bool = False
                      ) -> PrecorrectedPath:
    """Reads a joint path, corrects it and checks the result against the robot's limits.

    Args:
        path: see ``ideal_robot.execution.planned_path.read_path``.
        model_file: identified model.
        robot: shipped robot or URDF; None for the one the model names.
        method: see ``ideal_robot.execution.precorrect.precorrect``.
        delay: whether the planner's delay of one cycle is in force.
        rest: rest before the path [s].
        controller: in the place of the model's, see ``ideal_robot.model.cascade.given_controller``; None for the
            model's.
        slow: see ``ideal_robot.execution.precorrect.precorrect``.

    Raises:
        InputError: unreadable or unsuitable input.
        LimitError: the corrected path leaves the limits.
    """
    model = Model.load(model_file)
    arm = robot_of(model, robot, model_file)
    if controller is not None:
        model = replace(model, controller=given_controller(controller, model.dynamics, arm), command=None)
    planned = read_path(path, arm)
    result = precorrect(planned.t, planned.q_d, model, arm, method, delay=int(delay), rest=rest, slow=slow,
                        file=path, column=planned.column)
    meta = {**result.recording.meta, "model": str(model_file)}
    return replace(result, recording=replace(result.recording, meta=meta),
                   warnings=(*planned.warnings, *result.warnings))


def robot_of(model: Model, wanted: str | None, file: Path) -> Robot:
    """The robot of that name or file; by default the shipped one that the model names.

    Args:
        model: identified model.
        wanted: shipped robot or URDF; None for the one the model names.
        file: the model's, for messages.
    """
    name = wanted or model.arm.name
    if wanted is None and name not in SHIPPED:
        raise InputError(f"the model is of {name!r}, which is not shipped; give its URDF with --robot", file=file,
                         field="robot", value=name)
    return Robot.load(name)


def played(result: PrecorrectedPath, arm: Robot, seed: int, *, delay: bool = False) -> tuple[Array, Array]:
    """Arm angles of the simulated arm on the corrected path, and on the uncorrected one.

    Args:
        result: the corrected path.
        arm: as its data sheet has it; the world's differs.
        seed: of the world's noise.
        delay: whether the planner's delay of one cycle is in force.

    Returns:
        Error of the arm angles, corrected and uncorrected ``(N, n)`` each [rad].
    """
    world = World.default(arm).replace(correction_delay=delay)
    errors = []
    for commands in (result.q_c, result.q_d):
        with SimulatedArm(arm, world, np.random.default_rng(seed), result.q_d[0]) as simulated:
            reached = []
            for q_c in commands:
                reached.append(simulated.q_a.copy())
                simulated.cycle(q_c)
        errors.append(np.asarray(result.q_d - np.array(reached)))
    return errors[0], errors[1]


def table(result: PrecorrectedPath, measured: tuple[Array, Array] | None = None) -> tuple[list[str], list[list[Any]]]:
    """One row per joint; ``measured``: errors with the corrected path and without, ``(N, n)`` each [rad]."""
    largest = np.max(np.abs(result.q_c - result.q_d), axis=0)
    after, before = result.expected_rms
    unit = one_unit(result.units)
    columns = ["joint", f"largest correction {unit}", f"expected error before {unit}", f"after {unit}"]
    values = [largest, before, after]
    if result.reach is not None:
        columns += ["by the controller's spread from", f"to {unit}"]
        values += [result.reach.min(axis=0), result.reach.max(axis=0)]
    if measured is not None:
        columns += [f"played: error before {unit}", f"after {unit}"]
        values += [np.sqrt(np.mean(error**2, axis=0)) for error in measured[::-1]]
    return columns, [[i + 1, *(1e3 * float(value[i]) for value in values)] for i in range(result.q_d.shape[1])]


def next_step(corrected: str | Path) -> tuple[str, str]:
    """The next step with a corrected path: a sentence and its command.

    Args:
        corrected: its file.
    """
    return ("Play the corrected path on an arm behind its maker's interface.",
            f"ideal-robot play {shlex.quote(str(corrected))} --arm ADDRESS")


def write_page(result: PrecorrectedPath, path: Path, measured: tuple[Array, Array] | None = None,
               corrected: str | Path = "CORRECTED.csv") -> Path:
    """Writes the page of a corrected path; returns its file.

    Args:
        result: the corrected path.
        path: of the page.
        measured: errors with the corrected path and without, where it was run ``(N, n)`` each [rad].
        corrected: file of the corrected path, for the command of the next step.
    """
    after, before = (1e3 * float(np.max(rms)) for rms in result.expected_rms)
    unit = one_unit(result.units)
    report = Report(f"Corrected path for {result.robot_name}",
                    f"Expected from the identified model: {after:.3f} {unit} root mean square "
                    f"on the worst joint with the corrected path, {before:.2f} {unit} without."
                    + ("" if result.reach is None else " The controller was not identified: within its spread the "
                       f"corrected path leaves up to {1e3 * float(result.reach.max()):.2f} {unit}."))
    report.next(next_step(corrected))
    report.table(*table(result, measured))
    figure = Figure(figsize=(9.0, 4.0))
    axes = figure.add_subplot()
    for i in range(result.q_d.shape[1]):
        axes.plot(result.t, 1e3 * (result.q_c[:, i] - result.q_d[:, i]), lw=1, label=f"joint {i + 1}")
    axes.set(xlabel="time [s]", ylabel=f"correction [{unit}]")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=9, frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    report.figure(figure, "Command minus desired position.")
    return report.write(path)
