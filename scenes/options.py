"""Speed, seed, arm, horizon and world given from outside in place of a scene's own."""

from __future__ import annotations

import math
from typing import Any

from ideal_robot.errors import InputError
from scenes.scene import OWN, SHIPPED, Scene


def chosen(scene: Scene, *, speed: float | None = None, seed: int | None = None, individual: int | None = None,
           n_d: int | None = None, world: str | None = None) -> Scene:
    """The scene with options in place of its own values.

    Args:
        scene: to change.
        speed: along the path [m/s]; the scene's own if None.
        seed: of all that is drawn; the scene's own if None.
        individual: which arm of the type plays, with the model its own identification motions give unless the scene
            names a model file; the scene's own arm and model if None.
        n_d: desired positions that the feedforward is given ([L] 2.2); the scene's own if None.
        world: where the scene plays, ``workshop`` or ``bench``; where its file says if None.

    Raises:
        InputError: a speed that is not positive, or a kind of scene that has none; the same of a horizon.
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
    if world is not None:
        changes["world"] = {"base": world}
    if individual is not None:
        changes["world"] = {**changes.get("world", {}), "individual": individual}
        if scene.model == SHIPPED:
            changes["model"] = OWN
    if n_d is not None:
        if "n_d" not in type(scene).model_fields:
            raise InputError(f"scenes of kind {scene.kind!r} have no horizon to choose", field="--n-d", value=n_d)
        if n_d < 1:
            raise InputError("expected a whole number from 1 up", field="--n-d", value=n_d)
        changes["n_d"] = n_d
    return scene.changed(**changes) if changes else scene
