"""What was played, as digests: task, world and model of a run."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from scenes.arms import arm_of
from scenes.model_files import shipped_model
from scenes.models import cache_name
from scenes.scene_files.scene import OWN, SHIPPED, Scene
from sim.arm.world import World

_WORDS = {"name", "title", "description", "paper"}
"""Keys of a scene that say what it is called."""
_HOW = {"seed", "method", "model", "n_d", "gains"}
"""Keys of a scene that say how a task is done; runs that differ in nothing else can be compared."""


def digest_of(content: Any) -> str:
    """Sixteen hexadecimal digits of what JSON can hold."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:16]


def identity(scene: Scene) -> dict[str, str | None]:
    """Digests of what a run depends on: its task, its world, its model.

    Args:
        scene: as it is played, its options applied.

    Returns:
        ``task_hash``: what is asked of the arm, whichever the seed, method and model; ``world_hash``: the simulated
        arm; ``model_hash``: the model file, None where there is none.
    """
    asked = scene.model_dump(mode="json", exclude=_WORDS | _HOW, exclude_defaults=True)
    world = World.from_table(scene.robot, scene.arm_world, scene.source)
    if scene.model == OWN:
        model: str | None = cache_name(arm_of(scene.robot), world)
    else:
        path = shipped_model(scene.robot) if scene.model == SHIPPED else Path(scene.model)
        model = hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else None
    return {"task_hash": digest_of(asked), "world_hash": digest_of(world.table()), "model_hash": model}
