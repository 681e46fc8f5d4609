"""Where the ideal robot's model comes from: shipped, of the very arm, or a file of the user's."""

from __future__ import annotations

from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.model_files import model_at, shipped_model
from scenes.prepared_model import prepared_model
from scenes.result import Progress, silent
from scenes.scene import OWN, Scene
from sim.arm.world import World

__all__ = ["model_for", "own_model", "shipped_model"]


def model_for(scene: Scene, robot: Robot, progress: Progress = silent) -> Model:
    """The model that a scene asks for; the arm's own one is identified now if that has not been done.

    Args:
        scene: says which model, and what the arm is like that moves for an own one.
        robot: the arm as its data sheet has it.
        progress: called with the fraction of an identification done.

    Raises:
        InputError: no shipped model for that robot, no such file, or a model of another robot.
    """
    if scene.model != OWN:
        return model_at(scene.model, robot, scene.source)
    return model_at(own_model(scene, robot, progress), robot)


def own_model(scene: Scene, robot: Robot, progress: Progress = silent) -> str:
    """Where the model lies that the own motions of the scene's arm give; identified now if that has not been done.

    Args:
        scene: says what the arm is like.
        robot: the arm as its data sheet has it.
        progress: called with the fraction of an identification done.
    """
    world = World.from_table(scene.robot, scene.arm_world, scene.source)
    return str(prepared_model(robot, world, progress).path)
