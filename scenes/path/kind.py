"""The functions of scenes of kind ``path``: run, compare methods, close the loop."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ideal_robot.feedforward.registry import SETTING
from ideal_robot.progress import Steps
from scenes.kind import SceneKind
from scenes.methods import DELAY, compared, method_of
from scenes.path.cell import PathResult, path_methods, set_up
from scenes.path.compare import PathComparison, compare_paths, play_method
from scenes.path.page import comparison_page, path_replay, run_page
from scenes.report.page import write_comparison_files, write_run_files
from scenes.result import Progress, silent
from scenes.scene_files.path_scene import PathScene

SHARES = {"setting up": 0.05, "playing": 0.52, "report": 0.43}
"""Measured shares of the time, of a path of some seconds for which nothing is learned."""


def run(scene: PathScene, *, method: Any = None, out: Path | None = None, progress: Progress = silent) -> PathResult:
    """Runs the scene's path with one method; see ``Play.__call__``."""
    chosen = method_of(method or scene.method, path_methods())
    steps = Steps(progress, SHARES)
    steps.begin("setting up")
    result = play_method(scene, set_up(scene, delay=chosen.key.endswith(DELAY)), chosen, steps.part("playing"))
    steps.begin("report")
    return result if out is None else write_run_files(result, run_page, out, path_replay(result))


def compare(scene: PathScene, *, methods: Sequence[Any] | None = None, out: Path | None = None,
            progress: Progress = silent) -> PathComparison:
    """Compares methods; by default all, with the settings that a paper has figures of. See ``Compare.__call__``."""
    paper = (*scene.paper.E_car_reduction_percent, *scene.paper.E_max_reduction_percent)
    left_out = [key for key in path_methods() if SETTING in key and key not in paper]
    comparison = compare_paths(scene, compared(methods, path_methods(), left_out), progress=progress)
    return comparison if out is None else write_comparison_files(comparison, comparison_page, out)


PATH = SceneKind(PathScene, path_methods, run, compare, None, "scenes.path.close_loop:close_loop", path_replay)
