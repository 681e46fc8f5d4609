"""A million random cycles behind every feedforward and through the loop of line, force and devices: how near limits.

    python benchmarks/safe_commands.py --cycles 1000000

The cycles are shared evenly by methods and inputs; seed 1. Inputs: jumps anywhere in the joint range, random walks
beyond the limits, numbers that are none, paths that end. A share of 1 is the limit; exit code 1 where one is passed.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.execution.command_governor import ACCELERATION, CommandGovernor
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward, methods
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from scenes.cycle import CycleLog, CycleSettings, play_cycles
from scenes.models import shipped_model
from scenes.result import silent

INPUTS = ("jumps", "walk", "nan", "ends")
ROWS = 10
"""Rows of a horizon."""
PLAY = 50
"""Cycles of a play in the loop."""
ROUNDING = 1.0 + 1e-6


class Horizons:
    """Desired positions ``(ROWS, n)`` [rad] that no planner would ask for, one horizon a cycle.

    Args:
        kind: one of ``INPUTS``.
        robot: whose limits are passed.
        rng: draws them.
    """

    def __init__(self, kind: str, robot: Robot, rng: np.random.Generator) -> None:
        self._kind, self._robot, self._rng, self._k = kind, robot, rng, 0
        self._before = np.tile(robot.home, (ROWS, 1))

    def next(self) -> Array:
        """The horizon of the next cycle."""
        robot, rng, before = self._robot, self._rng, self._before
        if self._kind == "walk":
            # Sometimes within the limits, sometimes far beyond, never far from where the arm can be.
            steps = rng.normal(size=before.shape) * robot.v_max * robot.t_ipo * 10.0 ** rng.uniform(-2.0, 0.5)
            ahead = np.clip(before + np.cumsum(steps, axis=0), robot.q_min - 0.2, robot.q_max + 0.2)
        elif self._kind == "ends" and self._k % 40:
            ahead = np.vstack([before[1:], before[-1:]])
        else:
            ahead = rng.uniform(robot.q_min, robot.q_max, size=before.shape)
        self._k += 1
        self._before = ahead
        if self._kind == "nan":
            return np.where(rng.random(ahead.shape) < 0.02, np.nan, ahead)
        return ahead


class Shares:
    """The largest shares of the limits of position, speed, acceleration and jerk in commands seen so far."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self.worst, self.cycles = robot, np.zeros(4), 0

    def add(self, commands: Array) -> None:
        """Looks at consecutive commands ``(K, n)``; the first three were looked at before, or are the arm at rest."""
        robot, T = self._robot, self._robot.t_ipo
        middle, half = 0.5 * (robot.q_max + robot.q_min), 0.5 * (robot.q_max - robot.q_min)
        v = np.diff(commands, axis=0) / T
        a = np.diff(v, axis=0) / T
        jerk = np.diff(a, axis=0) / T
        limit = ACCELERATION * robot.a_max
        found = [np.abs(commands - middle) / half, np.abs(v) / robot.v_max, np.abs(a) / limit,
                 np.abs(jerk) / (2.0 * limit / T)]
        # NaN must not hide: it counts as infinite.
        self.worst = np.maximum(self.worst, [np.max(np.nan_to_num(share, nan=np.inf), initial=0.0) for share in found])
        self.cycles += len(commands) - 3


def behind(law: Feedforward, robot: Robot, kind: str, cycles: int) -> Shares:
    """Commands of a feedforward that is asked for impossible things, as the governor lets them pass."""
    horizons, shares = Horizons(kind, robot, np.random.default_rng(1)), Shares(robot)
    governor, state = CommandGovernor(robot, robot.home), law.init(robot.home)
    commands = [robot.home] * 3
    for k in range(cycles):
        try:
            with np.errstate(all="ignore"):
                q_c, after = law.step(state, horizons.next())
        except InputError:
            # Refused by the feedforward itself: the arm brakes.
            q_c, after = np.full(robot.n, np.nan), state
        commands.append(governor.allowed(q_c))
        state = after if np.isfinite(q_c).all() else law.init(commands[-1])
        if len(commands) > 2000 or k == cycles - 1:
            shares.add(np.array(commands))
            commands = commands[-3:]
    return shares


class _Impossible:
    """A task whose plan and commands are what ``Horizons`` says; a ``scenes.cycle.Task``."""

    n_d = ROWS

    def __init__(self, robot: Robot, horizons: Horizons) -> None:
        self._robot, self._horizons = robot, horizons

    @property
    def q_start(self) -> Array:
        return self._robot.home

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """Nothing is observed."""

    def plan(self, t: float, q_d: Array) -> Array:
        return self._horizons.next()

    def command(self, t: float, q_d: Array) -> Array:
        return q_d[0]

    def request(self, t0: float, t1: float) -> None:
        """Nothing is asked for."""

    def collect(self, t0: float, t1: float) -> None:
        """Nothing is collected."""

    def speed(self, t: float) -> float:
        return 0.5

    def done(self, t: float) -> bool:
        return False


class _Arm:
    """An arm that does what it is told and writes it down; a ``RobotInterface``."""

    def __init__(self, robot: Robot) -> None:
        self.t_ipo = robot.t_ipo
        self.commands = [robot.home] * 3

    def cycle(self, q_c: Array) -> RobotState:
        self.commands.append(np.array(q_c))
        return RobotState(self.t_ipo * len(self.commands), q_c, np.zeros(len(q_c)))


def through_loop(robot: Robot, kind: str, cycles: int) -> Shares:
    """Plays of the loop that line, force and devices share, each until it has stopped or ``PLAY`` cycles are over."""
    horizons, shares = Horizons(kind, robot, np.random.default_rng(1)), Shares(robot)
    while shares.cycles < cycles:
        arm = _Arm(robot)
        longest = (PLAY + 0.5) * robot.t_ipo
        play_cycles(arm, robot, _Impossible(robot, horizons), CycleLog(),
                    CycleSettings(5.0, 0.05, longest, longest, ""), silent)
        shares.add(np.array(arm.commands))
    return shares


def main() -> None:
    """Plays the cycles and prints one row a method and input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=1_000_000)
    parser.add_argument("--robot", default="kr6")
    options = parser.parse_args()
    robot = Robot.load(options.robot)
    model = Model.load(shipped_model(options.robot))
    keys = methods(Needs.MODEL)
    cycles = max(options.cycles // ((len(keys) + 1) * len(INPUTS)), PLAY)
    passed, total = False, 0
    print(f"{'method':15s} {'input':7s} {'cycles':>8s}  largest share of the limits of p, v, a, jerk")
    for key in (*keys, "cycle loop"):
        for kind in INPUTS:
            if key == "cycle loop":
                shares = through_loop(robot, kind, cycles)
            else:
                shares = behind(feedforward(key, model, robot, n_d=ROWS), robot, kind, cycles)
            passed |= bool(np.any(shares.worst > ROUNDING))
            total += shares.cycles
            print(f"{key:15s} {kind:7s} {shares.cycles:8d}  " + "  ".join(f"{value:.6f}" for value in shares.worst),
                  flush=True)
    print(f"{total} cycles, {'limits passed' if passed else 'no limit passed'}")
    sys.exit(passed)


if __name__ == "__main__":
    main()
