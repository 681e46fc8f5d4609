"""Compiles the code of runs once: ``python -m scenes.compiled``, after installation; ``line`` for that kind alone.

Compiled code is kept beside the sources, or in ``NUMBA_CACHE_DIR``; without this step a first run takes half
a minute longer. It plays short scenes, so that everything is compiled for the very types that runs use.
"""

from __future__ import annotations

import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
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
    """Runs a short scene of each of some kinds, to compile their code."""
    for name, short in SHORT.items():
        if load_scene(name).kind in kinds:
            run_scene(load_scene(name), method="adapted", **short)


def compile_arm(*keys: str) -> None:
    """Runs a path without a sensor, identifies an arm, and tries feedforwards, to compile their code."""
    compile_scenes("path")
    robot = Robot.load("kr6")
    model = Model.load(shipped_model("kr6"))
    governor = CommandGovernor(robot, robot.home)
    with SimulatedArm(robot, World.default("kr6"), np.random.default_rng(0)) as arm:
        for k in range(400):
            offset = 0.3 * np.sin(0.012 * k * np.arange(2.0, 8.0)) ** 2
            arm.cycle(governor.allowed(robot.home + offset))
        identify([arm.recording()], robot, friction="viscous_coulomb")
    for key in keys:
        tried(feedforward(key, model, robot, n_d=30), robot.home, robot.t_ipo)
    simulate(loop_model(model, robot), np.tile(robot.home, (3, 1)))
    obstacle(robot, robot.home[None], Workspace())


def compile_all(*kinds: str) -> None:
    """Compiles the code of runs of some kinds, of all if none is named, in two processes.

    One begins with the camera, the other with the arm; each uses what the other has already compiled.
    """
    keys = () if kinds else (*methods(Needs.MODEL), *settings(Needs.MODEL))
    # The other process runs a path in any case.
    sensed = {*(kinds or (load_scene(name).kind for name in SHORT))} - {"path"}
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        for done in [processes.submit(compile_scenes, *sensed), processes.submit(compile_arm, *keys)]:
            done.result()


if __name__ == "__main__":
    started = time.perf_counter()
    compile_all(*sys.argv[1:])
    print(f"compiled in {time.perf_counter() - started:.0f} s")
