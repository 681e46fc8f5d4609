"""Files of identified models: the shipped ones, and those of the user's."""

from __future__ import annotations

import os
from functools import lru_cache
from importlib import resources
from pathlib import Path

from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.scene_files.scene import SHIPPED


def shipped_model(robot_name: str) -> Path:
    """File of the model that was identified beforehand on recordings of the robot's default world (``make models``)."""
    return Path(str(resources.files("scenes"))) / "models" / f"{robot_name}.json"


def model_at(wanted: str, robot: Robot, source: str | None = None) -> Model:
    """The model that a scene names by ``shipped`` or by its path.

    Args:
        wanted: the name or path.
        robot: the arm.
        source: the scene, for messages.

    Raises:
        InputError: no shipped model for that robot, no such file, or a model of another robot.
    """
    path = shipped_model(robot.name) if wanted == SHIPPED else Path(wanted)
    if not os.path.isfile(path):
        raise InputError("no such model file; give the path of one that identify or prepare wrote, or shipped"
                         if wanted != SHIPPED else
                         f'no model is shipped for {robot.name}; model = "own" has it identified by '
                         "motions of the scene's arm, or identify one and give its path", file=source,
                         field="model", value=wanted)
    model = _load(path, path.stat().st_mtime_ns)
    model.require_arm(robot, file=path)
    return model


@lru_cache(maxsize=8)
def _load(path: Path, changed: int) -> Model:
    """Loads once as long as the file does not change."""
    return Model.load(path)
