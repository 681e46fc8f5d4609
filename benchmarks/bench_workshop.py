"""What stands between the kind world of the scene `line` and a workshop: each cause alone, then all (scene `workshop`).

    python benchmarks/bench_workshop.py [--seeds 3] [--individual 1]

The world of an individual with kinematic errors is another one to the identification too, so models are its own.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from scenes import load_scene
from scenes.line.kind import run
from scenes.options import chosen


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--individual", type=int)
    options = parser.parse_args()
    workshop, line = load_scene("workshop"), load_scene("line")
    tables = workshop.model_dump()
    kinds = {"worn: gaps": ("gap",), "scratch and crossing": ("scratch", "crossing"),
             "glare and shade": ("glare", "shade")}
    causes: dict[str, dict[str, Any]] = {
        "none (`line`)": {},
        "kinematic errors, 0.3 mm and 0.02°": {"world": tables["world"]},
        "surface off by 3 mm": {"displacement": {"height_mm": 3.0}},
        "surface tilted by 1°": {"displacement": {"tilt_deg": 1.0}},
        "wider, paler line": {"line": {"width_mm": workshop.line.width_mm, "gray": workshop.line.gray}},
        **{name: {"feature": [one for one in tables["feature"] if one["kind"] in which]}
           for name, which in kinds.items()},
        "fields jittered and lost": {"camera": {"jitter": workshop.camera.jitter, "loss": workshop.camera.loss}},
    }
    print(f"| cause | mean mm, seeds 1 to {options.seeds} | largest mm | fields used, least |")
    print("| --- | --- | --- | --- |")
    scenes = {name: line.changed(**change) for name, change in causes.items()} | {"all (`workshop`)": workshop}
    for name, scene in scenes.items():
        runs = [run(chosen(scene, seed=seed, individual=options.individual)) for seed in range(1, options.seeds + 1)]
        means = ", ".join("failed" if one.failure else f"{1e3 * one.control_error.mean:.3f}" for one in runs)
        print(f"| {name} | {means} | {1e3 * np.max([one.control_error.max for one in runs]):.2f} | "
              f"{min(one.fields_used for one in runs)} |", flush=True)


if __name__ == "__main__":
    main()
