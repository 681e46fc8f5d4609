"""How wrong distance and elasticity may be assumed before sensor-based following becomes unstable ([L] 2.3).

"Stability is touched only when the robot position itself is fed back. This may be the case if the transformation from
sensor values to desired robot positions is totally wrong because of an erroneously assumed distance in image processing
or an incorrectly measured compliance in force control." With the ratio r of assumed to true elasticity, [L] (3) gives

    x̂_a + (F_r − F)/(r E) = x_s + (1 − 1/r)(x_a − x_s)

so the share 1 − 1/r of the arm's own position is fed back: none for r = 1, minus one for r = 1/2. With the ratio of
assumed to true distance, the share is 1 − r: minus one for r = 2. The map that looks ahead makes more of that share
than a plain feedback would; estimating both ratios on the way takes it away again. Both are measured here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from scenes.force.play import play
from scenes.scene_files.force_scene import ForceScene
from studies.report import head, row, scene_of

RATIOS = {"elasticity": (0.25, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.25, 1.6, 2.5, 4.0),
          "distance": (0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.25, 1.6, 2.5)}
"""Of the assumed to the true value."""
SCENES = {"elasticity": ("force_wave", 0.4), "distance": ("glue", 0.5)}
"""Where each is assumed, and length of the line [m]."""
UNITS = {"elasticity": "RMS force error [N]", "distance": "mean lateral error [mm]"}
WORSE = 3.0
"""A run counts as stable if it is done and its error is below this many times that with the right value, plus …"""
FREE = {"elasticity": 4.0, "distance": 0.5}
"""… this much, which costs accuracy but not stability [N, mm]."""


@dataclass(frozen=True)
class StabilityRun:
    """A run with a wrong assumption: its ratio, its error [N or mm], whether it is stable, why it was stopped."""

    ratio: float
    error: float
    stable: bool
    reason: str = ""


def stability(figure: Path | None = None) -> None:
    """Short `force_wave` and `glue` with elasticity and distance assumed wrongly: stable ranges of assumed to true.

    --figure draws the errors over the ratios.
    """
    curves = {(quantity, estimated): curve(quantity, estimated, RATIOS[quantity])
              for quantity in RATIOS for estimated in (False, True)}
    head("assumed wrongly", "estimated on the way", "stable", "error by ratio")
    for (quantity, estimated), runs in curves.items():
        low, high = bounds(runs)
        row(quantity, "yes" if estimated else "no", f"{low:g} to {high:g}",
            "; ".join(f"{one.ratio:g}: {one.reason.partition(';')[0] or f'{one.error:.2f}'}" for one in runs))
    if figure is not None:
        _drawn(curves).savefig(figure, dpi=90)


def curve(quantity: str, estimated: bool, ratios: Sequence[float]) -> list[StabilityRun]:
    """Runs over the ratios, 1 among them, with the ratio estimated on the way or taken as assumed."""
    name, length = SCENES[quantity]
    scene = scene_of(ForceScene, name).changed(line={"length": length})
    runs: list[tuple[float, float, str]] = []
    for ratio in ratios:
        assumed = {f"{quantity}_ratio": ratio, f"{quantity}_estimated": estimated}
        result = play(scene.changed(assumed=assumed), "ideal")
        error = (result.figures.rms if quantity == "elasticity"
                 else result.lateral.get("control_error_mm", {}).get("mean", float("nan")))
        runs.append((ratio, float(error), result.failure or ""))
    most = WORSE * next(error for ratio, error, _ in runs if ratio == 1.0) + FREE[quantity]
    return [StabilityRun(ratio, error, not why and error < most, why) for ratio, error, why in runs]


def bounds(runs: Sequence[StabilityRun]) -> tuple[float, float]:
    """Smallest and largest ratio of the stable range around 1."""
    unstable = [one.ratio for one in runs if not one.stable]
    below, above = max((r for r in unstable if r < 1), default=0.0), min((r for r in unstable if r > 1), default=np.inf)
    inside = [1.0, *(one.ratio for one in runs if below < one.ratio < above)]
    return min(inside), max(inside)


def _drawn(curves: dict[tuple[str, bool], list[StabilityRun]]) -> Figure:
    """Error over the ratio of assumed to true, both quantities; circles are stable, what was stopped is at the top."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    for axis, quantity in zip(figure.subplots(1, 2), RATIOS, strict=True):
        both = (*curves[quantity, False], *curves[quantity, True])
        top = 4 * max((one.error for one in both if one.stable), default=1.0)
        for estimated, colour in ((False, "#1f5fa8"), (True, "#e06000")):
            points = curves[quantity, estimated]
            shown = [min(one.error, top) if np.isfinite(one.error) else top for one in points]
            axis.plot([one.ratio for one in points], shown, color=colour, lw=0.8,
                      label="estimated on the way" if estimated else "taken as assumed")
            for one, value in zip(points, shown, strict=True):
                axis.plot(one.ratio, value, "o" if one.stable else "x", color=colour)
        axis.set_xscale("log")
        axis.set_xticks([0.25, 0.5, 1.0, 2.0, 4.0], ["1/4", "1/2", "1", "2", "4"])
        axis.minorticks_off()
        axis.set_xlabel(f"assumed / true {quantity}")
        axis.set_ylabel(UNITS[quantity])
        axis.grid(alpha=0.3)
        axis.legend()
    return figure
