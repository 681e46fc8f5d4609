"""Compiles what runs need, once: ``python -m scenes.compiled``, done when make installs; ``line`` for that kind alone.

Compiled code is kept beside the sources, or in ``NUMBA_CACHE_DIR``; without this step a first run takes half
a minute longer. It plays short scenes, so that everything is compiled for the very types that runs use.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

from ideal_robot.execution.command_governor import CommandGovernor
from ideal_robot.feedforward.base import tried
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward, methods, settings
from ideal_robot.identification.excitation import Workspace, obstacle
from ideal_robot.identification.idim import identify
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.models import shipped_model
from scenes.play import run_scene
from scenes.scene_file import load_scene
from sim.arm.arm import SimulatedArm
from sim.arm.world import World

SHORT: dict[str, dict[str, Any]] = {"straight": {"line": {"points": [[0.0, 0.0], [0.4, 0.0]]}, "tool_mm": 250.0},
                                    "iso9283_1": {}, "force_wave": {"line": {"length": 0.2}},
                                    "glue": {"line": {"length": 0.2}}}
"""A scene of each kind, with what makes it short; with a tool, so that the arm is in the picture."""


def compile_scenes(*kinds: str) -> None:
    """Plays a short scene of some kinds, of each if none is named."""
    for name, short in SHORT.items():
        if kinds and load_scene(name).kind not in kinds:
            continue
        run_scene(load_scene(name), method="adapted", **short)


def compile_all() -> None:
    """Plays a short scene of each kind, every feedforward and an identification."""
    compile_scenes()
    robot = Robot.load("kr6")
    model = Model.load(shipped_model("kr6"))
    for key in (*methods(Needs.MODEL), *settings(Needs.MODEL)):
        tried(feedforward(key, model, robot, n_d=30), robot.home, robot.t_ipo)
    simulate(loop_model(model, robot), np.tile(robot.home, (3, 1)))
    obstacle(robot, robot.home[None], Workspace())
    governor = CommandGovernor(robot, robot.home)
    with SimulatedArm(robot, World.default("kr6"), np.random.default_rng(0)) as arm:
        for k in range(400):
            offset = 0.3 * np.sin(0.012 * k * np.arange(2.0, 8.0)) ** 2
            arm.cycle(governor.allowed(robot.home + offset))
        identify([arm.recording()], robot, friction="viscous_coulomb")


if __name__ == "__main__":
    started = time.perf_counter()
    compile_scenes(*sys.argv[1:]) if sys.argv[1:] else compile_all()
    print(f"compiled in {time.perf_counter() - started:.0f} s")
