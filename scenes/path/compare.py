"""Runs a path with one method or several, with and without the path planner's delay ([G] sections 4 and 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ideal_robot.feedforward.method import ITERATIONS
from scenes.methods import DELAY, NONE, SceneMethod
from scenes.metrics import reduction_percent
from scenes.path.cell import PathCell, PathResult, set_up
from scenes.result import Progress, ShownTable, part_of, silent
from scenes.scene_files.path_scene import PathScene

_LEARNING = ITERATIONS / (ITERATIONS + 1.0)
"""Share of the plays that learning takes, where there is something to learn; the last one counts."""
_ON_THE_ARM = ("learned", *(f"learned-{steps}" for steps in range(1, ITERATIONS)))
"""Methods that learn on the arm."""


def play_method(scene: PathScene, cell: PathCell, method: SceneMethod, progress: Progress) -> PathResult:
    """Runs the scene's path with one method without writing files.

    Args:
        scene: the scene.
        cell: from ``set_up`` of the scene, with the planner's delay as the method's key says.
        method: how the path is corrected.
        progress: called with the fraction done.

    Raises:
        InputError: no such method.
    """
    learned: list[float] = []

    def learning(fraction: float, text: str) -> None:
        learned.append(fraction)
        progress(_LEARNING * fraction, text)

    feedforward = cell.feedforward(method, learning)
    progress(_LEARNING if learned else 0.0, method.key)
    played = cell.play(feedforward)
    progress(1.0, method.key)
    meta = {**played.recording.meta, "scene": scene.name, "method": method.key, "seed": scene.seed}
    played = replace(played, recording=replace(played.recording, meta=meta))
    return PathResult(scene, method.key, cell.path, played, cell.robot.urdf, cell.world.table())


@dataclass(frozen=True, repr=False)
class PathComparison(ShownTable):
    """The results of several methods on the same path, by their keys."""

    scene: PathScene
    runs: dict[str, PathResult]
    learning_criterion: tuple[float, ...]
    """Root mean square of the errors that learning on the arm saw at each play [rad]."""
    report: Path | None = None

    @property
    def reference(self) -> PathResult:
        """The run that reductions are relative to: no correction, or the first method where that is missing."""
        return self.runs.get(NONE) or next(iter(self.runs.values()))

    def reduction(self, method: str) -> dict[str, dict[str, float]]:
        """Reduction of E_car and E_max against no correction [%]: time-matched, aligned, and the weaker of the two."""
        before, after = self.reference.errors, self.runs[method].errors
        reductions = {}
        for name in ("E_car", "E_max"):
            both = {kind: reduction_percent(getattr(getattr(before, kind), name), getattr(getattr(after, kind), name))
                    for kind in ("time_matched", "aligned")}
            reductions[name] = {**both, "weaker": min(both.values())}
        return reductions

    def motor_reduction(self, method: str) -> dict[str, float]:
        """Reduction of the aligned error of the motor angles [%], without gear deflection, as [G] could measure it."""
        before, after = (run.played.motor_errors.aligned for run in (self.reference, self.runs[method]))
        return {name: reduction_percent(getattr(before, name), getattr(after, name)) for name in ("E_car", "E_max")}

    def json(self) -> dict[str, Any]:
        """The content of ``--json``: the runs stand under ``methods``."""
        return {
            **self.scene.played(),
            "speed_m_s": self.scene.speed,
            "methods": {method: {**run.json(), "reduction_percent": self.reduction(method),
                                 "motor_aligned_reduction_percent": self.motor_reduction(method)}
                        for method, run in self.runs.items()},
            "learning_criterion_mrad": [1e3 * value for value in self.learning_criterion],
            "paper": self.scene.paper.model_dump(),
            "recording": {method: run.recording_path for method, run in self.runs.items()},
            "urdf": next(iter(self.runs.values())).urdf,
            "report": self.report,
        }

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """The methods as a table for a terminal: errors at the tool and of the motor angles, and reductions."""
        paper = self.scene.paper.E_car_reduction_percent
        columns = ["method", "E_car [mm]", "aligned E_car [mm]", "aligned E_max [mm]", "E_car less [%]",
                   "motors' E_car [mm]", "motors' E_max [mm]", "paper: E_car less [%]"]
        return columns, [[method, 1e3 * run.errors.time_matched.E_car, 1e3 * run.errors.aligned.E_car,
                          1e3 * run.errors.aligned.E_max, self.reduction(method)["E_car"]["weaker"],
                          1e3 * run.played.motor_errors.aligned.E_car, 1e3 * run.played.motor_errors.aligned.E_max,
                          paper.get(method)] for method, run in self.runs.items()]

    def full_table(self) -> tuple[list[str], list[list[Any]]]:
        """The methods as a table: errors in mm, reductions in per cent, beside those of the paper."""
        columns = ["method", "E_car t.-m. mm", "aligned", "geometric", "E_max t.-m. mm", "aligned", "delay ms",
                   "E_car less %", "E_max less %", "motors' E_car less %", "paper E_car %", "paper E_max %"]
        paper = self.scene.paper
        rows = []
        for method, run in self.runs.items():
            e, less = run.errors, self.reduction(method)
            rows.append([
                method, 1e3 * e.time_matched.E_car, 1e3 * e.aligned.E_car, 1e3 * e.geometric.E_car,
                1e3 * e.time_matched.E_max, 1e3 * e.aligned.E_max, 1e3 * e.delay, less["E_car"]["weaker"],
                less["E_max"]["weaker"], self.motor_reduction(method)["E_car"],
                paper.E_car_reduction_percent.get(method), paper.E_max_reduction_percent.get(method)])
        return columns, rows


def compare_paths(scene: PathScene, methods: Sequence[SceneMethod], *, progress: Progress = silent) -> PathComparison:
    """Runs the scene's path with each method; reductions are relative to no correction without planner's delay.

    That is the smaller error of the two uncorrected runs, so the stricter measure.

    Args:
        scene: the scene.
        methods: in the order of the table; a key with ``-delay`` keeps the planner's delay in force.
        progress: called with the fraction done.
    """
    runs: dict[str, PathResult] = {}
    criterion: tuple[float, ...] = ()
    for delay in (False, True):
        group = [method for method in methods if method.key.endswith(DELAY) is delay]
        if not group:
            continue
        cell = set_up(scene, delay=delay)
        for method in group:
            share = len(runs) / len(methods)
            progress(share, method.key)
            runs[method.key] = play_method(scene, cell, method, part_of(progress, share, 1 / len(methods), method.key))
        if not delay and any(method.key in _ON_THE_ARM for method in group):
            criterion = cell.learned().criterion
    return PathComparison(scene, runs, criterion)
