# ruff: noqa: E402 (thread counts must be set before NumPy loads)
"""Planned motions against random ones: how often they tell apart two causes that a recording could not.

Run: ``python benchmarks/plan_diagnosis.py --pairs 30`` (``--write`` puts the table into docs/evidence*.md). Seeds are
gone through from ``--first`` on until there are enough pairs. What is done is kept in ``--file``, one line a seed, and
not done again.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Open, plan_diagnosis
from ideal_robot.diagnosis.next_motion.motion import Kind, Part, Parts
from ideal_robot.diagnosis.next_motion.questions import Named
from ideal_robot.effects import MOTOR_TORQUE, library
from ideal_robot.identification.excitation import MotionSpace, Workspace
from ideal_robot.robots.robot import Robot
from tests.ideal_robot.diagnosis.comparison import Comparison, compared
from trials.report import arm_of, write_tables
from trials.rivals import RivalTrial, draw_rivals, limited, motion_of

ANYWHERE = Workspace(z_min=-np.inf, r_min=0.0)
"""Chains drawn at random stand on nothing."""


def rivals(trial: RivalTrial, robot: Robot) -> dict[str, Comparison]:
    """Other causes of the same joint that the poor recording does not tell from the true one."""
    name, joint = trial.truth
    others = dict.fromkeys(e.name for e in library() if e.domain == MOTOR_TORQUE and not e.absorbed_by_base)
    found = compared(trial.first, robot, trial.truth, [(other, joint) for other in others if other != name])
    return {other: one for (other, _), one in found.items() if one.open}


def random_motion(robot: Robot, start: Array, seconds: float, rng: np.random.Generator) -> Array:
    """A Fourier motion of five harmonics as identification uses, drawn at random and as long ``(N, n)`` [rad]."""
    seconds = max(seconds, 4.0)
    for share in (1.0, 0.85, 0.7, 0.5):
        kind = Kind(seconds * share, 1, 5, 0.75, 0.6)
        space = MotionSpace(robot, kind.period, kind.harmonics, ANYWHERE, kind.speed, kind.acceleration, 0.8)
        for _ in range(20):
            motion = space.scaled(rng.uniform(-1, 1, (2, kind.harmonics, robot.n)), rng)
            if motion is not None:
                parts = Parts(robot, start, (Part(kind, motion),))
                if parts.seconds <= seconds:
                    return parts.commands()
    raise RuntimeError("no random motion within the limits")


def play(seed: int, longest: float) -> dict[str, Any]:
    """One seed: its pair, where there is one, planned and random motion of the same length."""
    trial = draw_rivals(seed)
    name, joint = trial.truth
    line: dict[str, Any] = {"seed": seed, "truth": name, "joint": joint, "joints": trial.arm.n}
    with arm_of(trial.arm.urdf) as plain:
        found = rivals(trial, plain)
        if not found:
            return line
        rival = max(found, key=lambda other: found[other].reached)
        begun = time.process_time()
        robot = limited(plain, trial.arm)
        # The two are named in alphabetical order: which of them is true is not said.
        first, second = sorted((name, rival))
        asked = Open((Named(first, joint, MOTOR_TORQUE.prefix, ((second, joint),)),))
        plan = plan_diagnosis(trial.first, robot, asked, longest=longest, workspace=ANYWHERE, seed=seed)
        line |= {"rival": rival, "before": vars(found[rival]), "plan_seconds": time.process_time() - begun,
                 "not_asked": list(plan.not_asked)}
        if not len(plan.commands):
            return line | {"planned": None, "random": None}
        line |= {"length": plan.seconds, "expected": plan.pairs[0].to_dict()}
        start = trial.first.joints("q")[0]
        rng = np.random.default_rng([seed, 31])
        motions = {"planned": plan.commands, "random": random_motion(robot, start, plan.seconds, rng)}
        for key, commands in motions.items():
            again = trial.recording(motion_of(commands, robot.t_ipo), rng)
            other = compared(again, plain, trial.truth, [(rival, joint)]).get((rival, joint))
            one = other or Comparison(float("inf"), 0.0)
            line[key] = {"ahead": min(float(one.ahead), 1e3), "reached": one.reached, "told_apart": one.told_apart}
    return line


def table(lines: list[dict[str, Any]], longest: float) -> str:
    """Markdown of the rates and of the pairs."""
    pairs = [line for line in lines if "rival" in line]
    seeds = f"Seeds {lines[0]['seed']} to {lines[-1]['seed']}: {len(pairs)} pairs in {len(lines)} recordings."
    rows = [seeds, "", "| motion | told apart | asked for | rival reaches in the mean | of it less than a quarter |",
            "| --- | --- | --- | --- | --- |"]
    for key, wanted in (("planned", "≥ 90 %"), ("random", "")):
        right = sum(bool(line[key] and line[key]["told_apart"]) for line in pairs)
        reached = [1.0 if line[key]["ahead"] <= 0 else line[key]["reached"] for line in pairs if line[key]]
        mean, few = 100.0 * float(np.mean(reached)), sum(share < 0.25 for share in reached)
        label = f"planned, ≤ {longest:.0f} s" if key == "planned" else "random, of the same length"
        rows.append(f"| {label} | {100.0 * right / max(len(pairs), 1):.0f} % ({right} of {len(pairs)}) | "
                    f"{wanted} | {mean:.0f} % | {few} of {len(reached)} |")
    rows += ["", "| seed | true | rival | length s | expected σ before | planned | random motion | planned motion |",
             "| --- | --- | --- | --- | --- | --- | --- | --- |"]
    for line in pairs:
        if line["planned"] is None:
            rows.append(f"| {line['seed']} | {line['truth']} | {line['rival']} | none | | | | |")
            continue
        sigma = line["expected"]["sigma"]
        said = [f"{'told' if line[key]['told_apart'] else 'open'}, rival reaches {100.0 * line[key]['reached']:.0f} %"
                if line[key]["ahead"] > 0 else "the wrong one ahead" for key in ("random", "planned")]
        rows.append(f"| {line['seed']} | `{line['truth']}` | `{line['rival']}` | {line['length']:.0f} | "
                    f"{sigma['before']:.1f} | {sigma['planned']:.1f} | {said[0]} | {said[1]} |")
    return "\n".join(rows)


def main() -> None:
    """Goes through seeds until there are enough pairs, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument("--first", type=int, default=50000)
    parser.add_argument("--length", type=float, default=30.0, help="longest motion [s]")
    parser.add_argument("--file", type=Path, default=Path("out/plan_diagnosis.jsonl"))
    parser.add_argument("--write", action="store_true", help="put the table into docs/evidence*.md")
    options = parser.parse_args()
    done: dict[int, dict[str, Any]] = {}
    if options.file.is_file():
        done = {line["seed"]: line for line in map(json.loads, options.file.read_text(encoding="utf-8").splitlines())}
    options.file.parent.mkdir(parents=True, exist_ok=True)
    lines: list[dict[str, Any]] = []
    seed = options.first
    while sum("rival" in line for line in lines) < options.pairs:
        if seed not in done:
            done[seed] = play(seed, options.length)
            with options.file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(done[seed]) + "\n")
            if "rival" in done[seed]:
                print(json.dumps(done[seed]), flush=True)
        lines.append(done[seed])
        seed += 1
    text = table(lines, options.length)
    print(text)
    if options.write:
        write_tables("planned motions", text)


if __name__ == "__main__":
    main()
