"""Every method on the line of the workshop, with and without adaptation and with one desired position: table, picture.

    python benchmarks/line_methods.py [--seed 1] [--speed 0.7] [--figure docs/pictures/line_methods.png]

Direct sensor feedback has the best gains that a search on this very scene finds. ``n_d = 1`` is the ideal robot that is
given the next desired position alone ([L] 2.3); raw points are the map fed with single points, the other methods'
camera gives a polynomial.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from scenes import load_scene
from scenes.line.cell import prepared
from scenes.line.compare import best_gains
from scenes.line.play import play
from scenes.line.result import LineResult
from scenes.methods import ADAPTED, DIRECT, IDEAL, NONE, SENSOR_PATH
from scenes.scene_files.scene import chosen

TITLES = {"none": "none", "direct_feedback": "direct feedback, best gain", "sensor_path": "sensor path, no model",
          "ideal_points": "ideal, raw points", "ideal": "ideal, polynomial", "adapted": "ideal, adapted",
          "ideal, n_d = 1": "ideal, n_d = 1"}
COLOURS = {"none": "#8893a1", "direct_feedback": "#0a6ebd", "sensor_path": "#2b8a3e", "ideal_points": "#1c2430",
           "ideal": "#e06a00", "adapted": "#7d3c98", "ideal, n_d = 1": "#c2255c"}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--speed", type=float)
    parser.add_argument("--figure", type=Path, default=Path("docs/pictures/line_methods.png"))
    options = parser.parse_args()
    scene = chosen(load_scene("line"), seed=options.seed, speed=options.speed)
    keys = (NONE, DIRECT, SENSOR_PATH, "ideal_points", IDEAL, ADAPTED)
    with prepared(scene) as shared:
        gains, _ = best_gains(scene, shared)
        runs = {key: play(scene, key, shared=shared, gains=gains) for key in keys}
        runs["ideal, n_d = 1"] = play(scene.changed(n_d=1), IDEAL, shared=shared)
    print(f"seed {options.seed}, {scene.speed:g} m/s; direct feedback: K_p = {gains[0]:.3g}, K_d = {gains[1]:.3g}\n")
    print("| method | mean mm | 95 % mm | max mm | fields used |\n| --- | --- | --- | --- | --- |")
    for key, run in runs.items():
        error = run.control_error.json_mm()
        print(f"| {TITLES[key]} | {error['mean']:.3f} | {error['p95']:.3f} | {error['max']:.3f} | "
              f"{run.fields_used} of {run.fields_seen} |{' ended early' if run.failure else ''}")
    options.figure.parent.mkdir(parents=True, exist_ok=True)
    picture(runs).savefig(options.figure, dpi=120, bbox_inches="tight")
    print(f"figure: {options.figure}")


def picture(runs: dict[str, LineResult]) -> Figure:
    """Distance from the line along the line, on two scales, and each method's mean."""
    figure = Figure(figsize=(9.0, 5.6))
    axes = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
    for key, run in runs.items():
        error = run.control_error
        s, lateral = error.s, 1e3 * error.lateral
        for one in axes:
            one.plot(s, lateral, color=COLOURS[key], lw=1.1,
                     label=f"{TITLES[key]}: {1e3 * error.mean:.2f} mm")
    axes[0].set_title("Distance of the tool from the drawn line, and its mean", loc="left", fontsize=10)
    axes[0].set_ylabel("mm")
    axes[1].set_ylabel("the same, enlarged [mm]")
    axes[1].set_ylim(-1.2, 1.2)
    axes[1].set_xlabel("way along the line [m]")
    for one in axes:
        one.axhline(0.0, color="#1c2430", lw=0.5)
        one.spines[["top", "right"]].set_visible(False)
    ends = np.concatenate([run.control_error.s[[0, -1]] for run in runs.values() if len(run.control_error.s)])
    axes[1].set_xlim(float(ends.min()), float(ends.max()))
    axes[0].legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.0))
    return figure


if __name__ == "__main__":
    main()
