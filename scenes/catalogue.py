"""What there is: scenes, robots, methods, effects, detectors and keys, those that other packages added included."""

from __future__ import annotations

from typing import Any

from ideal_robot.effects.registry import library
from ideal_robot.feedforward.registry import method, methods
from ideal_robot.robots.robot import SHIPPED, Robot
from scenes.scene_file import library as scene_folder
from scenes.scene_file import load_scene
from scenes.schema import scene_keys
from sensing.camera.opencv_detector import DETECTORS


def catalogue(what: str, kind: str = "line") -> tuple[list[str], list[list[Any]]]:
    """Column titles and rows of a list.

    Args:
        what: ``scenes``, ``robots``, ``methods``, ``effects``, ``detectors`` or ``keys``.
        kind: with ``keys``, of which kind of scene.

    Raises:
        InputError: no such kind.
    """
    if what == "scenes":
        found = [load_scene(path) for path in sorted(scene_folder().glob("*.toml"))]
        return ["scene", "kind", "robot", "title"], [[one.name, one.kind, one.robot, one.title] for one in found]
    if what == "robots":
        arms = [Robot.load(name) for name in SHIPPED]
        return ["robot", "joints", "cycle [ms]", "URDF"], [[arm.name, arm.n, 1e3 * arm.t_ipo, arm.urdf.name]
                                                           for arm in arms]
    if what == "methods":
        return ["method", "needs", "what it does"], [[key, method(key).needs.name.lower(), method(key).description]
                                                     for key in methods()]
    if what == "effects":
        return ["effect", "acts on", "what it is"], [
            [effect.name, effect.key.partition("/")[2], (type(effect).__doc__ or "").strip().partition("\n")[0]]
            for effect in library()]
    if what == "detectors":
        return ["detector", "how it works"], [[name, (one.__doc__ or "").strip().partition("\n")[0]]
                                              for name, one in DETECTORS]
    return ["table", "key", "default", "allowed", "meaning"], [
        [key.table, key.name, "required" if key.required else key.default, key.allowed, key.meaning]
        for key in scene_keys(kind)]
