"""A million random cycles of every method in every loop: how near commands come to the limits.

    python benchmarks/safe_commands.py --cycles 1000000

The cycles are shared evenly by methods, loops and inputs; seed 1. Loops: the governor behind the feedforward alone, the
cycles that line and force share, a path on an arm, a controller behind RSI. Inputs: jumps anywhere in the joint range,
random walks beyond the limits, numbers that are none, paths that end. A share of 1 is the limit; exit code 1 where one
is passed.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402

from benchmarks.safe_loops import INPUTS, LOOPS, PLAY, ROWS  # noqa: E402
from ideal_robot.feedforward.method import Needs  # noqa: E402
from ideal_robot.feedforward.registry import feedforward, methods  # noqa: E402
from ideal_robot.model.model import Model  # noqa: E402
from ideal_robot.robots.robot import Robot  # noqa: E402
from scenes.models import shipped_model  # noqa: E402

ROUNDING = 1.0 + 1e-6


def main() -> None:
    """Plays the cycles and prints one row a method, loop and input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=1_000_000)
    parser.add_argument("--robot", default="kr6")
    options = parser.parse_args()
    robot = Robot.load(options.robot)
    model = Model.load(shipped_model(options.robot))
    keys, begun = methods(Needs.MODEL), time.process_time()
    cycles = max(-(-options.cycles // (len(keys) * len(LOOPS) * len(INPUTS))), PLAY)
    worst, total = np.zeros(4), 0
    print("| method | loop | input | cycles | position | speed | acceleration | jerk |\n"
          "| --- | --- | --- | --- | --- | --- | --- | --- |")
    for key in keys:
        law = feedforward(key, model, robot, n_d=ROWS)
        for loop, through in LOOPS.items():
            for kind in INPUTS:
                shares = through(law, robot, kind, cycles)
                worst, total = np.maximum(worst, shares.worst), total + shares.cycles
                print(f"| {key} | {loop} | {kind} | {shares.cycles} | "
                      + " | ".join(f"{value:.6f}" for value in shares.worst) + " |", flush=True)
    passed = bool(np.any(worst > ROUNDING))
    print(f"\n{total} cycles in {time.process_time() - begun:.0f} s of processor time, "
          f"{'limits passed' if passed else 'no limit passed'}: largest shares "
          + ", ".join(f"{value:.6f}" for value in worst))
    sys.exit(passed)


if __name__ == "__main__":
    main()
