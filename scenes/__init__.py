"""Where all is put together: scene files, runner, metrics, reports, viewer and command line.

For scripts and regression tests::

    from scenes import load_scene, run_scene

    result = run_scene(load_scene("line"), speed=0.4, seed=3, camera={"latency": 0.08})
    print(result.control_error.mean)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from scenes.scene import Scene

__all__ = ["compare_scene", "load_scene", "run_scene"]


def load_scene(name_or_path: str | Path) -> Scene:
    """A shipped scene by name, or a scene file by path, checked; see ``scenes.scene.load_scene``."""
    from scenes import scene

    return scene.load_scene(name_or_path)


def run_scene(scene: Scene, *, method: str | None = None, out: Path | None = None, **changes: Any) -> Any:
    """Plays a scene and returns its typed result (``scenes.line.result.LineResult`` for a line).

    Args:
        scene: what to play.
        method: method key; the scene's own if None.
        out: folder for recording and report; nothing is written without.
        changes: keys of the scene to change; tables are given as dictionaries and merged.

    Raises:
        InputError: the scene cannot be played.
    """
    from scenes.scene import module_of

    changed = scene.changed(**changes) if changes else scene
    return module_of(changed).run(changed, method=method, out=out)


def compare_scene(scene: Scene, *, out: Path | None = None, **changes: Any) -> Any:
    """Plays a scene with every method that applies; arguments as for ``run_scene``."""
    from scenes.scene import module_of

    changed = scene.changed(**changes) if changes else scene
    return module_of(changed).compare(changed, out=out)
