"""An arm behind joint controllers of many kinds: what the command's law leaves of a path, with and without torques."""

from __future__ import annotations

import dataclasses

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.feedforward.command_inverse import CommandInverse
from ideal_robot.identification.angles_alone import identify_from_commands
from ideal_robot.identification.command import identify_command
from ideal_robot.identification.idim import identify
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from studies.controlled_arms import KINDS, USUAL, Plant, motion
from studies.report import head, row

REST = 1.0
"""Rest before a path [s]."""


def controllers(robot: str = "kr6", seed: int = 1, cycle: float = 0.004, kind: str = "") -> None:
    """Errors of a path behind each kind of controller: plain, corrected with and without torques, and as expected.

    Each arm plays one motion, from which the law is identified, then another path, plainly and corrected. Its
    friction, bodies, encoder and torque noise are those of ``studies.controlled_arms``.

    Args:
        robot: shipped arm or URDF.
        seed: of motions and noise.
        cycle: from command to command, and of the log [s].
        kind: one of them alone; all if empty.
    """
    arm = dataclasses.replace(Robot.load(robot), t_ipo=cycle)
    head("controller", "plain path [mrad]", "with torques", "expected", "angles alone", "expected")
    for name in [kind] if kind else list(KINDS):
        rng = np.random.default_rng(seed)
        plant = Plant(arm, name, USUAL[name])
        shown = plant.run(motion(arm, rng, 20.0, cycle), cycle, cycle, rng)
        path = held(motion(arm, rng, 8.0, cycle), before=round(REST / cycle))
        alone = Recording({column: values for column, values in shown.columns.items() if not column.startswith("tau")})
        known = identify([shown], arm).model
        models = (dataclasses.replace(known, command=identify_command([shown], known, torque=True)),
                  identify_from_commands(alone, arm).model)
        plain = _missed(plant, path, path, cycle, rng)
        cells = [plain]
        for model in models:
            inverse = CommandInverse(model, arm)
            cells += [_missed(plant, inverse.along(path), path, cycle, rng), _rms(inverse.expected(path))]
        row(name, *(f"{value:.3g}" for value in cells))


def _missed(plant: Plant, commands: Array, path: Array, cycle: float, rng: np.random.Generator) -> float:
    """Root mean square of path minus angle over all joints, after the rest [mrad]."""
    played = plant.run(commands, cycle, cycle, rng).joints("q")
    return _rms((path[: len(played)] - played)[round(REST / cycle):])


def _rms(errors: Array) -> float:
    return 1e3 * float(np.sqrt(np.mean(errors**2)))


