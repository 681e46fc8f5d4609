"""A tool 2 kg heavier than told, a cold start, a camera knocked midway: adapted beside the run that knew.

    python benchmarks/adapted_and_knew.py [--seeds 2] [--individual 1]

Scene `line` in the workshop at 0.7 m/s. Who *knew* has the model that the arm's identification motions gave with that
tool on, or at that temperature; the camera was knocked before its calibration. Who *adapts* has the arm's model of
before, warm and without the tool, and learns on the way. Wanted: at most 1.3 times the mean error of who knew.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.line.kind import run
from scenes.methods import ADAPTED, IDEAL
from scenes.models import own_model
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import OWN, chosen

CHANGES: dict[str, dict[str, Any]] = {
    "nothing": {},
    "tool 2 kg heavier than told": {"world": {"payload_mass": 2.0, "payload_com": (0.0, 0.0, -0.08)}},
    "cold start, 20 °C": {"world": {"start_temperature": 20.0}},
    "both": {"world": {"payload_mass": 2.0, "payload_com": (0.0, 0.0, -0.08), "start_temperature": 20.0}},
    "camera knocked by 0.5° midway": {"camera": {"knock_deg": 0.5}},
    "all three": {"world": {"payload_mass": 2.0, "payload_com": (0.0, 0.0, -0.08), "start_temperature": 20.0},
                  "camera": {"knock_deg": 0.5}},
}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--individual", type=int, default=1)
    options = parser.parse_args()
    line = chosen(load_scene("line"), individual=options.individual)
    before = own_model(line, Robot.load(line.robot))
    seeds = range(1, options.seeds + 1)
    print(f"| change | knew, mean mm, seeds 1 to {options.seeds} | adapted | adapted / knew | not adapted |")
    print("| --- | --- | --- | --- | --- |")
    for name, change in CHANGES.items():
        changed = line.changed(**change)
        # A knock that is over before calibration is a camera mounted otherwise: the same as none.
        knowing = changed.changed(model=OWN, camera={"knock_deg": 0.0})
        knew = played(knowing, IDEAL, seeds)
        adapted = played(changed.changed(model=before), ADAPTED, seeds)
        fixed = played(changed.changed(model=before), IDEAL, seeds)
        cells = [", ".join(f"{value:.3f}" for value in values) for values in (knew, adapted, fixed)]
        print(f"| {name} | {cells[0]} | {cells[1]} | {np.mean(adapted) / np.mean(knew):.2f} | {cells[2]} |", flush=True)


def played(scene: LineScene, method: str, seeds: range) -> list[float]:
    """Mean error of each seed [mm]; NaN where the run failed."""
    results = [run(scene.changed(seed=seed), method=method) for seed in seeds]
    return [float("nan") if one.failure else 1e3 * one.control_error.mean for one in results]


if __name__ == "__main__":
    main()
