"""What stands between the kind bench and the workshop, on the scene `line`: each cause alone, then all.

    python benchmarks/bench_workshop.py [--seeds 3] [--individual 1]

The world of an individual with kinematic errors is another one to the identification too, so models are its own.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from scenes import load_scene
from scenes.line.kind import run
from scenes.line.result import LineResult
from scenes.scene_files.scene import chosen


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--individual", type=int)
    options = parser.parse_args()
    workshop = load_scene("line")
    line, wear = workshop.changed(world="bench"), workshop.workshop["wear"]
    camera = workshop.workshop["camera"]
    causes: dict[str, dict[str, Any]] = {
        "none (`bench`)": {},
        "kinematic errors, 0.3 mm and 0.02°": {"world": workshop.arm_world},
        "surface off by 3 mm": {"displacement": {"height_mm": 3.0}},
        "surface tilted by 1°": {"displacement": {"tilt_deg": 1.0}},
        "rendered, tool and hose in the picture": {"camera": {"renderer": "bullet"}},
        "the same, surface bent by 1 mm": {"displacement": {"bow_mm": 1.0}, "camera": {"renderer": "bullet"}},
        "width and ink of the line": {"wear": {key: wear[key] for key in ("width_percent", "fade_percent")}},
        "gaps": {"wear": {"gaps": wear["gaps"]}},
        "scratch and crossing": {"wear": {key: wear[key] for key in ("scratches", "crossings")}},
        "glare and shade": {"wear": {key: wear[key] for key in ("glares", "shades")}},
        "lamp: falloff, the arm's shadow, mirror image": {"light": workshop.workshop["light"]},
        "exposure that lags": {"camera": {"auto_exposure": camera["auto_exposure"]}},
        "fields jittered, lost and doubled": {"camera": {key: camera[key] for key in ("jitter", "loss", "doubled")}},
    }
    print(f"| cause | mean mm, seeds 1 to {options.seeds} | largest mm | fields used, least | "
          "constant beside the line mm | tool above the surface mm |")
    print("| --- | --- | --- | --- | --- | --- |")
    scenes = {name: line.changed(**change) for name, change in causes.items()} | {"all (`workshop`)": workshop}
    for name, scene in scenes.items():
        runs = [run(chosen(scene, seed=seed, individual=options.individual)) for seed in range(1, options.seeds + 1)]
        means = ", ".join("failed" if one.failure else f"{1e3 * one.control_error.mean:.3f}" for one in runs)
        constants = ", ".join(f"{1e3 * np.mean(one.control_error.lateral):.3f}" for one in runs)
        heights = ", ".join(f"{1e3 * _height(one):.2f}" for one in runs)
        print(f"| {name} | {means} | {1e3 * np.max([one.control_error.max for one in runs]):.2f} | "
              f"{min(one.fields_used for one in runs)} | {constants} | {heights} |", flush=True)


def _height(result: LineResult) -> float:
    """Mean height of the true tool above the even surface while the error counts [m]."""
    columns, plane = result.recording.columns, result.geometry.plane
    counts = np.isin(np.round(columns["t"], 6), np.round(result.control_error.t, 6))
    tcp = np.column_stack([columns[axis][counts] for axis in "xyz"])
    return float(np.mean((tcp - plane.translation) @ plane.rotation[:, 2]))


if __name__ == "__main__":
    main()
