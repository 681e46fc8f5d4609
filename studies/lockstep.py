"""Following on devices in lockstep with the simulated cell, over seeds: jobs done, and what a sound cell bears.

Nothing is faulty here: whatever is stopped is a false alarm of the guard or of a sensor's health.
"""

from __future__ import annotations

import sys
import tempfile
from collections import defaultdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.errors import IdealRobotError
from planning.force.contact import most_force
from scenes.commands.common import whole_numbers
from scenes.force.kind import run as run_force
from scenes.line.cell import prepared
from scenes.line.kind import run as run_line
from scenes.online.run import load_cell
from scenes.path.kind import run as run_path
from scenes.scene_file import load_scene
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.path_scene import PathScene
from studies.report import head, keep, plays_in, row
from tests.scenes.follow.eye_on_bench import followed as followed_by_eye
from tests.scenes.follow.on_bench import followed
from tests.scenes.play.on_bench import played


def lockstep(scenes: str = "line,force_wave,glue,contour", seeds: str = "1-50", lines: Path | None = None) -> None:
    """Sound cells followed in lockstep over seeds: jobs done, false alarms, largest force, force left at rest, errors.

    Where nothing is sensed (``edge``) the path is played, as ``ideal-robot play`` does, each seed on another arm of the
    type, with the shipped model. With ``--lines FILE`` each play is kept as a line of JSON when it has ended, and plays
    that the file holds are not repeated. Exit code 1 where fewer than 49 of 50 are done, or a surface bears more than
    is allowed, or more than nothing at rest.
    """
    kept = plays_in(lines)
    for seed, name in product(whole_numbers(seeds, "--seeds"), scenes.split(",")):
        if any(play["scene"] == name and play["seed"] == seed for play in kept):
            continue
        kept.append(play := _play(name, seed))
        print(play, file=sys.stderr, flush=True)
        keep(lines, play)
    unfit = False
    head("scene", "seeds", "done", "largest force [N]", "left at rest [N]", "rms of the force error [N]: median, worst",
         "over the simulated run's", "beside the line, 95 % below [mm]: median, worst", "over the simulated run's",
         "beside the path, rms [mm]: median, worst", "over the simulated run's")
    plays = defaultdict(list)
    for play in kept:
        plays[play["scene"]].append(play)
    for name in scenes.split(","):
        done = [play for play in plays[name] if play["failure"] is None]
        force, left = (max((play.get(key) or 0.0 for play in plays[name]), default=0.0) for key in ("force", "left"))
        unfit |= len(done) < 0.98 * len(plays[name]) or any(
            (play.get("force") or 0.0) > play.get("allowed", np.inf) or play.get("left") for play in plays[name])
        felt = (f"{force:.1f}", f"{left:.2f}") if force else ("", "")
        row(name, f"{len(plays[name])}", f"{len(done)}", *felt, _spread(done, "rms"), _spread(done, "rms_ratio"),
            _spread(done, "beside"), _spread(done, "ratio"), _spread(done, "path"), _spread(done, "path_ratio"))
        for play in plays[name]:
            if play["failure"] is not None:
                print(f"{name}, seed {play['seed']}: {play['failure']}", file=sys.stderr)
    if unfit:
        sys.exit(1)


def _spread(plays: list[dict[str, Any]], key: str) -> str:
    values = [play[key] for play in plays if play.get(key) is not None]
    return f"{np.median(values):.3f}, {max(values):.3f}" if values else ""


def _play(name: str, seed: int) -> dict[str, Any]:
    """One play: what came of it as plain values; errors in mm and N."""
    scene = load_scene(name).changed(seed=seed)
    if isinstance(scene, PathScene):
        # Noise alone makes no other cell.
        scene = scene.changed(world={**scene.world, "individual": seed})
    else:
        scene = load_cell(name).changed(seed=seed)
    told: dict[str, Any] = {"scene": name, "seed": seed, "failure": None}
    with tempfile.TemporaryDirectory() as folder:
        try:
            if isinstance(scene, PathScene):
                run = played(scene, Path(folder))
                error = 1e3 * run.E_car
                simulated = 1e3 * run_path(scene).errors.time_matched.E_car
                return {**told, "failure": run.failure, "path": error, "path_ratio": error / simulated,
                        "share": run.run.details["guard"]["acceleration_share"]}
            if isinstance(scene, LineScene):
                with prepared(scene) as shared:
                    told["simulated"] = 1e3 * run_line(scene, shared=shared).control_error.p95
                    run = followed_by_eye(scene, Path(folder), check=True, shared=shared)
                if run.seen is not None:
                    told |= {"apart": 1e3 * run.seen.apart, "by_chance": run.seen.by_chance}
                beside = run.settled
            else:
                assert isinstance(scene, ForceScene)
                run = followed(scene, Path(folder))
                told |= {"force": run.force, "left": run.left, "allowed": most_force(scene.force)}
                if run.failure is None:
                    alike = run_force(scene)
                    told |= {"rms": run.rms, "rms_ratio": run.rms / alike.figures.rms}
                    if run.beside is not None and alike.control_error is not None:
                        told |= {"beside": 1e3 * run.beside.p95, "ratio": run.beside.p95 / alike.control_error.p95}
                return {**told, "failure": run.failure}
        except IdealRobotError as error:
            return {**told, "failure": str(error)}
    beside_mm = 1e3 * float(np.percentile(beside, 95)) if len(beside) else None
    ratio = None if beside_mm is None else beside_mm / told["simulated"]
    return {**told, "failure": run.failure, "beside": beside_mm, "ratio": ratio}
