"""Where results come from: program, machine, and digests of what was played."""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from scenes.arms import arm_of
from scenes.model_files import shipped_model
from scenes.models import cache_name
from scenes.scene_files.scene import OWN, SHIPPED, Scene
from sim.arm.world import World

ROOMS = ("ideal_robot", "planning", "scenes", "sensing", "sim")
"""Folders of what is installed; a run depends on nothing else of ours."""
_WORDS = {"name", "title", "description", "paper"}
"""Keys of a scene that say what it is called."""
_HOW = {"seed", "method", "model", "n_d", "gains"}
"""Keys of a scene that say how a task is done; runs that differ in nothing else can be compared."""


@cache
def program() -> dict[str, str | None]:
    """Version of the program, commit of the checkout (None where it is installed), digest of all its sources."""
    return {"version": metadata.version("ideal-robot"), "commit": _commit(), "digest": _source_digest()}


def _commit() -> str | None:
    root = Path(__file__).parents[1]
    if (root / ".git").exists():
        with suppress(OSError, subprocess.SubprocessError):
            return subprocess.run(["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"],
                                  capture_output=True, text=True, check=True, timeout=10.0).stdout.strip()
    return None


def _source_digest() -> str:
    found = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(path for room in ROOMS for path in (root / room).rglob("*")):
        if path.suffix in (".py", ".toml", ".urdf", ".json") and path.is_file():
            found.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return found.hexdigest()[:16]


def machine() -> dict[str, str]:
    """What computed: kind of processor, system, Python, and the libraries that decide the last digits."""
    libraries = {name: metadata.version(name) for name in ("numpy", "scipy", "numba", "pin", "pybullet")}
    return {"processor": platform.machine(), "system": platform.system(), "python": platform.python_version(),
            **libraries}


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
