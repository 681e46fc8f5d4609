"""A line that is followed behind the world's joint controllers, each arm with a model identified behind its own."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ideal_robot.errors import IdealRobotError
from scenes import run_scene
from scenes.methods import ADAPTED, DIRECT, SENSOR_PATH
from scenes.scene_files.line_scene import LineScene
from studies.report import head, row, scene_of

BEHIND: dict[str, dict[str, Any]] = {
    "cascade, velocity fed forward by 0.93": {},
    "cascade, nothing fed forward": {"velocity_feedforward": 0.0},
    "cascade, commands 24 ms late": {"command_late": 0.024},
    "cascade, commands lag by 50 ms": {"command_smoothing": "lag", "command_time": 0.05},
    "cascade, gains by posture": {"gain_schedule": 0.35},
    "PID on the position": {"controller": "pid"},
    "impedance": {"controller": "impedance"},
    "inverse dynamics": {"controller": "inverse_dynamics"},
}
"""Keys of the world beside the scene's own."""


def controlled_line(seed: int = 1, only: str = "") -> None:
    """Mean distance of the tool from the line behind each joint controller of the world, by three methods.

    Args:
        seed: of the scene.
        only: controllers whose words begin so; all if empty.
    """
    scene = scene_of(LineScene, "line")
    methods = (ADAPTED, SENSOR_PATH, DIRECT)
    head("controller", *(f"`{method}`: mean [mm]" for method in methods), f"`{ADAPTED}`: 95 % below [mm]")
    for words, keys in BEHIND.items():
        if not words.startswith(only):
            continue
        errors = [_error(scene, method, seed, keys) for method in methods]
        means = [one if isinstance(one, str) else f"{1e3 * one.mean:.3g}" for one in errors]
        first = errors[0]
        row(words, *means, first if isinstance(first, str) else f"{1e3 * first.p95:.3g}")


def _error(scene: LineScene, method: str, seed: int, keys: dict[str, Any]) -> Any:
    """The distances of one run, or in a word why there are none."""
    try:
        with TemporaryDirectory() as folder:
            done = run_scene(scene, method=method, seed=seed, out=Path(folder), model="own",
                             world={**dict(scene.world), **keys})
    except IdealRobotError:
        return "refused"
    return "lost" if done.failure else done.control_error
