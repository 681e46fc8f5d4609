"""Applications: scene files, runner, metrics, reports, viewer and command line.

For scripts and regression tests::

    from scenes import load_scene, run_scene

    result = run_scene(load_scene("line"), speed=0.4, seed=3, camera={"latency": 0.08})
    print(result.control_error.mean)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planning.line.deviation_sensor import DeviationSensor, Reading
    from scenes.arms import shipped_model
    from scenes.play import close_scene, compare_scene, run_scene
    from scenes.scene_file import load_scene
    from scenes.sweep import sweep_scene

__all__ = ["DeviationSensor", "Reading", "close_scene", "compare_scene", "load_scene", "run_scene", "shipped_model",
           "sweep_scene"]

_WHERE = {
    "DeviationSensor": "planning.line.deviation_sensor",
    "Reading": "planning.line.deviation_sensor",
    "close_scene": "scenes.play",
    "compare_scene": "scenes.play",
    "load_scene": "scenes.scene_file",
    "run_scene": "scenes.play",
    "shipped_model": "scenes.arms",
    "sweep_scene": "scenes.sweep",
}


def __getattr__(name: str) -> Any:
    """Imports a name of the door when it is asked for, so that importing the package stays cheap."""
    if name not in _WHERE:
        raise AttributeError(f"module 'scenes' has no attribute {name!r}; it offers {', '.join(__all__)}")
    importlib.import_module("scenes.program").check_rooms()
    return getattr(importlib.import_module(_WHERE[name]), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
