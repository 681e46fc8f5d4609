"""Twins of recorded arms: how near they play what was recorded, and what line error they predict."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.identification.whole_model import identify_model
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.commands.common import whole_numbers
from scenes.identification.plan import identified_model
from scenes.identification.twin import DRAWS, twin_of
from scenes.identification.twin_play import COLUMNS, make_twin
from scenes.line.play import play
from scenes.scene_file import load_scene
from scenes.scene_files.line_scene import LineScene
from sim.arm.world import World
from studies.measured import ARMS
from studies.report import head, row


def twins(data: Path, arms: str = "ur10e,panda,emps") -> None:
    """Twins of measured arms play the recorded motion: torques beside the measured ones, spectrum, identification.

    DATA is the folder of the recordings. The spectrum's difference is that of the amplitudes in octaves, weighted by
    the measured power. None of these recordings has commands: the controllers are those of a class.
    """
    head("arm", *COLUMNS)
    for name in arms.split(","):
        urdf, first, _ = (data / file for file in ARMS[name].files)
        result = make_twin([Recording.read(first)], str(urdf))
        for values in result.rows():
            row(name, str(values[0]), *(f"{value:.3g}" for value in values[1:]))


def twin_arms(arms: str = "1-3", draws: int = DRAWS) -> None:
    """The line error that a twin predicts for a simulated KR 6, and that arm's own, over several arms of the type.

    The twin is made of the recordings of the arm's two identification motions. It is drawn anew as often as DRAWS says,
    each time with another seed, and each time follows with the model identified from its own recordings, as the arm
    does, with the same seeds. Of the arm the mean over seeds counts.
    """
    head("arm", "mean [mm]", "predicted", "off by [%]", "95 % [mm]", "predicted from", "to", "inside")
    for number in whole_numbers(arms, "--arms"):
        scene = load_scene("line").changed(model="own", world={"individual": number})
        assert isinstance(scene, LineScene)
        seeds = range(1, draws + 1)
        mean, worst = np.mean([_line_error(scene.changed(seed=seed)) for seed in seeds], axis=0)
        world = World.from_table(scene.robot, scene.arm_world)
        _, recordings = identified_model(scene.robot, world=world)
        robot = arm_of(scene.robot)
        twin = twin_of(identify_model(recordings, robot), robot, scene.robot)
        found = np.array([_line_error(scene.changed(seed=seed, world={**twin.table, "individual": seed}))
                          for seed in seeds])
        predicted, low, high = float(np.mean(found[:, 0])), float(found[:, 1].min()), float(found[:, 1].max())
        row(str(number), f"{mean:.3f}", f"{predicted:.3f}", f"{100.0 * (predicted / mean - 1.0):+.0f}", f"{worst:.3f}",
            f"{low:.3f}", f"{high:.3f}", "yes" if low <= worst <= high else "no")


def _line_error(scene: LineScene) -> Array:
    """Mean and 95 % of the distance from the line ``(2,)`` [mm]."""
    error = play(scene, "adapted").control_error
    return 1e3 * np.array([error.mean, error.p95])
