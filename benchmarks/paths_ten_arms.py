"""KR 15 on [G]'s paths, ten arms: how much of E_car the ideal robot takes away, own model and a stranger's adapted.

    python benchmarks/paths_ten_arms.py [--individuals 1-10] [--scenes iso9283_1,iso9283_2,iso9283_3]

Own: the model that the arm's identification motions gave (11 s of processor time each, kept in the user's cache
folder). Stranger: the model of the next individual, with friction adapted (`adapted`). Percent of E_car, the weaker of
time-matched and aligned. Wanted: 95.
"""

from __future__ import annotations

import argparse

import numpy as np

from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.commands.common import whole_numbers
from scenes.methods import ADAPTED, IDEAL, NONE
from scenes.metrics import PathErrors
from scenes.options import chosen
from scenes.path.kind import run
from scenes.prepared_model import prepared_model
from sim.arm.world import World


def reduction(before: PathErrors, after: PathErrors) -> float:
    """Percent of E_car that is gone, the weaker of time-matched and aligned."""
    return 100.0 * min(1.0 - after.time_matched.E_car / before.time_matched.E_car,
                       1.0 - after.aligned.E_car / before.aligned.E_car)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--individuals", default="1-10")
    parser.add_argument("--scenes", default="iso9283_1,iso9283_2,iso9283_3")
    options = parser.parse_args()
    names = options.scenes.split(",")
    individuals = whole_numbers(options.individuals, "--individuals")
    found = np.empty((len(individuals), len(names), 3))
    titles = " | ".join(f"`{name}` own / stranger / stranger adapted" for name in names)
    print(f"| individual | {titles} |\n{'| --- ' * (1 + len(names))}|")
    for i, individual in enumerate(individuals):
        for j, name in enumerate(names):
            scene = chosen(load_scene(name), individual=individual)
            other = chosen(load_scene(name), individual=individual % 10 + 1)
            path = prepared_model(Robot.load(scene.robot), World.from_table(scene.robot, other.arm_world)).path
            stranger = scene.changed(model=str(path))
            before = run(scene, method=NONE).errors
            after = (run(scene, method=IDEAL), run(stranger, method=IDEAL), run(stranger, method=ADAPTED))
            found[i, j] = [reduction(before, one.errors) for one in after]
        cells = [" / ".join(f"{value:.1f}" for value in row) for row in found[i]]
        print(f"| {individual} | {' | '.join(cells)} |", flush=True)
    least = [" / ".join(f"{value:.1f}" for value in row) for row in found.min(axis=0)]
    print(f"| least | {' | '.join(least)} |")


if __name__ == "__main__":
    main()
