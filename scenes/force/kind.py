"""The functions of scenes of kind ``force``: run, compare methods, curves for the viewer, close the loop."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ideal_robot.progress import Steps
from scenes.force.cell import Prepared, scene_curves
from scenes.force.compare import ForceComparison, best_gains, compare_forces
from scenes.force.page import comparison_page, force_replay, run_page
from scenes.force.play import ForceResult, play
from scenes.force.play import methods as force_methods
from scenes.kind import SceneKind
from scenes.methods import DIRECT, PLAIN, compared, method_of
from scenes.report.page import write_comparison_files, write_run_files
from scenes.result import Progress, part_of, silent
from scenes.scene_files.force_scene import ForceScene

SHARES = {"calibrating by moving": 0.15, "playing": 0.55, "report": 0.3}
"""Measured shares of the time."""


def run(scene: ForceScene, *, method: Any = None, out: Path | None = None, progress: Progress = silent,
        gains: tuple[float, float] | None = None) -> ForceResult:
    """Runs a force scene once, see ``Play.__call__``.

    ``gains`` are K_p [m/N per cycle], K_d [m/N] of direct feedback; the scene's, or found by search, if None.
    """
    chosen = method_of(method or scene.method, force_methods(scene.task))
    shared = Prepared(scene)
    if chosen.key == DIRECT and gains is None:
        gains = scene.gains or best_gains(scene, shared, progress=lambda part, text: progress(0.8 * part, text))[0]
        progress = part_of(progress, 0.8, 0.2)
    steps = Steps(progress, SHARES)
    steps.begin("calibrating by moving")
    # The first progress of a run comes after its calibration.
    result = play(scene, chosen, gains, steps.part("playing"), shared)
    steps.begin("report")
    return result if out is None else write_run_files(result, run_page, out, force_replay(result))


def compare(scene: ForceScene, *, methods: Sequence[Any] | None = None, out: Path | None = None,
            progress: Progress = silent) -> ForceComparison:
    """Runs a force scene with several methods, direct feedback at its best gains; see ``Compare.__call__``."""
    comparison = compare_forces(scene, compared(methods, force_methods(scene.task), PLAIN), progress=progress)
    return comparison if out is None else write_comparison_files(comparison, comparison_page, out)


FORCE = SceneKind(ForceScene, force_methods, run, compare, scene_curves,
                  "scenes.force.close_loop:close_loop", force_replay)
