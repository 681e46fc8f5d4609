"""The functions of scenes of kind ``line``: run, compare methods, curves for the viewer, close the loop."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ideal_robot.arrays import Array
from planning.line.deviation_sensor import DeviationSensor
from scenes.kind import SceneKind
from scenes.line.cell import Prepared, prepared, streams
from scenes.line.compare import LineComparison, best_gains, compare_lines
from scenes.line.page import comparison_page, line_replay, run_page
from scenes.line.play import methods as play_methods
from scenes.line.play import play
from scenes.line.result import DOUBTFUL, LineResult
from scenes.methods import DIRECT, NONE, PLAIN, compared, method_of
from scenes.report.page import write_comparison_files, write_run_files
from scenes.result import Progress, part_of, silent
from scenes.scene_files.drawn_line import geometry
from scenes.scene_files.line_scene import LineScene

_PREPARED, _PLAYED = 0.4, 0.35
"""Measured shares of time: setting up and calibrating; of the rest, playing. Drawing the page is what remains."""


def run(scene: LineScene, *, method: Any = None, out: Path | None = None, progress: Progress = silent,
        gains: tuple[float, float] | None = None, shared: Prepared | None = None,
        sensors: Sequence[DeviationSensor] = ()) -> LineResult:
    """Follows the line once, see ``Play.__call__``.

    ``gains`` are K_p, K_d of direct sensor feedback [1 per cycle], found by search if None; ``shared``, ``prepared``
    of the same scene, saves its time; ``sensors`` beside the camera are fused with it ([L] 4.3).
    """
    chosen = method_of(method or scene.method, play_methods())
    if shared is None:
        with prepared(scene, progress) as own:
            return run(scene, method=chosen, out=out, progress=part_of(progress, _PREPARED, 1.0 - _PREPARED),
                       gains=gains, shared=own, sensors=sensors)
    if chosen.key == DIRECT and gains is None:
        gains, _ = best_gains(scene, shared, progress=lambda fraction, text: progress(0.8 * fraction, text))
        progress = part_of(progress, 0.8, 0.2)
    result = play(scene, chosen, shared=shared, gains=gains, sensors=sensors, progress=part_of(progress, 0.0, _PLAYED),
                  pictures=out is not None)
    if result.method != NONE and result.control_error.mean > DOUBTFUL:
        # The run without correction is done to measure the improvement.
        result = result.beside_none(play(result.scene, NONE, shared=shared, sensors=sensors))
    progress(_PLAYED, "report")
    return result if out is None else write_run_files(result, run_page, out, line_replay(result))


def compare(scene: LineScene, *, methods: Sequence[Any] | None = None, out: Path | None = None,
            progress: Progress = silent, sensors: Sequence[DeviationSensor] = ()) -> LineComparison:
    """Compares methods, direct sensor feedback at its best gains; ``sensors`` are added to the camera in all.

    See ``Compare.__call__``.
    """
    comparison = compare_lines(scene, compared(methods, play_methods(), PLAIN), sensors=sensors, progress=progress)
    return comparison if out is None else write_comparison_files(comparison, comparison_page, out)


def curves(scene: LineScene) -> dict[str, Array]:
    """Drawn line and reference path ``(N, 3)`` [m], for the viewer."""
    where = geometry(scene, streams(scene)[0])
    return {"line": where.drawn, "reference": where.reference}


LINE = SceneKind(LineScene, play_methods, run, compare, curves, "scenes.line.close_loop:close_loop", line_replay)
