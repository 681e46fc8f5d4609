# ruff: noqa: E402 (thread counts must be set before NumPy loads)
"""Trials of the diagnosis in strangers' physics, with the strict score.

Run: ``python benchmarks/stranger_trials.py --count 45 --first 40000 --json scores.jsonl``. Every recording follows from
its seed; the engine goes by turns. With ``--json`` each score is a line, and trials that have one are not played again;
``--write`` puts the tables into docs/evidence*.md. ``--kind none --share-scale 0.5`` plays empty recordings with all
shares of the residual that are asked of an effect halved, and says which factor on them each two engines ask for and
what it does in the third. ``--kind known`` plays healthy recordings against the model that ``identify`` makes of
another healthy recording of the same arm.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import SimpleNamespace

from ideal_robot.diagnosis import Options, diagnose
from ideal_robot.errors import IdealRobotError
from ideal_robot.identification.idim import identify
from trials.report import arm_of, write_tables
from trials.strangers.engines import ENGINES
from trials.strangers.score import Score, score
from trials.strangers.tables import leaving_out, report
from trials.strangers.trial import KINDS, draw_trial

GAVE_UP = SimpleNamespace(verdict="failed", effects=(), unknown=())
"""What counts as the answer of a diagnosis that ends with an error."""
Job = tuple[int, str | None, str | None, tuple[float, float], float]


def play(job: Job) -> Score | None:
    """Draws, diagnoses and scores one trial; None where nothing can be drawn from its seed.

    A diagnosis that gives up has said nothing, and is never right.
    """
    seed, kind, engine, size, scale = job
    try:
        trial = draw_trial(seed, kind, engine, size)
    except RuntimeError as error:
        print(error, flush=True)
        return None
    options = Options().scaled(scale)
    with arm_of(trial.urdf) as robot:
        model = None
        try:
            if trial.kind == "known":
                model = identify([trial.reference], robot).model
            elif trial.reference is not None:
                # What is known before is a rigid body with friction, as an identification has it, and no effects.
                model = diagnose(trial.reference, robot, only=()).model
            start = time.process_time()
            found = diagnose(trial.recording, robot, model=model, options=options)
        except (IdealRobotError, ArithmeticError, ValueError) as error:
            print(f"{seed}: {error}", flush=True)
            return score(trial, GAVE_UP)
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
    parser.add_argument("--minutes", type=float, default=1e9,
                        help="stop after that long and report what there is; 0 plays nothing")
    parser.add_argument("--json", type=Path, metavar="OUT", help="a line per score; what is there is not played again")
    parser.add_argument("--share-scale", type=float, default=1.0,
                        help="factor on all shares that are asked of an effect")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/evidence*.md")
    options = parser.parse_args()
    size = (options.size_min, options.size_max)
    scores: list[Score] = []
    if options.json is not None and options.json.is_file():
        wanted = range(options.first, options.first + options.count)
        old = [Score.from_dict(json.loads(text)) for text in options.json.read_text(encoding="utf-8").splitlines()]
        scores = [s for s in old if s.seed in wanted and options.engine in (None, s.engine)
                  and options.kind in (None, s.kind)]
    done = {s.seed for s in scores}
    jobs: list[Job] = [(seed, options.kind, options.engine, size, options.share_scale)
                       for seed in range(options.first, options.first + options.count)
                       if seed not in done and options.minutes > 0.0]
    begun = time.monotonic()
    with ProcessPoolExecutor(options.processes) as pool:
        for s in (pool.map(play, jobs) if options.processes > 1 else map(play, jobs)):
            if s is None:
                continue
            scores.append(s)
            print(line(s), flush=True)
            if options.json is not None:
                with options.json.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(s.to_dict()) + "\n")
            if time.monotonic() - begun > 60.0 * options.minutes:
                pool.shutdown(wait=False, cancel_futures=True)
                break
    text = report(scores) if options.share_scale == 1.0 else leaving_out(scores, options.share_scale)
    print(text)
    if options.write:
        write_tables("stranger trials" if options.share_scale == 1.0 else "engines left out", text)


if __name__ == "__main__":
    main()
