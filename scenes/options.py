"""Speed and seed given from outside in place of a scene's own."""

from __future__ import annotations

import math
from typing import Any

from ideal_robot.errors import InputError
from scenes.scene import Scene


def chosen(scene: Scene, *, speed: float | None = None, seed: int | None = None) -> Scene:
    """The scene with options in place of its own values.

    Args:
        scene: to change.
        speed: along the path [m/s]; the scene's own if None.
        seed: of all that is drawn; the scene's own if None.

    Raises:
        InputError: a speed that is not positive, or a kind of scene that has none.
    """
    changes: dict[str, Any] = {}
    if speed is not None:
        if "speed" not in type(scene).model_fields:
            raise InputError(f"scenes of kind {scene.kind!r} have no speed", field="--speed", value=speed)
        if not (math.isfinite(speed) and speed > 0):
            raise InputError("expected a positive number [m/s]", field="--speed", value=speed)
        changes["speed"] = speed
    if seed is not None:
        changes["seed"] = seed
    return scene.changed(**changes) if changes else scene
