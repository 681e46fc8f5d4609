"""An arm behind joint controllers of many kinds: what the command's law leaves of a path, with and without torques."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.errors import IdealRobotError
from ideal_robot.feedforward.command_inverse import CommandInverse
from ideal_robot.identification.angles_alone import identify_from_commands
from ideal_robot.identification.command import identify_command
from ideal_robot.identification.idim import identify
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.recording import Recording
from studies.controlled_arms import KINDS, USUAL, Plant, drawn, motion
from studies.report import head, row

REST = 1.0
"""Rest before a path [s]."""


def controllers(robot: str = "kr6", seed: int = 1, cycle: float = 0.004, kind: str = "", engine: str = "plain",
                draws: int = 0, elastic: bool = False) -> None:
    """Errors of a path behind each kind of controller: plain, corrected with and without torques, and as expected.

    Each arm plays one motion of 20 s, from which the law is identified, then another path of 8 s, plainly and
    corrected. Behind each measured error stands measured over expected. The last column is a regression of
    ``q_c - q`` on velocity, acceleration, jerk and direction.

    Args:
        robot: shipped arm or URDF.
        seed: of motions and noise.
        cycle: from command to command, and of the log [s].
        kind: one of them alone; all if empty.
        engine: plain or mujoco.
        draws: arms with gains, lateness, friction, bodies and encoder drawn at random; 0 for the usual one.
        elastic: gears as springs; MuJoCo's alone.
    """
    arm = dataclasses.replace(Robot.load(robot), t_ipo=cycle)
    head("controller", "plain path [mrad]", "over expected", "with torques", "over expected", "angles alone",
         "over expected", "regression")
    for name in [kind] if kind else list(KINDS):
        for draw in range(max(draws, 1)):
            rng = np.random.default_rng(seed + 1000 * draw)
            plant = Plant(arm, name, USUAL[name], engine=engine, elastic=elastic) if not draws else Plant(
                arm, name, drawn(name, rng), float(rng.uniform(0.03, 0.2)), float(rng.uniform(0.9, 1.1)),
                float(10.0 ** rng.uniform(-6.0, -4.3)), engine=engine, elastic=elastic)
            _one(name, plant, arm, rng)


def _one(name: str, plant: Plant, arm: Robot, rng: np.random.Generator) -> None:
    cycle = arm.t_ipo
    shown = plant.run(motion(arm, rng, 20.0, cycle), cycle, cycle, rng)
    path = held(motion(arm, rng, 8.0, cycle), before=round(REST / cycle))
    plain, foretold, cells = _missed(plant, path, path, cycle, rng), float("nan"), []
    for model in (_with_torques(shown, arm), _alone(shown, arm)):
        if model is None:
            cells += ["refused", ""]
            continue
        inverse = CommandInverse(model, arm)
        # Of the two the one from angles alone, which every arm has.
        foretold = _rms(inverse.uncorrected(path)[round(REST / cycle):])
        left = _missed(plant, inverse.along(path), path, cycle, rng)
        cells += [f"{left:.3g}", f"{left / _rms(inverse.expected(path)[round(REST / cycle):]):.2f}"]
    cells = [f"{plain:.3g}", f"{plain / foretold:.2f}", *cells]
    row(name, *cells, f"{_missed(plant, _regression(shown, path, cycle), path, cycle, rng):.3g}")


def _with_torques(shown: Recording, arm: Robot) -> Model | None:
    return _tried(lambda: (known := identify([shown], arm).model) and dataclasses.replace(
        known, command=identify_command([shown], known, torque=True)))


def _alone(shown: Recording, arm: Robot) -> Model | None:
    columns = {name: values for name, values in shown.columns.items() if not name.startswith("tau")}
    return _tried(lambda: identify_from_commands(Recording(columns), arm).model)


def _tried(make: Callable[[], Model]) -> Model | None:
    """The model, or None where the program refuses."""
    try:
        return make()
    except IdealRobotError:
        return None


def _regression(shown: Recording, path: Array, cycle: float) -> Array:
    """Commands by a regression without shapes, terms of the body or a choice: what a user writes in an hour."""
    def columns(q: Array) -> Array:
        rates = [q]
        for _ in range(3):
            rates.append(np.gradient(rates[-1], cycle, axis=0))
        return np.stack([*rates[1:], np.tanh(rates[1] / still), np.ones_like(q)], axis=2)

    q_c, q = shown.joints("q_c"), lowpass(shown.joints("q"), cycle, 10.0)
    still = 0.05 * np.std(np.gradient(q, cycle, axis=0), axis=0)
    X, y, ahead = columns(q), lowpass(q_c, cycle, 10.0) - q, columns(path)
    commands = path.copy()
    for j in range(path.shape[1]):
        size = np.linalg.norm(X[:, j], axis=0)
        commands[:, j] += ahead[:, j] @ (np.linalg.lstsq(X[:, j] / size, y[:, j], rcond=1e-9)[0] / size)
    return commands


def _missed(plant: Plant, commands: Array, path: Array, cycle: float, rng: np.random.Generator) -> float:
    """Root mean square of path minus angle over all joints, after the rest [mrad]."""
    return _rms((path - plant.run(commands, cycle, cycle, rng).joints("q"))[round(REST / cycle):])


def _rms(errors: Array) -> float:
    return 1e3 * float(np.sqrt(np.mean(errors**2)))
