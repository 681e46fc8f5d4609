# ruff: noqa: E402 (thread counts must be set before NumPy loads)
"""Blind trials of the diagnosis: draws, diagnoses, scores, and writes the confusion matrix.

Run: ``python benchmarks/blind_trials.py --count 240`` (``--write`` puts the tables into docs/evidence*.md).
Seeds from 16000 on are the reported ones; thresholds were set on others.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import argparse
import dataclasses
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor

from ideal_robot.diagnosis import diagnose
from trials.report import arm_of, line_of, tables, write_tables
from trials.score import Score, score
from trials.torque import KINDS, draw_trial

ORACLE = bool(os.environ.get("BLIND_ORACLE"))
"""Whether an oracle that knows names and joints diagnoses too, for the ratio of held-out errors; twice the time."""


def play(job: tuple[int, str | None]) -> Score:
    """Draws, diagnoses and scores one trial."""
    seed, kind = job
    trial = draw_trial(seed, kind)
    start = time.process_time()
    with arm_of(trial.urdf) as robot:
        model = None
        if trial.reference is not None:
            model = diagnose(trial.reference, robot).model
            model = None if model is None else dataclasses.replace(model, effects=())
        found = diagnose(trial.recording, robot, model=model)
        seconds = time.process_time() - start
        ratio = None
        if ORACLE and trial.kind in ("inside", "two"):
            oracle = diagnose(trial.recording, robot, only=trial.truth)
            ratio = max(found.channels[j - 1].rms_after / oracle.channels[j - 1].rms_after for _, j in trial.truth)
    return score(trial.seed, trial.kind, trial.truth, trial.outside, found, seconds, ratio)


def main() -> None:
    """Plays the trials and prints the rates and the confusion matrix."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=240)
    parser.add_argument("--first", type=int, default=16000)
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--oracle", action="store_true", help="diagnose with an oracle too: ratio of held-out errors")
    parser.add_argument("--quiet", action="store_true")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after that long and report what there is")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/evidence*.md")
    options = parser.parse_args()
    if options.oracle and not ORACLE:
        os.environ["BLIND_ORACLE"] = "1"
        globals()["ORACLE"] = True
    jobs = [(seed, options.kind) for seed in range(options.first, options.first + options.count)]
    scores: list[Score] = []
    begun = time.monotonic()
    with ProcessPoolExecutor(options.processes) as pool:
        for s in (pool.map(play, jobs) if options.processes > 1 else map(play, jobs)):
            scores.append(s)
            if not options.quiet:
                print(line_of(s), flush=True)
            if time.monotonic() - begun > 60.0 * options.minutes:
                pool.shutdown(wait=False, cancel_futures=True)
                break
    text = tables(scores)
    print(text)
    print("kinds:", dict(Counter(s.kind for s in scores)),
          f"CPU {sum(s.seconds for s in scores) / len(scores):.1f} s a trial")
    if options.write:
        write_tables("blind trials", text)


if __name__ == "__main__":
    main()
