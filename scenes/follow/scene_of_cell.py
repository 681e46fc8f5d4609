"""Scene files as a follower reads them: without the world, which a real cell's file need not hold."""

from __future__ import annotations

from pathlib import Path

from ideal_robot.errors import InputError
from scenes.force.scene import ForceScene
from scenes.line.scene import LineScene
from scenes.scene import OWN, Scene, scene_of
from scenes.scene_file import scene_values

FOLLOWED: dict[str, type[Scene]] = {"line": LineScene, "force": ForceScene}


def load_cell(name_or_path: str | Path) -> Scene:
    """Loads and checks a scene that can be followed on devices.

    Raises:
        InputError: no such scene, another kind, an unknown key, a value out of range, the model of a simulated arm.
    """
    path, values = scene_values(name_or_path)
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in FOLLOWED:
        raise InputError(f"only scenes of kind {', '.join(FOLLOWED)} are followed on devices", file=path, field="kind",
                         value=kind)
    scene = scene_of(FOLLOWED[kind], values, path).beside(path.absolute().parent)
    if scene.model == OWN:
        raise InputError("the model of a simulated arm; identify the real one and give the path of its model",
                         file=path, field="model", value=OWN)
    return scene
