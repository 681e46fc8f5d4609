"""KR 15 on [G]'s paths, ten arms: how much of E_car is taken away with the own model and with a stranger's.

    python benchmarks/paths_ten_arms.py [--individuals 1-10] [--scenes iso9283_1,iso9283_2,iso9283_3]
    python benchmarks/paths_ten_arms.py --causes --individuals 2 --scenes iso9283_1   # single effects of the world off

Own: the model that the arm's identification motions gave (11 s of processor time each, kept in the user's cache
folder). Stranger: the model of the next individual. Both by `ideal`, and by `adapted`, which learns on the way. Percent
of E_car, the weaker of time-matched and aligned. Wanted: 95.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.commands.common import whole_numbers
from scenes.methods import ADAPTED, IDEAL, NONE
from scenes.metrics import PathErrors
from scenes.models import own_model
from scenes.path.kind import run
from scenes.scene_files.scene import chosen

OFF: dict[str, dict[str, Any]] = {
    "nothing": {},
    "all friction": {"friction": False},
    "the part of friction that falls with speed": {"stribeck": 0.0},
    "friction's growth with load": {"load_friction": 0.0},
    "warming": {"thermal": False},
    "torque ripple, encoder increments, noise": {"torque_ripple": 0.0, "quantisation": False, "current_noise": 0.0,
                                                 "external_position_noise": 0.0},
    "elastic gears": {"elasticity": False},
}


def reduction(before: PathErrors, after: PathErrors) -> float:
    """Percent of E_car that is gone, the weaker of time-matched and aligned."""
    return 100.0 * min(1.0 - after.time_matched.E_car / before.time_matched.E_car,
                       1.0 - after.aligned.E_car / before.aligned.E_car)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--individuals", default="1-10")
    parser.add_argument("--scenes", default="iso9283_1,iso9283_2,iso9283_3")
    parser.add_argument("--causes", action="store_true", help="what is left without single effects of the world")
    options = parser.parse_args()
    names = options.scenes.split(",")
    individuals = whole_numbers(options.individuals, "--individuals")
    if options.causes:
        causes(individuals, names)
        return
    found = np.empty((len(individuals), len(names), 4))
    titles = " | ".join(f"`{name}` own / own adapted / stranger / stranger adapted" for name in names)
    print(f"| individual | {titles} |\n{'| --- ' * (1 + len(names))}|")
    for i, individual in enumerate(individuals):
        for j, name in enumerate(names):
            scene = chosen(load_scene(name), individual=individual)
            other = chosen(load_scene(name), individual=individual % 10 + 1)
            stranger = scene.changed(model=own_model(other, Robot.load(scene.robot)))
            before = run(scene, method=NONE).errors
            after = [run(one, method=method) for one in (scene, stranger) for method in (IDEAL, ADAPTED)]
            found[i, j] = [reduction(before, one.errors) for one in after]
        cells = [" / ".join(f"{value:.1f}" for value in row) for row in found[i]]
        print(f"| {individual} | {' | '.join(cells)} |", flush=True)
    least = [" / ".join(f"{value:.1f}" for value in row) for row in found.min(axis=0)]
    print(f"| least | {' | '.join(least)} |")


def causes(individuals: Sequence[int], names: Sequence[str]) -> None:
    """Aligned E_car with single effects of the world off, each with the model of that arm's own motions.

    Args:
        individuals: arms.
        names: scenes.
    """
    print("| individual, scene | off | E_car aligned, none [mm] | ideal [mm] | less by % |")
    print("| --- | --- | --- | --- | --- |")
    for individual in individuals:
        for name in names:
            scene = chosen(load_scene(name), individual=individual)
            for what, change in OFF.items():
                changed = scene.changed(world={**scene.world, **change})
                before, after = (1e3 * run(changed, method=method).errors.aligned.E_car for method in (NONE, IDEAL))
                print(f"| {individual}, `{name}` | {what} | {before:.3f} | {after:.3f} | "
                      f"{100.0 * (1.0 - after / before):.1f} |", flush=True)


if __name__ == "__main__":
    main()
