"""One line, several methods, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planning.line.deviation_sensor import DeviationSensor
from scenes.gains import GainTrial
from scenes.line.cell import prepared
from scenes.line.gains import best_gains, overshoot_gain
from scenes.line.play import play
from scenes.line.result import LineResult
from scenes.line.scene import LineScene
from scenes.methods import DIRECT, SceneMethod
from scenes.result import Progress, part_of, silent
from scenes.shown import ShownTable


@dataclass(frozen=True, repr=False)
class LineComparison(ShownTable):
    """Every method on the same scene.

    Attributes:
        scene: what was played.
        runs: method → result.
        gains: K_p, K_d of direct sensor feedback, found by search; None where it is not among the methods.
        tried: every pair of gains tried, with the mean error it left [m].
        overshoot_gain: largest K_p whose overshoot over a sideways step stays below 5 %.
        overshoots: K_p → overshoot relative to the step.
    """

    scene: LineScene
    runs: dict[str, LineResult]
    gains: tuple[float, float] | None
    tried: tuple[GainTrial, ...]
    overshoot_gain: float
    overshoots: tuple[tuple[float, float], ...]
    report: Path | None = field(default=None)

    def json(self) -> dict[str, Any]:
        """The content of ``--json``: the runs stand under ``methods``."""
        return {
            **self.scene.played(),
            "speed_m_s": self.scene.speed,
            "methods": {method: run.json() for method, run in self.runs.items()},
            "direct_feedback": None if self.gains is None else {
                "k_p": self.gains[0],
                "k_d": self.gains[1],
                "largest_k_p_without_overshoot": self.overshoot_gain,
                "overshoot_of_k_p": [{"k_p": k, "overshoot": o} for k, o in self.overshoots],
                "tried": [{"k_p": one.k_p, "k_d": one.k_d, "mean_mm": 1e3 * one.error} for one in self.tried],
            },
            "recording": {method: run.recording_path for method, run in self.runs.items()},
            "urdf": next(iter(self.runs.values())).urdf,
            "report": self.report,
        }

    def rows(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """The table, for prompt and notebook."""
        columns, rows = self.table()
        return tuple(columns), rows

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """One row a method; errors in mm."""
        columns = ["method", "mean mm", "95 % mm", "max mm", "E_car time-matched", "E_car aligned", "E_car geometric",
                   "fields used", "ended early"]
        rows = []
        for method, run in self.runs.items():
            error, path = run.control_error.json_mm(), run.path_errors
            e_car = [1e3 * getattr(path, kind).E_car if path is not None else None
                     for kind in ("time_matched", "aligned", "geometric")]
            rows.append([method, error["mean"], error["p95"], error["max"], *e_car,
                         f"{run.fields_used} of {run.fields_seen}", run.failure or "no"])
        return columns, rows


def compare_lines(scene: LineScene, methods: Sequence[SceneMethod], *, sensors: Sequence[DeviationSensor] = (),
                  progress: Progress = silent) -> LineComparison:
    """Follows the line with each method; direct sensor feedback with the gains that suit this very scene best.

    Args:
        scene: what to play.
        methods: in the order of the table.
        sensors: besides the camera, with every method.
        progress: called with the fraction done.
    """
    gain = 0.0
    overshoots: tuple[tuple[float, float], ...] = ()
    gains: tuple[float, float] | None = None
    tried: tuple[GainTrial, ...] = ()
    direct = any(method.key == DIRECT for method in methods)
    if direct:
        gain, overshoots = overshoot_gain(scene, progress=lambda fraction, text: progress(0.35 * fraction, text))
    start = 0.75 if direct else 0.0
    runs: dict[str, LineResult] = {}
    with prepared(scene) as shared:
        if direct:
            gains, tried = best_gains(scene, shared, progress=lambda part, text: progress(0.35 + 0.4 * part, text))
        for i, method in enumerate(methods):
            runs[method.key] = play(scene, method, shared=shared, gains=gains, sensors=sensors,
                                    progress=part_of(progress, start + (1 - start) * i / len(methods),
                                                     (1 - start) / len(methods)))
    return LineComparison(scene, runs, gains, tried, gain, overshoots)
