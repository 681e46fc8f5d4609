"""The source of the ideal robot's model: shipped, identified for this arm, or a file of the user's.

Shipped and own models are identified from recordings of the simulated arm, as a user would: only a controller's log and
an external measuring device are used.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import ideal_robot
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.registry import imported
from ideal_robot.robots import SHIPPED as SHIPPED_ARMS
from ideal_robot.robots.robot import Robot
from scenes.arms import arm_of, model_at, shipped_model
from scenes.outputs import check_outputs
from scenes.result import Progress, silent
from scenes.scene_files.scene import OWN, SHIPPED, Box, Scene, boxes_of, obstacles
from sim.arm.world import World


def _identified(robot_name: str, **options: Any) -> Model:
    """Identification takes half a second to import, and most runs find their model kept."""
    identified_model: Callable[..., tuple[Model, Any]] = imported("scenes.identification.own_model:identified_model")
    return identified_model(robot_name, **options)[0]


PROCEDURE = 17
"""Counts the ways in which models have been prepared; another one makes kept models void."""


class PreparedModel(NamedTuple):
    """The file of an arm's own model, and whether it was identified now."""

    path: Path
    fresh: bool


def cache_folder() -> Path:
    """Folder of prepared models: ``$IDEAL_ROBOT_CACHE``, else ``ideal-robot`` in the user's cache folder."""
    own = os.environ.get("IDEAL_ROBOT_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ideal-robot"


def prepared_model(robot: Robot, world: World, progress: Progress = silent, boxes: Sequence[Box] = ()
                   ) -> PreparedModel:
    """The model identified from an arm's own motions; they are run where no valid model is cached.

    The world says how the simulated arm moves, as a real arm's mechanics do; the model sees its recordings alone.
    Raises InputError for an arm whose world does not fit its data, or a cache folder that cannot be written.

    Args:
        robot, world: the arm as its data sheet has it, and as it is.
        progress: called with the fraction done.
        boxes: boxes in the cell that the motions avoid.
    """
    path = cache_folder() / f"{cache_name(robot, world, boxes)}.json"
    if os.path.isfile(path):
        # A cached model that is truncated or unreadable is identified again.
        with suppress(InputError):
            model_at(str(path), robot)
            return PreparedModel(path, fresh=False)
    # Checked now, not after the arm has moved for minutes.
    check_outputs({"IDEAL_ROBOT_CACHE": path.parent})
    model = _identified(world.robot, world=world, boxes=obstacles(boxes), progress=progress)
    return PreparedModel(model.save(path), fresh=True)


def cache_name(robot: Robot, world: World, boxes: Sequence[Box] = ()) -> str:
    """Name of a cache file: the robot, and a digest of all that the model depends on, the procedure included.

    Args:
        robot, world, boxes: as for ``prepared_model``.
    """
    digest = digest_of([PROCEDURE, ideal_robot.__version__, robot.urdf_hash, robot.data, world.table(),
                        *(box.model_dump() for box in boxes)])
    return f"{robot.name}_{digest}"


__all__ = ["model_for", "own_model", "shipped_model"]


def model_for(scene: Scene, robot: Robot, progress: Progress = silent) -> Model:
    """The model that a scene names; the arm's own one is identified now if that has not been done.

    Raises InputError as ``model_at`` and ``prepared_model`` do.

    Args:
        scene, robot: the scene with its model and world, and the arm by its data sheet.
        progress: called with the fraction of an identification done.
    """
    if scene.model != OWN:
        return model_at(scene.model, robot, scene.source)
    return model_at(own_model(scene, robot, progress), robot)


def own_model(scene: Scene, robot: Robot, progress: Progress = silent) -> str:
    """Path of the model from the scene's own identification motions; identified now where it is missing.

    Args:
        scene, robot: the arm as it is, and as its data sheet has it.
        progress: called with the fraction of an identification done.
    """
    world = World.from_table(scene.robot, scene.arm_world, scene.source)
    return str(prepared_model(robot, world, progress, boxes_of(scene)).path)


if __name__ == "__main__":
    import sys

    for shipped in sys.argv[1:] or ["kr6", "kr15", "manutec_r15"]:
        print(_identified(shipped).save(shipped_model(shipped)))


# Digests of a run's inputs: task, world and model.

_WORDS = {"name", "title", "description", "paper"}
"""Keys of a scene that say what it is called."""
_HOW = {"seed", "method", "model", "n_d", "gains"}
"""Keys of a scene that say how a task is done; runs that differ in nothing else can be compared."""


def digest_of(content: Any) -> str:
    """Sixteen hexadecimal digits of the hash of a JSON value."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:16]


def identity(scene: Scene) -> dict[str, str | None]:
    """Digests of the inputs of a run: its task, its world, its model.

    Args:
        scene: with its options applied.

    Returns:
        ``task_hash``: what is asked of the arm, whichever the seed, method and model, with the content of the files
        that the scene names; ``world_hash``: the simulated arm; ``model_hash``: the model file, None where there is
        none.
    """
    task = scene.model_dump(mode="json", exclude=_WORDS | _HOW, exclude_defaults=True)
    if "robot" in task:
        # The file's name, without its folder, which depends on the working folder.
        task["robot"] = Path(scene.robot).name
    named = {text: place.read_bytes() for text in _texts(task)
             if os.path.isfile(place := (scene.folder or Path.cwd()) / text) and os.access(place, os.R_OK)}
    if named:
        task["files"] = {text: hashlib.sha256(content).hexdigest() for text, content in named.items()}
    world = World.from_table(scene.robot, scene.arm_world, scene.source)
    simulated: Any = world.table()
    if scene.robot not in SHIPPED_ARMS:
        arm = arm_of(scene.robot)
        simulated = [simulated, arm.urdf_hash, arm.data]
    if scene.model == OWN:
        model: str | None = cache_name(arm_of(scene.robot), world)
    else:
        path = shipped_model(scene.robot) if scene.model == SHIPPED else Path(scene.model)
        model = hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else None
    return {"task_hash": digest_of(task), "world_hash": digest_of(simulated), "model_hash": model}


def _texts(value: Any) -> Iterator[str]:
    """Every text of a scene's values that may name a file: one with an ending."""
    if isinstance(value, str):
        if Path(value).suffix:
            yield value
    elif isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _texts(part)
