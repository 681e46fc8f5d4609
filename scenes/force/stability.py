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

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.results import Summarised
from ideal_robot.whole_file import whole_file
from scenes.force.play import play
from scenes.report.page import Report, write_json
from scenes.result import Progress, silent
from scenes.scene_file import load_scene
from scenes.terminal import progress_bar

ELASTICITY = (0.25, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.25, 1.6, 2.5, 4.0)
DISTANCE = (0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.25, 1.6, 2.5)
WORSE = 3.0
"""A run counts as stable if it is done and its error is below this many times that with the right value, plus …"""
FREE = {"elasticity": 4.0, "distance": 0.5}
"""… this much, which costs accuracy but not stability [N, mm]."""


@dataclass(frozen=True)
class StabilityPoint:
    """One run: what was assumed wrongly, by which ratio, estimated on the way or not, and the error (N or mm)."""

    quantity: str
    estimated: bool
    ratio: float
    error: float
    stable: bool
    reason: str


@dataclass(frozen=True, repr=False)
class StabilityMap(Summarised):
    """The measured range of both ratios."""

    points: tuple[StabilityPoint, ...]

    def summary(self) -> list[tuple[str, str]]:
        """The stable range of each ratio."""
        ranges = [(f"{quantity}{' with estimation' if estimated else ''}",
                   " to ".join(f"{bound:g}" for bound in self.bounds(quantity, estimated)))
                  for quantity in FREE for estimated in (False, True)]
        return [("runs", f"{len(self.points)} runs"), *ranges]

    def of(self, quantity: str, estimated: bool) -> list[StabilityPoint]:
        """The runs of one curve."""
        return [one for one in self.points if one.quantity == quantity and one.estimated is estimated]

    def bounds(self, quantity: str, estimated: bool) -> tuple[float, float]:
        """Smallest and largest ratio of the stable range around 1."""
        points = sorted(self.of(quantity, estimated), key=lambda one: one.ratio)
        low = high = 1.0
        for one in [one for one in points if one.ratio <= 1][::-1]:
            if not one.stable:
                break
            low = one.ratio
        for one in (one for one in points if one.ratio >= 1):
            if not one.stable:
                break
            high = one.ratio
        return low, high

    def json(self) -> dict[str, Any]:
        """All ranges and every run."""
        ranges = {f"{quantity}{'_estimated' if estimated else ''}": self.bounds(quantity, estimated)
                  for quantity in FREE for estimated in (False, True)}
        return {"stable": ranges, "runs": [vars(one) for one in self.points]}


def stability_map(*, elasticity: tuple[float, ...] = ELASTICITY, distance: tuple[float, ...] = DISTANCE,
                  progress: Progress = silent) -> StabilityMap:
    """Plays short versions of ``force_wave`` and ``glue`` with wrong assumptions.

    Args:
        elasticity: assumed over true elasticity of the contact, 1 among them.
        distance: assumed over true distance of the camera, 1 among them.
        progress: called with the share that is done.
    """
    cases = [("elasticity", "force_wave", 0.4, elasticity), ("distance", "glue", 0.5, distance)]
    total = 2 * (len(elasticity) + len(distance))
    points: list[StabilityPoint] = []
    for quantity, name, length, ratios in cases:
        scene = load_scene(name).changed(line={"length": length})
        for estimated in (False, True):
            runs: list[tuple[float, float, str]] = []
            for ratio in ratios:
                progress((len(points) + len(runs)) / total, f"{quantity} × {ratio:g}")
                assumed = {f"{quantity}_ratio": ratio, f"{quantity}_estimated": estimated}
                result = play(scene.changed(assumed=assumed), "ideal")  # type: ignore[arg-type]
                error = result.figures.rms
                if quantity == "distance":
                    error = result.lateral.get("control_error_mm", {}).get("mean", float("nan"))
                runs.append((ratio, float(error), result.failure or ""))
            best = next(error for ratio, error, _ in runs if ratio == 1.0)
            points += [StabilityPoint(quantity, estimated, ratio, error, bool(
                not why and np.isfinite(error) and error < WORSE * best + FREE[quantity]), why)
                for ratio, error, why in runs]
    return StabilityMap(tuple(points))


def stability_page(found: StabilityMap) -> Report:
    """The figure and the table."""
    page = Report("Stability against wrong assumptions", _summary(found))
    page.figure(stability_figure(found), "Circles: stable; crosses: oscillating, or stopped by the watch (at the upper "
                "edge).")
    page.table(["assumed wrongly", "estimated", "ratio", "error [N or mm]", "stable", "stopped because"],
               [[one.quantity, one.estimated, one.ratio, one.error, one.stable, one.reason] for one in found.points])
    return page


def _summary(found: StabilityMap) -> str:
    e, d = found.bounds("elasticity", True), found.bounds("distance", True)
    return (f"Estimated on the way, stable for an assumed elasticity of {e[0]:g} to {e[1]:g} times the true one and an "
            f"assumed distance of {d[0]:g} to {d[1]:g} times the true one.")


def stability_figure(found: StabilityMap) -> Figure:
    """Error over the ratio of assumed to true, both quantities."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    units = {"elasticity": "RMS force error [N]", "distance": "mean lateral error [mm]"}
    for axis, quantity in zip(figure.subplots(1, 2), units, strict=True):
        good = [one.error for one in found.points if one.quantity == quantity and one.stable]
        top = 4 * max(good, default=1.0)
        for estimated, colour in ((False, "#1f5fa8"), (True, "#e06000")):
            points = found.of(quantity, estimated)
            shown = [min(one.error, top) if np.isfinite(one.error) else top for one in points]
            axis.plot([one.ratio for one in points], shown, color=colour, lw=0.8,
                      label="estimated on the way" if estimated else "taken as assumed")
            for one, value in zip(points, shown, strict=True):
                axis.plot(one.ratio, value, "o" if one.stable else "x", color=colour)
        axis.set_xscale("log")
        axis.set_xticks([0.25, 0.5, 1.0, 2.0, 4.0], ["1/4", "1/2", "1", "2", "4"])
        axis.minorticks_off()
        axis.set_xlabel(f"assumed / true {quantity}")
        axis.set_ylabel(units[quantity])
        axis.grid(alpha=0.3)
        axis.legend()
    return figure


def main(out: str = "out/stability") -> None:
    """``python -m scenes.force.stability``: measures the map and writes its page and JSON."""
    with progress_bar("stability") as progress:
        found = stability_map(progress=progress)
    write_json(Path(out) / "stability.json", found.json())
    with whole_file(Path(out) / "stability.png") as partial:
        stability_figure(found).savefig(partial, dpi=90)
    print(f"stable: {found.json()['stable']}\nreport: {stability_page(found).write(Path(out) / 'report.html')}")


if __name__ == "__main__":
    main()
