"""Both line detectors on the same pictures: error of the points, refusals, and points that are wrong but accepted.

    python -m benchmarks.compare_detectors [--fields 300] [--many 10000] [--seeds 1,2,3] [--json FILE]

Each disturbance alone, then, for each seed, all at once on ``--many`` fields of lines drawn anew every 250 fields.
Line, poses and predictions as in ``bench_camera.py``: the prediction is ±1 mm off and believed to 1 mm. Exposure 2 ms
at 0.7 m/s, noise of 3 gray values. Errors: distance of each used point from the analytic line.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_camera import AHEAD, UP, clutter, over, sine
from ideal_robot.arrays import Array
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_detection import DetectionSettings, PredictedLine, search_windows
from sensing.camera.opencv_detector import DETECTORS
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.surface import DrawnLine, Feature

SPEED = 0.7
REDRAWN = 250
USUAL = CameraSettings(exposure=0.002, noise=3.0, jitter=0.0, stamp_noise=0.0)

Drawn = Callable[[np.random.Generator], DrawnLine]


def on(kind: str, drawn: Drawn) -> Drawn:
    """The same on another surface."""
    return lambda rng: replace(drawn(rng), grain=kind, grain_seed=int(rng.integers(2**31)))


def clean(rng: np.random.Generator) -> DrawnLine:
    """The line alone."""
    return sine()


def with_features(*kinds: str) -> Drawn:
    """A line with some kinds of the clutter."""
    return lambda rng: sine(tuple(one for one in clutter(rng) if one.kind in kinds))


def shadow(rng: np.random.Generator) -> DrawnLine:
    """Hard edges of shadows across the line and along it, every 0.2 m."""
    return sine(shadows(rng))


def shadows(rng: np.random.Generator) -> tuple[Feature, ...]:
    """Broad dark strokes with the line's own soft edge."""
    return tuple(Feature("scratch", at, length=0.3, width=rng.uniform(0.01, 0.05), gray=rng.uniform(90.0, 150.0),
                         angle=rng.uniform(0.0, np.pi), offset=rng.uniform(-0.02, 0.02))
                 for at in np.arange(0.1, 1.0, 0.2))


def worn(line: DrawnLine, rng: np.random.Generator) -> DrawnLine:
    """Width ±20 %, ink that has lost up to half of its contrast."""
    phase = rng.uniform(0.0, 2.0 * np.pi, 2)
    wide, pale = (np.sin(2.0 * np.pi * line.s / 0.15 + one) for one in phase)
    return replace(line, widths=line.width * (1.0 + 0.2 * wide),
                   grays=line.gray + 0.25 * (1.0 + pale) * (line.background - line.gray))


def everything(rng: np.random.Generator) -> DrawnLine:
    """All of it on one line."""
    return worn(sine((*clutter(rng), *shadows(rng))), rng)


@dataclass(frozen=True)
class Case:
    """One disturbance: what is drawn, and how the camera looks."""

    name: str
    drawn: Drawn = clean
    settings: CameraSettings = USUAL


CASES = (
    Case("none"),
    Case("width ±20 %, ink faded by up to a half", lambda rng: worn(sine(), rng)),
    Case("gaps", with_features("gap")),
    Case("glare", with_features("glare")),
    Case("shade", with_features("shade")),
    Case("edges of shadow", shadow),
    Case("crossing and parallel lines", with_features("crossing", "parallel")),
    Case("scratches", with_features("scratch")),
    Case("brushed metal", on("metal", clean)),
    Case("wood", on("wood", clean)),
    Case("paper", on("paper", clean)),
    Case("exposure 8 ms (5.6 mm of way)", settings=replace(USUAL, exposure=0.008, sub_exposures=9)),
)
ALL = Case("all of them, on wood", on("wood", everything))


def played(case: Case, count: int, seed: int) -> dict[str, tuple[list[Array], int]]:
    """For each detector the errors of the used points of each field [m], and how many fields it refused."""
    rng = np.random.default_rng(seed)
    model, detectors = CameraModel.default(), {name: DETECTORS.get(name)() for name in DETECTORS.names()}
    found: dict[str, tuple[list[Array], int]] = {name: ([], 0) for name in detectors}
    for first in range(0, count, REDRAWN):
        line = case.drawn(rng)
        with RenderedCamera(model, line, case.settings, rng) as camera:
            for i in range(min(REDRAWN, count - first)):
                s, aside, turn = rng.uniform(0.02, line.length - 0.15), rng.uniform(-3e-3, 3e-3), rng.uniform(-2, 2)
                t = case.settings.phase + i / case.settings.rate

                def pose_at(time: float, s: float = s, t: float = t, aside: float = aside, turn: float = turn) -> Any:
                    return over(line, s + SPEED * (time - t), aside, radians(turn))  # noqa: B023

                points, tangents = line.at(s + AHEAD)
                told = pose_at(t)
                prediction = PredictedLine.from_base(points + rng.uniform(-1e-3, 1e-3) * np.cross(UP, tangents),
                                                     tangents, UP, told, 0.001)
                field = camera.windows(t, pose_at, search_windows(model, prediction))
                for name, detector in detectors.items():
                    seen = detector.detect(field, model, prediction, DetectionSettings())
                    errors, refused = found[name]
                    if seen.seen:
                        used = seen.points_tcp[seen.used] @ told.rotation.T + told.translation
                        errors.append(line.distance(used))
                    found[name] = errors, refused + int(not seen.seen)
    return found


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--fields", type=int, default=300)
    parser.add_argument("--many", type=int, default=10_000)
    parser.add_argument("--seeds", default="1", help="of the many fields; the single disturbances have seed 1")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    print("| disturbance | detector | mean µm | 95 % µm | max µm | refused % | points > 0.2 mm, % | points > 1 mm |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    many = [(ALL, options.many, int(seed)) for seed in options.seeds.split(",")]
    single = [(case, options.fields, 1) for case in CASES] if options.fields else []
    for case, count, seed in [*single, *many]:
        for name, (errors, refused) in played(case, count, seed).items():
            e = 1e6 * np.concatenate([np.empty(0), *errors])
            if not len(e):
                e = np.array([np.nan])
            row = {"disturbance": case.name, "detector": name, "fields": count, "seed": seed, "points": len(e),
                   "mean_um": float(e.mean()),
                   "p95_um": float(np.percentile(e, 95)), "max_um": float(e.max()), "refused": refused / count,
                   "wrong": float(np.mean(e > 200)), "beyond_1_mm": int(np.sum(e > 1000))}
            rows.append(row)
            which = f"{case.name}, {count} fields" + (f", seed {seed}" if case is ALL else "")
            print(f"| {which} | `{name}` | {row['mean_um']:.0f} | {row['p95_um']:.0f} | "
                  f"{row['max_um']:.0f} | {100 * refused / count:.1f} | {100 * float(np.mean(e > 200)):.2f} | "
                  f"{row['beyond_1_mm']} |", flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
