"""A million random cycles behind every feedforward: largest position, speed, acceleration and jerk beside the limits.

Run: ``python benchmarks/safe_commands.py --cycles 1000000`` (shared evenly by methods and inputs; seed 1).
"""

from __future__ import annotations

import argparse

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.execution.command_governor import ACCELERATION, CommandGovernor
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward, methods
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.models import shipped_model

INPUTS = ("jumps", "walk", "nan", "ends")


def horizon(kind: str, rng: np.random.Generator, robot: Robot, rows: int, k: int, before: Array) -> Array:
    """The next desired positions ``(rows, n)`` [rad]: jumps, walks, NaN, paths that end."""
    if kind == "walk":
        return np.asarray(before + np.cumsum(rng.normal(size=before.shape) * robot.v_max * robot.t_ipo, axis=0) * 0.3)
    if kind == "ends" and k % 40:
        return np.asarray(np.vstack([before[1:], before[-1:]]))
    fresh = rng.uniform(robot.q_min, robot.q_max, size=(rows, robot.n))
    if kind == "nan":
        fresh[rng.random(fresh.shape) < 0.02] = np.nan
    return fresh


def main() -> None:
    """Plays the cycles and prints one row a method and input."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=1_000_000)
    parser.add_argument("--robot", default="kr6")
    options = parser.parse_args()
    robot = Robot.load(options.robot)
    model, T = Model.load(shipped_model(options.robot)), robot.t_ipo
    keys = methods(Needs.MODEL)
    cycles = options.cycles // (len(keys) * len(INPUTS))
    jerk = 2.0 * ACCELERATION * robot.a_max / T
    middle, half = 0.5 * (robot.q_max + robot.q_min), 0.5 * (robot.q_max - robot.q_min)
    print(f"{'method':15s} {'input':7s} {'cycles':>8s}  largest share of the limits of p, v, a, jerk")
    for key in keys:
        for kind in INPUTS:
            rng, law = np.random.default_rng(1), feedforward(key, model, robot, n_d=10)
            governor, state = CommandGovernor(robot, robot.home), law.init(robot.home)
            ahead, path = np.tile(robot.home, (10, 1)), [robot.home] * 3
            worst = np.zeros(4)
            for k in range(cycles):
                ahead = horizon(kind, rng, robot, 10, k, np.nan_to_num(ahead, nan=0.0))
                try:
                    with np.errstate(all="ignore"):
                        q_c, after = law.step(state, ahead)
                except InputError:
                    # Refused by the feedforward itself: the arm brakes.
                    q_c, after = np.full(robot.n, np.nan), state
                state = after if np.isfinite(q_c).all() else law.init(path[-1])
                path = [*path[-3:], governor.allowed(q_c)]
                p = np.array(path)
                v = np.diff(p, axis=0) / T
                a = np.diff(v, axis=0) / T
                j = np.diff(a, axis=0) / T
                worst = np.maximum(worst, [np.max(np.abs(p[-1] - middle) / half), np.max(np.abs(v[-1]) / robot.v_max),
                                           np.max(np.abs(a[-1]) / (ACCELERATION * robot.a_max)),
                                           np.max(np.abs(j[-1]) / jerk)])
            print(f"{key:15s} {kind:7s} {cycles:8d}  " + "  ".join(f"{value:.6f}" for value in worst), flush=True)


if __name__ == "__main__":
    main()
