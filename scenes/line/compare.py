"""One line, every method; and how much gain direct sensor feedback can take with a late camera ([L] 4.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenes.line.result import LineResult
from scenes.line.scene import LineScene
from scenes.result import Progress, silent

if TYPE_CHECKING:
    from scenes.line.cell import Prepared

K_P = (0.01, 0.02, 0.03, 0.045, 0.065, 0.09, 0.13, 0.18, 0.25)
"""Gains tried on the deviation, per cycle."""
K_D = (0.0, 0.3, 1.0)
"""Gains tried on its change, at the best K_p."""
OVERSHOOT = 0.05
"""Overshoot over a sideways step that counts as overshooting, relative to the step."""


@dataclass(frozen=True)
class LineComparison:
    """Every method on the same scene.

    Attributes:
        scene: what was played.
        runs: method → result.
        gains: K_p, K_d of direct sensor feedback, found by search.
        tried: every pair of gains tried, with the mean error it left [m].
        overshoot_gain: largest K_p whose overshoot over a sideways step stays below 5 %.
        overshoots: K_p → overshoot relative to the step.
    """

    scene: LineScene
    runs: dict[str, LineResult]
    gains: tuple[float, float]
    tried: tuple[tuple[float, float, float], ...]
    overshoot_gain: float
    overshoots: tuple[tuple[float, float], ...]
    report: Path | None = field(default=None)

    def json(self) -> dict[str, Any]:
        """The content of ``--json``: the runs stand under ``methods``."""
        return {
            "scene": self.scene.name,
            "speed_m_s": self.scene.speed,
            "seed": self.scene.seed,
            "methods": {method: run.json() for method, run in self.runs.items()},
            "direct_feedback": {
                "k_p": self.gains[0],
                "k_d": self.gains[1],
                "largest_k_p_without_overshoot": self.overshoot_gain,
                "overshoot_of_k_p": [{"k_p": k, "overshoot": o} for k, o in self.overshoots],
                "tried": [{"k_p": p, "k_d": d, "mean_mm": 1e3 * e} for p, d, e in self.tried],
            },
            "recording": {method: run.recording_path for method, run in self.runs.items()},
            "urdf": next(iter(self.runs.values())).urdf,
            "report": self.report,
        }

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


Run = Callable[..., LineResult]


def compare_lines(scene: LineScene, run: Run, *, out: Path | None = None,
                  progress: Progress = silent) -> LineComparison:
    """Runs all methods; direct sensor feedback with the gain that suits this very scene best."""
    from scenes.line.cell import prepared
    from scenes.line.play import METHODS

    gain, overshoots = overshoot_gain(scene, progress=lambda fraction, text: progress(0.35 * fraction, text))
    runs = {}
    with prepared(scene) as shared:
        gains, tried = best_gains(scene, shared, progress=lambda part, text: progress(0.35 + 0.4 * part, text))
        for i, method in enumerate(METHODS):
            runs[method] = run(scene, method=method, shared=shared,
                               gains=gains if method == "direct_feedback" else None,
                               progress=lambda part, text, i=i: progress(0.75 + 0.06 * (i + part), text))
    comparison = LineComparison(scene, runs, gains, tried, gain, overshoots)
    if out is None:
        return comparison
    from scenes.line.page import write_comparison

    return write_comparison(comparison, out)


def best_gains(scene: LineScene, shared: Prepared, *, progress: Progress = silent
               ) -> tuple[tuple[float, float], tuple[tuple[float, float, float], ...]]:
    """K_p and K_d of direct sensor feedback with the least mean error on this scene, and all that was tried."""
    from scenes.line.play import run

    tried: list[tuple[float, float, float]] = []
    total = len(K_P) + 2 + len(K_D) - 1

    def mean(k_p: float, k_d: float) -> float:
        result = run(scene, method="direct_feedback", gains=(k_p, k_d), shared=shared)
        error = result.control_error.mean if result.failure is None else np.inf
        tried.append((k_p, k_d, float(error)))
        progress(len(tried) / total, "searching the gain of direct feedback")
        return float(error)

    errors = [mean(k_p, 0.0) for k_p in K_P]
    best = int(np.nanargmin(errors))
    # Between the neighbours of the best one: two more.
    for other in (best - 1, best + 1):
        if 0 <= other < len(K_P):
            mean(float(np.sqrt(K_P[best] * K_P[other])), 0.0)
    k_p = min(tried, key=lambda one: one[2])[0]
    for k_d in K_D[1:]:
        mean(k_p, k_d * k_p * 4)
    chosen = min(tried, key=lambda one: one[2])
    return (chosen[0], chosen[1]), tuple(tried)


def overshoot_gain(scene: LineScene, *, progress: Progress = silent) -> tuple[float, tuple[tuple[float, float], ...]]:
    """Largest K_p that does not overshoot a sideways step with this camera and this speed.

    The step is a straight line beside its reference by 10 mm; what the TCP does beyond the line is overshoot.
    """
    from scenes.line.cell import prepared
    from scenes.line.play import run

    origin = scene.surface.origin
    step = scene.changed(
        line={"formula": None, "length": None, "svg": None, "corner_radius": 0.0, "points": [(0.0, 0.0), (1.2, 0.0)]},
        surface={"origin": (0.98, -0.6, origin[2]), "heading_deg": 90.0, "tilt_deg": (0.0, 0.0)},
        displacement={"lateral_mm": 10.0, "along_mm": 0.0, "turn_deg": 0.0}, feature=(), reference={"shape": None})
    found = []
    with prepared(step) as shared:
        for i, k_p in enumerate(K_P):
            result = run(step, method="direct_feedback", gains=(k_p, 0.0), shared=shared)
            lateral = result.control_error_from_start.lateral
            found.append((k_p, float(max(0.0, -np.min(lateral * np.sign(lateral[0]))) / abs(lateral[0]))))
            progress((i + 1) / len(K_P), "searching the gain at which direct feedback overshoots")
            if found[-1][1] > 4 * OVERSHOOT:
                break
    below = [k_p for k_p, overshoot in found if overshoot <= OVERSHOOT]
    return (max(below) if below else 0.0), tuple(found)
