"""The line in the workshop, ten arms, each with the model of its own identification motions, beside what is wanted.

    python benchmarks/ten_arms.py runs.jsonl [--individuals 1-10] [--seeds 1-3] [--speeds 0.7,1.5,2] [--processes 2]
    python benchmarks/ten_arms.py --models [--individuals 1-10] [--seeds 1-3]   # and with the model of the next arm
    python benchmarks/ten_arms.py --adapted [--individuals 1-10] [--seeds 6-13] # with the own model alone

Answers go to the file as they come; started again with the same file, it goes on where it was. About 20 s of processor
time for an arm's model (kept in the user's cache folder) and 3 s for a run. With ``--models`` each arm is played at the
scene's speed with its own model and with a stranger's, that of the next individual, by ``ideal`` and by ``adapted``.
``--adapted`` asks how much worse adaptation may be where nothing is to be adapted: by arms, over more seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.commands.common import numbers, whole_numbers
from scenes.line.kind import run
from scenes.methods import ADAPTED, IDEAL
from scenes.models import own_model
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import chosen
from scenes.sweep import SweepFile, jobs, sweep

WANTED = {0.7: {"mean": 0.10, "worst mean": 0.15, "p95": 0.35}, 1.5: {"mean": 0.2}, 2.0: {"mean": 0.3}}
"""Bounds by speed [mm]: of the mean over all runs, of the worst run's mean, of each run's 95 %."""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("lines", type=Path, nargs="?")
    parser.add_argument("--models", action="store_true", help="the own model and a stranger's, not adapted and adapted")
    parser.add_argument("--adapted", action="store_true", help="the own model, adapted over not adapted, by arms")
    parser.add_argument("--individuals", default="1-10")
    parser.add_argument("--seeds", default="1-3")
    parser.add_argument("--speeds", default="0.7,1.5,2")
    parser.add_argument("--scene", default="line")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    seeds, individuals = whole_numbers(options.seeds, "--seeds"), whole_numbers(options.individuals, "--individuals")
    if options.models:
        models(options.scene, individuals, seeds)
        return
    if options.adapted:
        adapted(options.scene, individuals, seeds)
        return
    if options.lines is None:
        parser.error("give the file that the answers go to, --models or --adapted")
    # Arm by arm, so that what is finished early is a whole row; two processes would identify one arm twice.
    answers: list[dict[str, Any]] = []
    speeds = numbers(options.speeds, "--speeds")
    file = SweepFile(options.lines, resume=options.lines.exists())
    for individual in individuals:
        work = jobs([options.scene], speeds=speeds, seeds=seeds, individuals=[individual])
        first = sweep(work[:1], processes=1, file=file)
        answers += [*first, *sweep(work[1:], processes=options.processes, file=file)]
    print(f"| individual | {' | '.join(f'{v:g} m/s, seed {s}' for v in speeds for s in seeds)} |")
    print("| --- " * (1 + len(speeds) * len(seeds)) + "|")
    for individual in individuals:
        own = {(one["speed_m_s"], one["seed"]): one for one in answers if one["individual"] == individual}
        cells = [_cell(own[v, s]) for v in speeds for s in seeds]
        print(f"| {individual} | {' | '.join(cells)} |")
    print("\n| m/s | runs | mean of the means | worst run's mean | largest 95 % | largest | failed | wanted |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for speed in speeds:
        runs = [one for one in answers if one["speed_m_s"] == speed]
        error = {key: np.array([one["control_error_mm"][key] for one in runs if not one["failure"]] or [np.nan])
                 for key in ("mean", "p95", "max")}
        wanted = ", ".join(f"{key} ≤ {bound:g}" for key, bound in WANTED.get(speed, {}).items())
        failed = sum(bool(one["failure"]) for one in runs)
        print(f"| {speed:g} | {len(runs)} | {error['mean'].mean():.3f} | {error['mean'].max():.3f} | "
              f"{error['p95'].max():.3f} | {error['max'].max():.3f} | {failed} | {wanted} |")


def models(name: str, individuals: Sequence[int], seeds: Sequence[int]) -> None:
    """Mean error of each arm over the seeds with its own model and with that of the next individual [mm].

    A constant beside the line is the sensing's, not the arm's: what is left without each run's own stands apart.
    """
    print("| individual | own, `ideal` | own, `adapted` | stranger's, `ideal` | stranger's, `adapted` |")
    print("| --- | --- | --- | --- | --- |")
    mean, p95, varying = (np.empty((len(individuals), 4, len(seeds))) for _ in range(3))
    for i, individual in enumerate(individuals):
        scene, other = (chosen(load_scene(name), individual=which) for which in (individual, individual % 10 + 1))
        robot = Robot.load(scene.robot)
        for whose, columns in ((scene, slice(0, 2)), (other, slice(2, 4))):
            mean[i, columns], p95[i, columns], varying[i, columns] = played(
                scene.changed(model=own_model(whose, robot)), seeds)
        print(_row(str(individual), mean[i].mean(axis=1)), flush=True)
    print(_row("mean", mean.mean(axis=(0, 2))))
    print(_row("worst run's mean", mean.max(axis=(0, 2))))
    print(_row("worst run's 95 %", p95.max(axis=(0, 2))))
    print(_row("mean without each run's constant", varying.mean(axis=(0, 2))))


def adapted(name: str, individuals: Sequence[int], seeds: Sequence[int]) -> None:
    """Each arm with its own model, ``adapted`` over ``ideal``, with the standard error over the seeds."""
    print("| individual | `ideal`, mm | `adapted`, mm | `adapted` / `ideal` | the same without each run's constant |")
    print("| --- | --- | --- | --- | --- |")
    sums = []
    for individual in individuals:
        scene = chosen(load_scene(name), individual=individual)
        mean, _, varying = played(scene.changed(model=own_model(scene, Robot.load(scene.robot))), seeds)
        sums.append([*mean.mean(axis=1), *varying.mean(axis=1)])
        print(f"| {individual} | {1e3 * sums[-1][0]:.3f} | {1e3 * sums[-1][1]:.3f} | {_ratio(*mean)} | "
              f"{_ratio(*varying)} |", flush=True)
    whole = np.mean(sums, axis=0)
    print(f"| all | {1e3 * whole[0]:.3f} | {1e3 * whole[1]:.3f} | {whole[1] / whole[0]:.2f} | "
          f"{whole[3] / whole[2]:.2f} |")


def played(scene: LineScene, seeds: Sequence[int]) -> tuple[Array, Array, Array]:
    """Mean error, 95 %, and mean error less each run's constant, by ``ideal`` and ``adapted``, each ``(2, seeds)`` [m].

    NaN where a run failed.
    """
    mean, p95, varying = (np.full((2, len(seeds)), np.nan) for _ in range(3))
    for k, seed in enumerate(seeds):
        for j, method in enumerate((IDEAL, ADAPTED)):
            result = run(scene.changed(seed=seed), method=method)
            if result.failure:
                continue
            error = result.control_error
            mean[j, k], p95[j, k] = error.mean, error.p95
            varying[j, k] = np.mean(np.abs(error.lateral - np.mean(error.lateral)))
    return mean, p95, varying


def _ratio(ideal: Array, adapted: Array) -> str:
    """Ratio of the means over the seeds, with its standard error."""
    ratio = adapted.mean() / ideal.mean()
    if len(ideal) < 2:
        return f"{ratio:.2f}"
    return f"{ratio:.2f} ± {np.std(adapted - ratio * ideal, ddof=1) / np.sqrt(len(ideal)) / ideal.mean():.2f}"


def _row(title: str, values: Array) -> str:
    return f"| {title} | {' | '.join(f'{1e3 * value:.3f}' for value in values)} |"


def _cell(answer: dict[str, Any]) -> str:
    """Mean and 95 % of a run [mm], or that it failed."""
    if answer["failure"]:
        return "failed"
    error = answer["control_error_mm"]
    return f"{error['mean']:.3f} / {error['p95']:.3f}"


if __name__ == "__main__":
    main()
