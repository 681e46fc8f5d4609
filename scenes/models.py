"""Where the ideal robot's model comes from: shipped, of the very arm, or a file of the user's."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources
from pathlib import Path

from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.prepared_model import prepared_model
from scenes.result import Progress, silent
from scenes.scene import OWN, SHIPPED, Scene
from sim.arm.world import World


def shipped_model(robot_name: str) -> Path:
    """File of the model that was identified beforehand on recordings of the robot's default world (``make models``)."""
    return Path(str(resources.files("scenes"))) / "models" / f"{robot_name}.json"


def model_for(scene: Scene, robot: Robot, progress: Progress = silent) -> Model:
    """The model that a scene asks for; the arm's own one is identified now if that has not been done.

    Args:
        scene: says which model, and what the arm is like that moves for an own one.
        robot: the arm as its data sheet has it.
        progress: called with the fraction of an identification done.

    Raises:
        InputError: no shipped model for that robot, no such file, or a model of another robot.
    """
    if scene.model == OWN:
        path = prepared_model(robot, World.from_table(scene.robot, scene.world), progress).path
    else:
        path = shipped_model(robot.name) if scene.model == SHIPPED else Path(scene.model)
    if not path.is_file():
        raise InputError("no such model file" if scene.model != SHIPPED else
                         f"no model is shipped for {robot.name}; identify one and give its path", field="model",
                         value=scene.model)
    model = _load(path, path.stat().st_mtime_ns)
    model.require_arm(robot, file=path)
    return model


@lru_cache(maxsize=8)
def _load(path: Path, changed: int) -> Model:
    """Loads once as long as the file does not change."""
    return Model.load(path)
