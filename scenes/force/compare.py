"""One force scene, several methods side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenes.force.cell import Prepared
from scenes.force.play import ForceResult, play
from scenes.methods import DIRECT, IDEAL, GainSearch, GainTrial, SceneMethod
from scenes.result import Progress, ShownTable, silent
from scenes.scene_files.force_scene import ForceScene

PROPORTIONAL = (0.04, 0.08, 0.13, 0.17, 0.21, 0.26)
"""K_p tried, as shares of 1/E per cycle: 1 would take the whole error away in one cycle, did nothing delay it."""
DIFFERENTIAL = (0.25, 0.5, 1.0)
"""K_d tried with the best K_p and its neighbours, as shares of 1/E."""


def best_gains(scene: ForceScene, shared: Prepared, *, progress: Progress = silent
               ) -> tuple[tuple[float, float], tuple[GainTrial, ...]]:
    """K_p [m/N per cycle] and K_d [m/N] with the smallest RMS force error [N] in this scene, and all trials.

    Args:
        scene: the scene in which they are searched.
        shared: of the scene.
        progress: called with the fraction done.
    """
    def rms(k_p: float, k_d: float) -> float:
        result = play(scene, DIRECT, (k_p, k_d), shared=shared)
        return result.figures.rms if result.failure is None else float("inf")

    search = GainSearch(rms, len(PROPORTIONAL) + 2 * len(DIFFERENTIAL), progress)
    unit = 1.0 / scene.tip.stiffness
    search.scan([share * unit for share in PROPORTIONAL])
    for trial in search.ranked()[:2]:
        search.scan([trial.k_p], [share * unit for share in DIFFERENTIAL])
    best = search.best()
    return (best.k_p, best.k_d), tuple(search.trials)


TROUBLES: dict[str, dict[str, Any]] = {
    "10 Hz": {"camera": {"rate": 10.0}},
    "100 ms of loss": {"trouble": {"loss": (1.5, 1.6)}},
    "0.5 s of garbage": {"trouble": {"garbage": (1.5, 2.0)}},
}
"""What a ``glue`` scene is tried with besides: changes of the scene."""


@dataclass(frozen=True, repr=False)
class ForceComparison(ShownTable):
    """The results of all methods on one scene."""

    scene: ForceScene
    runs: dict[str, ForceResult]
    trials: tuple[GainTrial, ...]
    troubles: tuple[tuple[str, ForceResult], ...] = ()
    """For ``glue``: the ideal robot with a camera in trouble."""
    report: Path | None = None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return {**self.scene.played(), "speed_m_s": self.scene.speed,
                "methods": {method: run.json() for method, run in self.runs.items()},
                "direct_feedback_search": [{"k_p": one.k_p, "k_d": one.k_d, "rms_N": one.error} for one in self.trials],
                "camera_troubles": {name: run.json() for name, run in self.troubles}, "report": self.report}

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """The methods as a table: titles, and one row per method."""
        columns = ["method", "RMS force error [N]", "largest [N]", "least [N]", "contact lost [ms]", "stopped because"]
        rows: list[list[Any]] = [
            [run.method, run.figures.rms, run.figures.largest, run.figures.least, 1e3 * run.figures.lost,
             "" if run.failure is None else run.failure] for run in self.runs.values()]
        if self.scene.task == "glue":
            columns.insert(1, "mean distance from the line [mm]")
            for row, run in zip(rows, self.runs.values(), strict=True):
                row.insert(1, run.lateral.get("control_error_mm", {}).get("mean", float("nan")))
        return columns, rows


def compare_forces(scene: ForceScene, methods: Sequence[SceneMethod], *, progress: Progress = silent
                   ) -> ForceComparison:
    """Runs the scene with each method, direct feedback at its best gains.

    They are searched again even where the scene file has gains: the table has to be fair in this scene, speed and seed.

    Args:
        scene: the scene.
        methods: in the order of the table.
        progress: called with the fraction done.
    """
    gains: tuple[float, float] | None = None
    shared = Prepared(scene)
    trials: tuple[GainTrial, ...] = ()
    if any(method.key == DIRECT for method in methods):
        gains, trials = best_gains(scene, shared, progress=lambda part, text: progress(0.7 * part, text))
    runs = {}
    for i, method in enumerate(methods):
        progress(0.7 + 0.3 * i / len(methods), method.key)
        runs[method.key] = play(scene, method, gains, shared=shared)
    troubles = []
    for name, changes in TROUBLES.items() if scene.task == "glue" else ():
        progress(0.9, f"camera: {name}")
        troubles.append((name, play(scene.changed(**changes), IDEAL,
                                    shared=None if "camera" in changes else shared)))
    return ForceComparison(scene, runs, trials, tuple(troubles))
