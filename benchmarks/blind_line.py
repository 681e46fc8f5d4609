# ruff: noqa: E402 (thread counts must be set before NumPy loads)
"""Blind trials of a camera that sees a line: which of its effects is there, or none.

Run: ``python benchmarks/blind_line.py --count 120``. Seeds from 9000 on are the reported ones.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import argparse
import time
from collections import Counter

from ideal_robot.diagnosis import diagnose
from trials.line import KINDS, draw_line_trial, gantry
from trials.report import arm_of


def main() -> None:
    """Plays the trials and prints the confusion: drawn by rows, said by columns, and what stood in a group."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=120)
    parser.add_argument("--first", type=int, default=9000)
    arguments = parser.parse_args()
    said: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    first: Counter[str] = Counter()
    grouped: Counter[str] = Counter()
    right_number = 0
    start = time.process_time()
    with arm_of(gantry()) as robot:
        for seed in range(arguments.first, arguments.first + arguments.count):
            kind, size, recording = draw_line_trial(seed)
            found = [e for e in diagnose(recording, robot).effects if e.fitted.channel == "line"]
            names = [e.fitted.name for e in found] or ["none"]
            said[kind][" + ".join(names)] += 1
            first[kind] += names == [kind]
            grouped[kind] += names == [kind] or any(kind in (e.fitted.name, *e.indistinguishable_from) for e in found)
            right_number += any(e.fitted.name == kind and abs(e.fitted.coefficients[0] - size * _share(kind))
                                < 3.0 * e.fitted.std[0] for e in found)
    seconds = (time.process_time() - start) / arguments.count
    count = {kind: sum(said[kind].values()) for kind in KINDS}
    print("| drawn | trials | right | right or in its group | said |\n| --- | --- | --- | --- | --- |")
    for kind in KINDS:
        words = ", ".join(f"{name}: {n}" for name, n in said[kind].most_common())
        print(f"| {kind} | {count[kind]} | {first[kind]} | {grouped[kind]} | {words} |")
    effects = sum(count[kind] for kind in KINDS if kind != "none")
    print(f"\nright effect alone {sum(first[k] for k in KINDS if k != 'none')} of {effects}, right or in its group "
          f"{sum(grouped[k] for k in KINDS if k != 'none')}, number within 3 standard deviations {right_number}, "
          f"false alarms {count['none'] - first['none']} of {count['none']}; {seconds:.2f} s of CPU time a trial")


def _share(kind: str) -> float:
    """The first coefficient as a share of the drawn size."""
    return 0.5 if kind == "camera_offset" else 1.0


if __name__ == "__main__":
    main()
