"""How near commands come to the limits, whatever is asked for in whichever loop.

The loops are those that the program runs: the governor behind the feedforward alone, the cycles that line, force and
devices share, a path on any arm, the server of a controller behind RSI, whose wire is in memory. Inputs: jumps anywhere
in the joint range, random walks beyond the limits, numbers that are none, paths that end.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import typer

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.execution.command_governor import ACCELERATION, CommandGovernor
from ideal_robot.execution.play import play
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward, methods, settings
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import RowLog
from ideal_robot.rsi import RsiRobot
from ideal_robot.rsi.link import LinkCounts, Stamps
from ideal_robot.rsi.message import RobMessage
from scenes.models import shipped_model
from scenes.online.cycle import CycleLog, CycleSettings, play_cycles
from scenes.result import silent
from scenes.rsi.server import RsiServer
from studies.report import head, row

INPUTS = ("jumps", "walk", "nan", "ends")
ROWS = 10
"""Rows of a horizon."""
PLAY = 50
"""Cycles of a play in a loop."""
ROUNDING = 1.0 + 1e-6


class _Horizons:
    """Desired positions ``(ROWS, n)`` [rad] that no planner would ask for, one horizon a cycle."""

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
        shares = [np.abs(commands - middle) / half, np.abs(v) / robot.v_max, np.abs(a) / limit,
                  np.abs(jerk) / (2.0 * limit / T)]
        # NaN must not hide: it counts as infinite.
        self.worst = np.maximum(self.worst, [np.max(np.nan_to_num(share, nan=np.inf), initial=0.0) for share in shares])
        self.cycles += len(commands) - 3


def _behind(law: Feedforward, robot: Robot, kind: str, cycles: int) -> Shares:
    """Commands of a feedforward that is asked for impossible things, as the governor lets them pass."""
    horizons, shares = _Horizons(kind, robot, np.random.default_rng(1)), Shares(robot)
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


class _Lawless(Feedforward):
    """A feedforward whose commands are no numbers now and then."""

    def __init__(self, law: Feedforward, rng: np.random.Generator) -> None:
        self.n_d, self.t_ipo = law.n_d, law.t_ipo
        self._law, self._rng = law, rng

    def init(self, q0: Array) -> Any:
        """See ``Feedforward``."""
        return self._law.init(q0)

    def step(self, state: Any, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, Any]:
        """See ``Feedforward``."""
        q_c, after = self._law.step(state, q_d, tau_ext_d)
        return np.where(self._rng.random(q_c.shape) < 0.005, np.nan, q_c), after


class _Impossible:
    """A task whose plan is what ``_Horizons`` says, behind a feedforward; a ``scenes.online.cycle.Task``."""

    n_d = ROWS

    def __init__(self, robot: Robot, horizons: _Horizons, law: Feedforward) -> None:
        self._robot, self._horizons, self._law = robot, horizons, law
        self._state = law.init(robot.home)

    @property
    def q_start(self) -> Array:
        return self._robot.home

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """Nothing is observed."""

    def plan(self, t: float, q_d: Array) -> Array:
        return self._horizons.next()

    def command(self, t: float, q_d: Array) -> Array:
        q_c, self._state = self._law.step(self._state, q_d[: self._law.n_d])
        return q_c

    def request(self, t0: float, t1: float) -> None:
        """Nothing is asked for."""

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """Nothing is collected."""

    def away(self, q_d: Array) -> None:
        """Nothing is pressed on."""

    def pacing(self, limits: Robot) -> None:
        """The arm never stands."""

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


class _Wire:
    """A controller in memory that takes every answer over: what ``RsiRobot`` sees of its link."""

    def __init__(self, robot: Robot, counts: LinkCounts) -> None:
        self.counts, self.arrived = counts, 0.0
        self._step, self._ipoc = round(1e3 * robot.t_ipo), 1000
        self.link: RsiRobot | None = None
        self.commands = [robot.home] * 3

    def next(self, deadline: Deadline) -> RobMessage:
        assert self.link is not None
        self._ipoc += self._step
        self.arrived += 1e-3 * self._step
        angles = self.link.axes.angles(self.commands[-1])
        return RobMessage(self._ipoc, angles, angles, np.zeros(len(angles)), 0)

    def newest(self, message: RobMessage, stamps: Stamps, most: int = 0) -> tuple[RobMessage, int]:
        return message, 0

    def send(self, answer: bytes) -> None:
        assert self.link is not None
        self.commands.append(np.array(self.link.commanded))

    def close(self) -> None:
        """Nothing was opened."""


def _through_cycles(law: Feedforward, robot: Robot, kind: str, cycles: int) -> Shares:
    """Plays of the loop that line, force and devices share, each until it has stopped or ``PLAY`` cycles are over."""
    rng = np.random.default_rng(1)
    horizons, shares = _Horizons(kind, robot, rng), Shares(robot)
    while shares.cycles < cycles:
        arm = _Arm(robot)
        longest = (PLAY + 0.5) * robot.t_ipo
        play_cycles(arm, robot, _Impossible(robot, horizons, law), CycleLog(),
                    CycleSettings(5.0, 0.05, longest, longest, ""), silent)
        shares.add(_at_rest(arm.commands))
    return shares


def _at_rest(commands: list[Array]) -> Array:
    """Commands with what an arm does that is given no further one: it stops where the last one led."""
    return np.array([*commands, *[commands[-1]] * 3])


def _path(kind: str, robot: Robot, rng: np.random.Generator) -> Array:
    """Desired positions ``(N, n)`` [rad] from home that begin like a path and turn into what no arm can do.

    ``walk`` leaves the limits, ``ends`` is over in full motion, others jump.
    """
    T, rows = robot.t_ipo, int(rng.integers(PLAY // 2, PLAY))
    push = rng.normal(size=(rows, robot.n)) * robot.a_max * 10.0 ** rng.uniform(-2.0, 0.5 if kind == "walk" else 0.0)
    smooth = np.cumsum(np.repeat(push[::5], 5, axis=0)[:rows], axis=0) * T
    q_d = robot.home + np.cumsum(np.clip(smooth, -robot.v_max, robot.v_max), axis=0) * T
    q_d[0] = robot.home
    if kind == "jumps":
        start = int(rng.integers(1, rows))
        q_d[start:] += rng.normal(size=robot.n) * 10.0 ** rng.uniform(-4.0, 0.0)
    if kind != "ends":
        q_d = np.vstack([q_d, np.tile(q_d[-1], (3, 1))])
    return np.asarray(q_d)


def _through_path(law: Feedforward, robot: Robot, kind: str, cycles: int) -> Shares:
    """Paths on an arm behind the positional interface, each until its end or until the arm rests."""
    rng, shares = np.random.default_rng(1), Shares(robot)
    used = _Lawless(law, rng) if kind == "nan" else law
    while shares.cycles < cycles:
        arm = _Arm(robot)
        # Some are refused before anything moved.
        with suppress(InputError):
            play(arm, used, _path(kind, robot, rng), robot=robot)
        if len(arm.commands) > 3:
            shares.add(_at_rest(arm.commands))
    return shares


def _through_rsi(law: Feedforward, robot: Robot, kind: str, cycles: int) -> Shares:
    """The same paths on a controller behind RSI, some stopped at a random moment."""
    rng, shares = np.random.default_rng(1), Shares(robot)
    used = _Lawless(law, rng) if kind == "nan" else law
    while shares.cycles < cycles:
        q_d = _path(kind, robot, rng)
        arm = _over_memory(robot, bool(rng.random() < 0.5))
        wire: Any = arm._link
        server = RsiServer(arm, used, q_d, 0)
        arm.connect()
        if rng.random() < 0.2:
            stop_at = int(rng.integers(1, PLAY))
            arm.send = _stopping(arm.send, server, stop_at)  # type: ignore[method-assign,assignment]
        # A run that ends with a reason has commanded something all the same.
        with suppress(IdealRobotError):
            arm.send(arm.commanded)
            # Beside the arm's own quantities the link reports currents.
            server._state = arm.receive()
            server._answer(q_d, RowLog(1 + 5 * robot.n), silent)
        shares.add(_at_rest(wire.commands))
    return shares


def _over_memory(robot: Robot, relative: bool) -> RsiRobot:
    """A ``RsiRobot`` whose packets never leave the process."""
    arm = RsiRobot(robot, port=0, relative=relative)
    arm.close()
    wire = _Wire(robot, arm.counts)
    wire.link = arm
    arm._link = wire  # type: ignore[assignment]
    return arm


def _stopping(send: Callable[[Array], None], server: RsiServer, cycle: int) -> Callable[[Array], None]:
    """``send`` that asks the server to stop after so many cycles."""
    remaining = [cycle]

    def stopped(q_c: Array) -> None:
        remaining[0] -= 1
        if remaining[0] == 0:
            server.stop("asked for")
        send(q_c)

    return stopped


LOOPS: dict[str, Callable[[Feedforward, Robot, str, int], Shares]] = {
    "governor": _behind, "line and force": _through_cycles, "path": _through_path, "RSI": _through_rsi}
"""Each plays a number of cycles of a method under an input."""


def limits(cycles: int = 1_000_000, robot: str = "kr6") -> None:
    """A million random cycles of every method in every loop: largest shares of the limits, 1 being the limit.

    The cycles are shared evenly by methods, loops and inputs; seed 1. Of the inputs the largest. Exit code 1 where a
    limit is passed.
    """
    arm, model = Robot.load(robot), Model.load(shipped_model(robot))
    keys = (*methods(Needs.MODEL), *settings(Needs.MODEL))
    each = max(-(-cycles // (len(keys) * len(LOOPS) * len(INPUTS))), PLAY)
    worst, total, begun = np.zeros(4), 0, time.process_time()
    head("method", "loop", "cycles", "position", "speed", "acceleration", "jerk")
    for key in keys:
        law = feedforward(key, model, arm, n_d=ROWS)
        for loop, through in LOOPS.items():
            shares = [through(law, arm, kind, each) for kind in INPUTS]
            most, count = np.max([share.worst for share in shares], axis=0), sum(share.cycles for share in shares)
            row(key, loop, count, *(f"{value:.6f}" for value in most))
            worst, total = np.maximum(worst, most), total + count
    passed = bool(np.any(worst > ROUNDING))
    print(f"\n{total} cycles in {time.process_time() - begun:.0f} s of processor time, "
          f"{'limits passed' if passed else 'no limit passed'}")
    raise typer.Exit(passed)
