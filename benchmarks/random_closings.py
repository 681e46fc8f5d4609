"""Closings of arms and cameras drawn at random: never worse than before, and how close to an oracle.

``python -m benchmarks.random_closings --count 100 --file closings.jsonl`` plays and appends one line a closing; what
the file holds already is not played again. Two processes share the work: ``--first 0 --step 2 --file even.jsonl`` and
``--first 1 --step 2 --file odd.jsonl``. ``--table --file even.jsonl odd.jsonl`` prints what the files say, as Markdown.

Drawn, by the seed: path or line (every fifth), robot, individual, place, size and speed, what the arm measures (half:
motor angles and currents alone), and the misfit: a fifth have none, a fifth one outside the library, the others one or
two effects, two to ten times what can be seen at all (of an arm: a quarter of 0.5 % of the torque limit, of 20 µrad of
arm angle or of 20 µm of the tool; of a camera: see ``benchmarks.random_lines``).
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.outside_library import close_outside, crossed_drag, place_friction, slack_at_first
from benchmarks.random_lines import closed_line
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.results import plain
from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.closing.result import Closing
from scenes.models import model_for
from scenes.path.cell import PathCell, set_up
from scenes.path.close_loop import closed
from scenes.scene_files.path_scene import PathScene
from scenes.undeclared import undeclared_effects
from sim.arm.world import World

FIRST_INDIVIDUAL = 1
"""The one whose model is shipped."""
WORSE_SHARE, WORSE_LEAST = 0.05, 3e-3
"""Never worse than before by more than this share, or this many mm."""
PLACES = {"kr15": ((1.05, 0.0, 0.95), 45.0), "manutec_r15": ((0.8, 0.0, 0.75), 90.0)}
"""Centre of the circles and tilt of their plane."""
TORQUE = ("coulomb", "viscous", "stribeck", "degressive", "friction_asymmetry", "load_friction", "extra_rotor_inertia",
          "torque_ripple", "payload_mass")
BEHIND = ("stiffness", "transmission_error", "backlash", "kinematic_error")


def drawn_scene(rng: np.random.Generator, individuals: int) -> PathScene:
    """A circle on one arm."""
    robot = str(rng.choice(list(PLACES)))
    centre, tilt = PLACES[robot]
    individual = FIRST_INDIVIDUAL + int(rng.integers(individuals))
    scene = load_scene("close_stribeck").changed(
        robot=robot, seed=int(rng.integers(1, 10**6)), speed=float(rng.uniform(0.25, 0.5)),
        path={"size_mm": float(rng.uniform(120.0, 220.0)), "tilt_deg": tilt,
              "centre": [float(c + rng.uniform(-0.05, 0.05)) for c in centre]})
    assert isinstance(scene, PathScene)
    own = {"world": {"individual": individual}, "model": "own"} if individual != FIRST_INDIVIDUAL else {"world": {}}
    return scene.model_copy(update=own)


def drawn_misfit(rng: np.random.Generator, robot: Robot, world: World, count: int) -> dict[str, Any]:
    """Keys of a world with one or two effects of two to ten times what can be seen."""
    result: dict[str, Any] = {}
    n, torque = robot.n, 0.25 * 0.005 * np.where(np.isfinite(robot.tau_max), robot.tau_max, 100.0)
    for key in map(str, rng.choice([*TORQUE, *BEHIND], count, replace=False)):
        j, times = int(rng.integers(min(n, 3))), float(rng.uniform(2.0, 10.0))
        usual = world.per_joint(key, n) if isinstance(getattr(world, key), (float, tuple)) else np.zeros(n)
        own = usual.copy()
        if key in ("coulomb", "degressive"):
            own[j] += times * torque[j]
        elif key == "stribeck":
            # It shows near standstill alone, in a few per cent of the time.
            own[j] += 5.0 * times * torque[j]
        elif key == "viscous":
            own[j] += times * torque[j] / 0.3
        elif key == "friction_asymmetry":
            own[j] += min(times * torque[j] / world.per_joint("coulomb", n)[j], 0.5)
        elif key == "load_friction":
            own[j] += 10.0 * times * torque[j] / world.per_joint("coulomb", n)[j]
        elif key == "extra_rotor_inertia":
            own[j] = times * torque[j] / 1.5
        elif key == "torque_ripple":
            own[j] += np.sqrt(2.0) * times * 0.25 * 0.005
        elif key == "payload_mass":
            result |= {"payload_mass": times * float(torque[1]) / 9.81, "payload_com": [0.02, 0.01, 0.08]}
            continue
        elif key == "stiffness":
            own[j] = 1.0 / (1.0 / usual[j] + times * 5e-6 / (80.0 * torque[j]))
        elif key == "transmission_error":
            own[j] = np.sqrt(2.0) * times * 5e-6
        elif key == "backlash":
            own[j] = 2.0 * times * 5e-6
        else:
            result["kinematic_error"] = times * 2e-5
            continue
        result[key] = [float(value) for value in own]
    return result


def one_closing(seed: int, individuals: int, rounds: int) -> dict[str, Any]:
    """Draws and closes one arm, or one camera.

    Args:
        seed: of all that is drawn.
        individuals: arms of each type.
        rounds: of run and diagnosis, at most.
    """
    rng = np.random.default_rng([seed, 14])
    kind = ("none", "outside", "library", "library", "library")[seed % 5]
    measured = "motor" if (seed // 5) % 2 == 0 else "tcp"
    begun, wall = time.process_time(), time.monotonic()
    line: dict[str, Any] = {"seed": seed, "kind": kind, "measured": measured}
    try:
        if (seed // 10) % 2 == 1 and seed % 5 in (0, 4):
            line |= {"scene": "line", **closed_line(rng, kind == "none", measured)}
        else:
            line |= {"scene": "path", **_closed_path(rng, kind, measured, individuals, rounds)}
    except IdealRobotError as error:
        return {**line, "failed": str(error)}
    return {**line, "cpu_s": time.process_time() - begun, "wall_s": time.monotonic() - wall}


def _closed_path(rng: np.random.Generator, kind: str, measured: str, individuals: int, rounds: int) -> dict[str, Any]:
    scene = drawn_scene(rng, individuals)
    robot = Robot.load(scene.robot)
    cell = set_up(scene, delay=False, model=model_for(scene, robot))
    result, misfit = _closed(rng, kind, scene, cell, robot, measured, rounds)
    values = result.json()
    return {"robot": scene.robot, "individual": cell.world.individual, "speed": scene.speed,
            "size_mm": scene.path.size_mm, "misfit": misfit, "error_mm": values["E_car_aligned_mm"],
            "undeclared": values["undeclared"], "steps": values["steps"]}


def _closed(rng: np.random.Generator, kind: str, scene: PathScene, cell: PathCell, robot: Robot, measured: str,
            rounds: int) -> tuple[Closing, Any]:
    if kind == "none":
        return closed(scene, cell, (), measured=measured, rounds_at_most=rounds), {}
    if kind == "outside":
        low, high = np.min(cell.path.q_d, axis=0), np.max(cell.path.q_d, axis=0)
        size = float(rng.uniform(2.0, 10.0) * 0.25 * 0.005 * robot.tau_max[1] * 4.0)
        cause = (crossed_drag(2, 3, size, float(0.5 * (low + high)[2]), float((high - low)[2])),
                 slack_at_first(cell, 3, 4.0 * size),
                 place_friction(1, size, float(high[0]), float(0.35 * (high - low)[0])))[int(rng.integers(3))]
        result = close_outside(scene, cell, cause, measured=measured, rounds=rounds)
        return result, {"outside": cause.name, "size": size}
    misfit = drawn_misfit(rng, robot, cell.world, int(rng.integers(1, 3)))
    hidden = scene.model_copy(update={"world": {**scene.world, **misfit}})
    arm = PathCell(robot, cell.world.replace(**misfit), cell.model, cell.path, cell.learn_from, cell.seed)
    return closed(hidden, arm, undeclared_effects(hidden, robot.n), measured=measured, rounds_at_most=rounds), misfit


def table(lines: list[dict[str, Any]]) -> str:
    """What the closings say, as Markdown.

    Raises:
        InputError: there are none.
    """
    played = [one for one in lines if "failed" not in one]
    if not played:
        raise InputError("no closing has been played yet", field="--file")
    errors = np.array([[one["error_mm"][name] for name in ("before", "after", "oracle")] for one in played])
    # Rows of earlier versions have oracles that kept a size with which the path was worse.
    errors[:, 2] = np.minimum(errors[:, 2], errors[:, 0])
    groups = {"all": np.ones(len(played), dtype=bool)}
    for key, values in (("measured", ("motor", "tcp")), ("scene", ("path", "line")),
                        ("kind", ("none", "outside", "library"))):
        groups |= {value: np.array([one[key] == value for one in played]) for value in values}
    rows = ["| what | " + " | ".join(groups) + " |", "| --- |" + " --- |" * len(groups)]
    worse = errors[:, 1] > errors[:, 0] + np.maximum(WORSE_SHARE * errors[:, 0], WORSE_LEAST)
    ratio = errors[:, 1] / errors[:, 2]
    taken = np.array([any(step["taken"] for step in one["steps"]) for one in played])

    def row(name: str, cell: Any) -> None:
        rows.append(f"| {name} | " + " | ".join(cell(g) if g.any() else "" for g in groups.values()) + " |")

    row("closings", lambda g: str(int(g.sum())))
    row("worse than before by more than 5 % and 3 µm", lambda g: str(int(worse[g].sum())))
    row("model changed", lambda g: str(int(taken[g].sum())))
    row("median after / before", lambda g: f"{np.median(errors[g, 1] / errors[g, 0]):.2f}")
    row("median oracle / before", lambda g: f"{np.median(errors[g, 2] / errors[g, 0]):.2f}")
    row("median after / oracle", lambda g: f"{np.median(ratio[g]):.2f}")
    row("after ≤ 1.5 × oracle", lambda g: f"{int(np.sum(ratio[g] <= 1.5))} of {int(g.sum())}")
    if len(played) < len(lines):
        rows.append(f"\n{len(lines) - len(played)} could not be played.")
    return "\n".join(rows)


def main() -> None:
    """Plays what the file does not hold yet, or prints its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--step", type=int, default=1, help="of the seeds: 2 where another process plays the others")
    parser.add_argument("--individuals", type=int, default=3,
                        help="arms of each type; all but the first are identified")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--file", type=Path, nargs="+", default=[Path("closings.jsonl")],
                        help="the first one is appended to; what any of them holds is not played again")
    parser.add_argument("--table", action="store_true")
    given = parser.parse_args()
    texts = [file.read_text(encoding="utf-8") for file in given.file if file.exists()]
    lines = [json.loads(line) for text in texts for line in text.splitlines()]
    if given.table:
        print(table(lines))
        return
    done = {line["seed"] for line in lines}
    for seed in range(given.first, given.first + given.count, given.step):
        if seed in done:
            continue
        line = one_closing(seed, given.individuals, given.rounds)
        with given.file[0].open("a", encoding="utf-8") as file:
            file.write(json.dumps(plain(line), allow_nan=False) + "\n")
        print(json.dumps({key: line.get(key) for key in ("seed", "scene", "kind", "measured", "error_mm", "cpu_s",
                                                         "failed")}), flush=True)


if __name__ == "__main__":
    main()
