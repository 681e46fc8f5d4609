"""Force in the workshop: `force_wave` over stiffnesses that nobody told, friction and a bias that drifted.

    python benchmarks/force_workshop.py [--stiffness 2,5,10,20,50] [--methods ideal,direct_feedback] [--seeds 1]
                                        [--glue]

Stiffnesses in N/mm; friction goes from 0.05 at the softest to 0.4 at the stiffest contact, and the sensor's bias has
changed by 0.3 N since its calibration. Direct feedback has the best gains that a search in the same cell finds, and no
emergency stop, so that it has a number where it loses contact. The wanted: RMS at most 1 N and a quarter of direct
feedback's, never above 40 N.
"""

from __future__ import annotations

import argparse

import numpy as np

from scenes import load_scene
from scenes.force.kind import run
from scenes.force.result import ForceResult
from scenes.methods import DIRECT
from scenes.scene_files.force_scene import ForceScene

FRICTION = (0.05, 0.4)
UNSTOPPED = {"force": 1e4, "lost": 60.0}
"""Limits that no run of direct feedback reaches."""
DRIFT = (0.1, -0.1, 0.3, 0.0, 0.0, 0.0)


def contact_scene(stiffness: float, seed: int) -> ForceScene:
    """`force_wave` on a contact of this stiffness [N/mm]."""
    friction = float(np.interp(np.log(stiffness), np.log([2.0, 50.0]), FRICTION))
    return load_scene("force_wave").changed(seed=seed, gains=None, sensor={"drift": DRIFT},
                                            tip={"stiffness": 1e3 * stiffness, "friction": friction})


def row(name: str, result: ForceResult) -> str:
    """One line of the table."""
    figures = result.figures
    assumed, _, true = result.elasticity
    line = result.lateral.get("control_error_mm", {}).get("mean", float("nan"))
    return (f"| {name} | `{result.method}` | {figures.rms:.2f} | {figures.largest:.1f} | {figures.least:.1f} | "
            f"{1e-3 * assumed:.1f} / {1e-3 * true:.1f} | {line:.3f} | {result.failure or ''} |")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--stiffness", default="2,5,10,20,50", help="[N/mm]")
    parser.add_argument("--methods", default="ideal,direct_feedback")
    parser.add_argument("--seeds", default="1")
    parser.add_argument("--glue", action="store_true", help="scene glue besides")
    options = parser.parse_args()
    print("| contact | method | RMS N | largest N | least N | E found / true N/mm | line mm | stopped |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for seed in (int(one) for one in options.seeds.split(",")):
        for k in (float(one) for one in options.stiffness.split(",")):
            scene = contact_scene(k, seed)
            name = f"{k:g} N/mm, μ = {scene.tip.friction:.2f}, seed {seed}"
            for method in options.methods.split(","):
                played = scene.changed(emergency=UNSTOPPED) if method == DIRECT else scene
                print(row(name, run(played, method=method)), flush=True)
        if options.glue:
            print(row(f"`glue`, seed {seed}", run(load_scene("glue").changed(seed=seed))), flush=True)


if __name__ == "__main__":
    main()
