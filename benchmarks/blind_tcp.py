# ruff: noqa: E402 (thread counts must be set before NumPy loads)
"""Blind trials of effects behind the gear, as a device that measures the TCP (and at times arm angles) shows them;
with ``--force`` of effects that a force sensor shows.

Run: ``python benchmarks/blind_tcp.py --count 80`` (``--write`` puts the tables into docs/evidence*.md).
Seeds from 6000 on are the reported ones; what they showed was mended on others.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import argparse
import dataclasses
import time

from ideal_robot.diagnosis import diagnose
from ideal_robot.effects import SENSOR
from trials.force import draw_force_trial
from trials.report import arm_of, line_of, tables, write_tables
from trials.score import Score, score
from trials.tcp import KINDS, draw_tcp_trial


def play(seed: int, kind: str | None, force: bool) -> Score:
    """Draws, diagnoses and scores one trial."""
    trial = (draw_force_trial if force else draw_tcp_trial)(seed, kind)
    start = time.process_time()
    with arm_of(trial.urdf) as robot:
        found = diagnose(trial.recording, robot)
    if force:
        # Contact also shows in motor torques, of which these trials do not ask.
        effects = tuple(e for e in found.effects if e.fitted.domain == SENSOR)
        found = dataclasses.replace(found, effects=effects, unknown=(), verdict="effects" if effects else "none")
    result = score(seed, trial.kind, trial.truth, False, found, time.process_time() - start)
    return dataclasses.replace(result, **_with_equivalents(result, trial.truth))


def _with_equivalents(result: Score, truth: tuple[tuple[str, int], ...]) -> dict[str, bool]:
    """What is said to be indistinguishable from the truth at another joint counts as the truth."""
    if result.right or not truth:
        return {}
    (name, joint), = truth
    group = any(f"{name} of joint {joint}" in rivals for _, _, rivals in result.found)
    return {"right": group, "joint": group or result.joint}


def main() -> None:
    """Plays the trials and prints the rates and the confusion matrix."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=80)
    parser.add_argument("--first", type=int, default=6000)
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--force", action="store_true", help="of a force sensor instead")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after that long and report what there is")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/evidence*.md")
    options = parser.parse_args()
    scores: list[Score] = []
    begun = time.monotonic()
    for seed in range(options.first, options.first + options.count):
        s = play(seed, options.kind, options.force)
        scores.append(s)
        print(line_of(s), flush=True)
        if time.monotonic() - begun > 60.0 * options.minutes:
            break
    text = tables(scores)
    print(text)
    if options.write:
        seeds = f"Seeds {scores[0].seed} to {scores[-1].seed}, played once.\n\n"
        write_tables(f"blind trials {'force' if options.force else 'tcp'}", seeds + text)


if __name__ == "__main__":
    main()
