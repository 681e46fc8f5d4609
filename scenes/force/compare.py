"""One force scene with every method, direct feedback at the gains that a search finds best for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenes.force.result import ForceResult
from scenes.force.scene import ForceScene
from scenes.result import Progress, silent

PROPORTIONAL = (0.04, 0.08, 0.13, 0.17, 0.21, 0.26)
"""K_p tried, as shares of 1/E per cycle: 1 would take the whole error away in one cycle, did nothing delay it."""
DIFFERENTIAL = (0.25, 0.5, 1.0)
"""K_d tried with the best K_p and its neighbours, as shares of 1/E."""


TROUBLES: dict[str, dict[str, Any]] = {
    "10 Hz": {"camera": {"rate": 10.0}},
    "100 ms of loss": {"trouble": {"loss": (1.5, 1.6)}},
    "0.5 s of garbage": {"trouble": {"garbage": (1.5, 2.0)}},
}
"""What a ``glue`` scene is tried with besides: changes of the scene."""


@dataclass(frozen=True)
class GainTrial:
    """One pair of gains [m/N] and the RMS force error it yields [N]; infinite where the run failed."""

    k_p: float
    k_d: float
    rms: float


@dataclass(frozen=True)
class ForceComparison:
    """A scene with every method."""

    scene: ForceScene
    results: tuple[ForceResult, ...]
    trials: tuple[GainTrial, ...]
    troubles: tuple[tuple[str, ForceResult], ...] = ()
    """For ``glue``: the ideal robot with a camera in trouble."""
    report: Path | None = None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return {"scene": self.scene.name, "speed_m_s": self.scene.speed, "seed": self.scene.seed,
                "methods": {result.method: result.json() for result in self.results},
                "direct_feedback_search": [{"k_p": one.k_p, "k_d": one.k_d, "rms_N": one.rms} for one in self.trials],
                "camera_troubles": {name: one.json() for name, one in self.troubles}, "report": self.report}

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """One row a method."""
        columns = ["method", "RMS force error [N]", "largest [N]", "least [N]", "contact lost [ms]", "stopped because"]
        rows: list[list[Any]] = [
            [one.method, one.figures.rms, one.figures.largest, one.figures.least, 1e3 * one.figures.lost,
             "" if one.failure is None else one.failure] for one in self.results]
        if self.scene.task == "glue":
            columns.insert(1, "mean distance from the line [mm]")
            for row, one in zip(rows, self.results, strict=True):
                row.insert(1, one.lateral.get("control_error_mm", {}).get("mean", float("nan")))
        return columns, rows


def best_gains(scene: ForceScene, *, progress: Progress = silent) -> tuple[tuple[float, float], tuple[GainTrial, ...]]:
    """K_p, K_d of direct force feedback with the smallest RMS error in this scene, and all that was tried."""
    from scenes.force.play import play

    trials: list[GainTrial] = []
    total = len(PROPORTIONAL) + 2 * len(DIFFERENTIAL)

    def attempt(k_p: float, k_d: float) -> None:
        progress(len(trials) / total, "tuning direct feedback")
        result = play(scene, "direct_feedback", (k_p, k_d))
        good = result.failure is None and np.isfinite(result.figures.rms)
        trials.append(GainTrial(k_p, k_d, result.figures.rms if good else float("inf")))

    unit = 1.0 / scene.tip.stiffness
    for share in PROPORTIONAL:
        attempt(share * unit, 0.0)
    for one in sorted(trials, key=lambda trial: trial.rms)[:2]:
        for share in DIFFERENTIAL:
            attempt(one.k_p, share * unit)
    best = min(trials, key=lambda trial: trial.rms)
    return (best.k_p, best.k_d), tuple(trials)


def compare_forces(scene: ForceScene, *, out: Path | None = None, progress: Progress = silent) -> ForceComparison:
    """Plays all methods."""
    from scenes.force.play import METHODS, play

    # Searched again even where the scene file has gains: the table has to be fair in this scene, speed and seed.
    gains: tuple[float, float] | None = None
    trials: tuple[GainTrial, ...] = ()
    methods = METHODS if scene.task == "surface" else METHODS[1:]
    if "direct_feedback" in methods:
        gains, trials = best_gains(scene, progress=lambda part, text: progress(0.7 * part, text))
    results = []
    for i, method in enumerate(methods):
        progress(0.7 + 0.3 * i / len(methods), method)
        results.append(play(scene, method, gains))
    troubles = []
    for name, changes in TROUBLES.items() if scene.task == "glue" else ():
        progress(0.9, f"camera: {name}")
        troubles.append((name, play(scene.changed(**changes), "ideal")))
    comparison = ForceComparison(scene, tuple(results), trials, tuple(troubles))
    if out is None:
        return comparison
    from scenes.force.page import write_comparison

    return write_comparison(comparison, out)
