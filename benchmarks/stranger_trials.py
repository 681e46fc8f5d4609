# ruff: noqa: E402 (thread counts must be set before NumPy loads)
"""Trials of the diagnosis in strangers' physics, with the strict score.

Run: ``python benchmarks/stranger_trials.py --count 45 --first 40000 --json scores.jsonl``. Every recording follows from
its seed; the engine goes by turns. With ``--json`` each score is a line, and trials that have one are not played again.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import argparse
import dataclasses
import json
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from ideal_robot.diagnosis import diagnose
from ideal_robot.robots.robot import Robot
from trials.strangers.engines import ENGINES
from trials.strangers.score import Score, report, score
from trials.strangers.trial import KINDS, draw_trial

Job = tuple[int, str | None, str | None, tuple[float, float]]


def play(job: Job) -> Score:
    """Draws, diagnoses and scores one trial."""
    seed, kind, engine, size = job
    trial = draw_trial(seed, kind, engine, size)
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "arm.urdf"
        urdf.write_text(trial.urdf, encoding="utf-8")
        robot = Robot.load(urdf)
        model = None
        if trial.reference is not None:
            model = diagnose(trial.reference, robot).model
            # What was learned of the healthy arm is not held against it: only the parameters are known before.
            model = None if model is None else dataclasses.replace(model, effects=())
        start = time.process_time()
        found = diagnose(trial.recording, robot, model=model)
        return score(trial, found, time.process_time() - start)


def line(s: Score) -> str:
    """One trial for people."""
    causes = ", ".join(f"{name} {joint} ×{size:.1f}" for name, joint, size in s.causes) or "nothing"
    said = ", ".join([*(f"{name} {joint}" for name, joint in s.named), *(f"unknown {j}" for j in s.unknown)])
    return (f"{'ok ' if s.right else 'BAD'} {s.seed} {s.engine:10s} {s.kind:7s} {s.arm:13s} {s.motion:7s} "
            f"{s.logger:12s} {s.controller:15s} {s.friction:10s} {s.gears:7s} {s.seconds:5.1f} s  true: {causes}  "
            f"said: {s.verdict} {said}")


def main() -> None:
    """Plays the trials and prints a line each and the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=45)
    parser.add_argument("--first", type=int, default=40000)
    parser.add_argument("--engine", choices=tuple(ENGINES), help="all trials in this one; by turns otherwise")
    parser.add_argument("--kind", choices=KINDS, help="all trials of this kind; drawn otherwise")
    parser.add_argument("--size-min", type=float, default=0.5, help="multiples of visible")
    parser.add_argument("--size-max", type=float, default=10.0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after that long and report what there is")
    parser.add_argument("--json", type=Path, metavar="OUT", help="a line per score; what is there is not played again")
    options = parser.parse_args()
    size = (options.size_min, options.size_max)
    scores: list[Score] = []
    if options.json is not None and options.json.is_file():
        wanted = range(options.first, options.first + options.count)
        old = [Score.from_dict(json.loads(text)) for text in options.json.read_text(encoding="utf-8").splitlines()]
        scores = [s for s in old if s.seed in wanted and options.engine in (None, s.engine)
                  and options.kind in (None, s.kind)]
    done = {s.seed for s in scores}
    jobs: list[Job] = [(seed, options.kind, options.engine, size)
                       for seed in range(options.first, options.first + options.count) if seed not in done]
    begun = time.monotonic()
    with ProcessPoolExecutor(options.processes) as pool:
        for s in (pool.map(play, jobs) if options.processes > 1 else map(play, jobs)):
            scores.append(s)
            print(line(s), flush=True)
            if options.json is not None:
                with options.json.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(s.to_dict()) + "\n")
            if time.monotonic() - begun > 60.0 * options.minutes:
                pool.shutdown(wait=False, cancel_futures=True)
                break
    print(report(scores))


if __name__ == "__main__":
    main()
