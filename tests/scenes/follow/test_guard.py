"""Whatever a motion wants: nothing presses hard, nothing rests pressing, and nothing goes on after a stop."""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import GRAVITY, Array
from ideal_robot.execution.following import Following
from ideal_robot.execution.guard import AWAY, BLIND, MARGIN, Guard, StoppedError, Watch
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from scenes.arms import model_at
from scenes.online.felt_force import WITHIN, FeltForce, Surface, stiffness_of
from scenes.online.journal import Journal
from scenes.online.live_arm import FollowStoppedError, LiveArm, moves
from scenes.online.live_sensors import LiveForce
from sensing.clock_relation import ClockRelation
from sensing.force.force_calibration import ToolLoad
from sensing.force.sensors import Reading, ReadingCounts
from tests.scenes.follow.pair import Tame

UP = np.array([0.0, 0.0, 1.0])
MOST = 40.0
LAG = 0.03
"""Time constant of the arm's loop [s]."""


class Wall(Tame):
    """An arm with a lag, the tip of whose tool meets a wall; a ``WrenchSource`` as well.

    Args:
        q: where it is held ``(n,)`` [rad].
        height: of the wall [m].
        stiffness: of wall and arm together [N/m].
        latency: of the sensor [s].
        mass: of the tool [kg].
        gain: of the sensor.
    """

    def __init__(self, q: Array, height: float, stiffness: float, latency: float, mass: float, seed: int,
                 gain: float = 1.0) -> None:
        super().__init__()
        self._gain = gain
        self.commanded = self.q = q.copy()
        self._height, self._stiffness, self._mass, self._fk = height, stiffness, mass, self.robot.fk()
        self._rng, self._latency = np.random.default_rng(seed), round(latency / self.t_ipo)
        self.bias = 10.0 * self._rng.standard_normal(6)
        self.true: list[float] = []
        self._late = deque([q] * 3, maxlen=3)
        self._queue: deque[Reading] = deque()
        self.counts, self.clock = ReadingCounts(), ClockRelation()  # type: ignore[assignment]
        self.force: LiveForce | None = None

    def receive(self) -> RobotState:
        state = super().receive()
        self._late.append(self.commanded)
        self.q = self.q + self.t_ipo / (LAG + self.t_ipo) * (self._late[0] - self.q)
        pose = self._fk(self.q)
        pushed = max(0.0, self._height - pose.translation[2]) * self._stiffness
        self.true.append(pushed)
        wrench = self.bias + 0.3 * self._rng.standard_normal(6)
        wrench[:3] += self._gain * pose.rotation.T @ (pushed * UP + self._mass * GRAVITY)
        self._queue.append(Reading(state.t, wrench))
        if len(self._queue) > self._latency and self.force is not None:
            reading = self._queue.popleft()
            self.clock.add(reading.stamp, self.arrived)
            self.force._readings.append((reading.stamp, reading.wrench))
        return RobotState(state.t, self.q.copy(), state.tau)

    def read(self, timeout: float) -> list[Reading]:
        time.sleep(timeout)
        return []

    def close(self) -> None:
        return


def connected(wall: Wall, folder: Path, weighed: bool) -> LiveArm:
    """A guarded arm at the wall."""
    robot = wall.robot
    arm = LiveArm(wall, Journal(folder, robot, {}))
    wall.force = force = LiveForce(wall, arm)  # type: ignore[arg-type]
    origin = robot.tool_places(robot.home[None])[0]
    E = stiffness_of(model_at("shipped", robot), robot, robot.home, UP)
    felt = FeltForce(force, robot, Surface(origin, UP, WITHIN, E), MOST)
    felt.tool = ToolLoad(wall.bias, wall._gain * wall._mass, np.zeros(3), np.zeros(2)) if weighed else None
    arm.at_begin.append(felt.begin)
    arm.guard.watches.append(felt)
    return arm


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 8))])
def test_no_motion_presses_on_a_surface_that_lies_elsewhere(seed: int, tmp_path: Path) -> None:
    """However stiff it is, and whatever the sensor's gain is that nobody has measured."""
    rng = np.random.default_rng(seed)
    robot = Robot.load("kr6")
    K, offset, weighed = 10.0 ** rng.uniform(2.5, 6), rng.uniform(-0.04, 0.04), seed % 2 == 0
    kinematics, z = InverseKinematics(robot), robot.tool_places(robot.home[None])[0][2]
    above = robot.home + kinematics.away(robot.home, 0.06 * UP)
    # Beside the way down the tool is turned, as on the way back from a posture in which it is weighed.
    begin = above + np.array([0.0, 0.0, 0.0, 0.1, 0.15, 0.2]) * rng.uniform(-1.0, 1.0, 6)
    E = stiffness_of(model_at("shipped", robot), robot, robot.home, UP)
    gain = (0.5, 1.0, 1.5)[seed % 3]
    wall = Wall(begin, z + offset, 1.0 / (1.0 / K + 1.0 / E), rng.uniform(0.0, 0.02), rng.uniform(0.1, 2.0), seed, gain)
    arm = connected(wall, tmp_path, weighed)
    arm.lead(np.tile(begin, (40, 1)))
    deep = robot.home - kinematics.away(robot.home, 0.01 * UP)
    ended = None
    try:
        arm.lead(moves(robot, [begin, deep], 0.1))
    except FollowStoppedError as error:
        ended = str(error)
    assert max(wall.true) <= MOST
    reached = offset > -0.01 + (5.0 if weighed else 15.0) / gain / min(K, E)
    assert (ended is not None) or not reached
    if ended is not None:
        assert "N felt" in ended
        # At rest nothing presses, and no other motion begins.
        assert wall.true[-1] == 0.0
        assert np.ptp(np.array(wall.taken)[-2:], axis=0).max() < 1e-6
        count = len(wall.taken)
        with pytest.raises(FollowStoppedError):
            arm.lead(moves(robot, [arm.q_d, begin], 0.1))
        assert len(wall.taken) == count
    speed = np.diff(np.array(wall.taken), axis=0) / robot.t_ipo
    assert (np.abs(np.diff(speed, axis=0)) / robot.t_ipo <= 1.5 * robot.a_max).all()
    arm_force: Any = wall.force
    arm_force.close()


class _Says(Watch):
    """Speaks up in one cycle; passes the middle of a path slowly."""

    def __init__(self, at: int, touches: int = 0, wanted: bool = False) -> None:
        self._at, self._touches, self._wanted, self.cycles = at, touches, wanted, 0

    def look(self, t: float, q_c: Array, q: Array) -> str | None:
        self.cycles += 1
        return "something" if self.cycles >= self._at else None

    @property
    def touching(self) -> bool | None:
        touches = self._at <= self.cycles < self._at + self._touches
        return touches or (None if self._wanted else False)

    def rates(self, rows: Array, T: float) -> Array:
        return np.where(np.abs(np.linspace(-1.0, 1.0, len(rows))) < 0.3, 0.05, 1.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_stop_keeps_the_arm_on_its_path_and_its_limits(seed: int) -> None:
    rng, link = np.random.default_rng(seed), Tame()
    robot = link.robot
    guard = Guard(robot, robot.home)
    rows = moves(robot, [robot.home, robot.home + rng.uniform(-0.5, 0.5, 6)], 0.1)
    guard.watches.append(_Says(int(rng.integers(5, len(rows))), int(rng.integers(0, 60))))

    def cycle(q_c: Array) -> RobotState:
        link.send(q_c)
        return link.receive()

    arm: Any = type("Arm", (), {"cycle": staticmethod(cycle)})
    with pytest.raises(StoppedError, match="something"):
        guard.lead(guard.around(arm), rows)
    taken = np.array([robot.home, robot.home, *link.taken])
    # Rest is a straight line in joint space here: on it, and slow again before the end.
    direction = (rows[-1] - rows[0]) / np.linalg.norm(rows[-1] - rows[0])
    beside = (taken - rows[0]) - np.outer((taken - rows[0]) @ direction, direction)
    assert np.abs(beside).max() < 1e-9
    acceleration = np.diff(taken, n=2, axis=0) / robot.t_ipo**2
    assert (np.abs(acceleration) <= 1.5 * robot.a_max).all()
    assert np.abs(taken[-1] - taken[-2]).max() < 1e-3 * robot.t_ipo


@pytest.mark.parametrize(("touches", "wanted"), [(0, False), (0, True), (30, False), (30, True)])
def test_the_way_back_ends_when_nothing_is_felt_any_more(touches: int, wanted: bool) -> None:
    """A tip that was pressing, and felt nothing then, went back for a minute through all that it had come."""
    link = Tame()
    robot = link.robot
    guard, rows = Guard(robot, robot.home), moves(robot, [robot.home, robot.home + 0.5], 0.1)
    guard.watches.append(_Says(len(rows) // 2, touches, wanted))

    def cycle(q_c: Array) -> RobotState:
        link.send(q_c)
        return link.receive()

    arm: Any = type("Arm", (), {"cycle": staticmethod(cycle)})
    with pytest.raises(StoppedError, match="something"):
        guard.lead(guard.around(arm), rows)
    places = robot.tool_places(np.array(link.taken))
    farthest = int(np.argmax(np.linalg.norm(places - places[0], axis=1)))
    back = float(np.linalg.norm(np.diff(places[farthest:], axis=0), axis=1).sum())
    touched, margin = AWAY * robot.t_ipo * touches, BLIND if wanted else MARGIN * (touches > 0)
    assert back <= touched + margin + AWAY * 0.2
    assert back >= margin - 1e-3


class _Paused:
    """Has an arm stand still from one cycle to another though packets go on."""

    def __init__(self, wall: Wall, since: int, until: float) -> None:
        self._wall, self._receive, self._cycles, self._held = wall, wall.receive, (since, until), np.empty(0)

    def receive(self) -> RobotState:
        since, until = self._cycles
        if not since <= len(self._wall.taken) < until:
            return self._receive()
        self._held = self._held if len(self._held) else self._wall.q
        # The controller's own command waits as well, until it is let go on.
        self._wall._late.append(self._held)
        state = Tame.receive(self._wall)
        self._wall.q = self._held
        return RobotState(state.t, self._held.copy(), state.tau)

    @property
    def held(self) -> Array:
        return self._held


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("pause", [0.3, 3.0, np.inf])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_an_arm_that_stands_is_waited_for_and_goes_on_from_where_it_is(seed: int, pause: float, known: bool,
                                                                        tmp_path: Path) -> None:
    """Also where its loop was not identified; what it has to make good when it is let go on is nothing."""
    rng, robot = np.random.default_rng(seed), Robot.load("kr6")
    wall = Wall(robot.home, -10.0, 1e3, 0.0, 1.0, seed)
    arm = LiveArm(wall, Journal(tmp_path, robot, {}))
    arm.guard.patience = 6.0
    response = np.diff((1.0 - (LAG / (LAG + arm.t_ipo)) ** np.maximum(np.arange(-2.0, 30.0), 0.0))[:, None]
                       * np.ones(robot.n), axis=0, prepend=0.0)
    arm.guard.watches.append(Following(lambda: wall.commanded, robot, response if known else None))
    rows = moves(robot, [robot.home, robot.home + rng.choice([-1.0, 1.0], 6) * rng.uniform(0.4, 0.5, 6)], 0.1)
    since = int(rng.integers(len(rows) // 3, len(rows) // 2))
    paused = _Paused(wall, since, since + pause / arm.t_ipo)
    wall.receive = paused.receive  # type: ignore[method-assign]
    if np.isinf(pause):
        with pytest.raises(FollowStoppedError, match=r"stands still.* waited for it for 6 s"):
            arm.lead(rows)
    else:
        arm.lead(rows)
    taken = np.array(wall.taken)
    # Soon back at the arm, and from then on so near that it tears at nothing when it is let go on.
    late = taken[since + round(0.5 / arm.t_ipo) : since + round(pause / arm.t_ipo) if np.isfinite(pause) else None]
    assert np.abs(late - paused.held).max(initial=0.0) < np.radians(0.2)
    acceleration = np.diff(taken, n=2, axis=0) / robot.t_ipo**2
    assert (np.abs(acceleration) <= 1.5 * robot.a_max).all()
    if pause == 3.0:
        makes_good = np.abs(taken[since + round(pause / arm.t_ipo) - 1] - paused.held)
        assert (makes_good / robot.t_ipo**2 <= 1.5 * robot.a_max).all()
    if np.isinf(pause):
        assert np.abs(taken[-1] - paused.held).max() < 1e-7
    else:
        np.testing.assert_allclose(taken[-1], rows[-1], atol=1e-9)
        # On the path all the time: rest to rest is a straight line here.
        direction = (rows[-1] - rows[0]) / np.linalg.norm(rows[-1] - rows[0])
        beside = (taken - rows[0]) - np.outer((taken - rows[0]) @ direction, direction)
        assert np.abs(beside).max() < 1e-3


@pytest.mark.parametrize("pause", [0.3, 1.0])
def test_what_goes_along_with_a_path_waits_with_the_arm(pause: float, tmp_path: Path) -> None:
    """The gears' deflection, and the number of a row, by which a calibration knows what it looks at."""
    robot = Robot.load("kr6")
    wall = Wall(robot.home, -10.0, 1e3, 0.0, 1.0, 0)
    arm = LiveArm(wall, Journal(tmp_path, robot, {}))
    arm.guard.watches.append(Following(lambda: wall.commanded, robot, None))
    rows = moves(robot, [robot.home, robot.home + 0.45], 0.5)
    wall.receive = _Paused(wall, len(rows) // 3, len(rows) // 3 + pause / arm.t_ipo).receive  # type: ignore[method-assign]
    passed = []
    with arm.motion():
        for q_c, row in arm.guard.steps(rows, np.arange(float(len(rows)))):
            passed.append((arm.guard.held is None, row, *q_c))
            arm.cycle(q_c)
    free, row = np.array(passed)[:, 0] > 0.0, np.array(passed)[:, 1]
    assert row[0] == 0.0
    assert row[-1] == len(rows) - 1
    assert len(passed) > len(rows) + pause / arm.t_ipo
    on_path = np.array([np.interp(row, np.arange(len(rows)), column) for column in rows.T]).T
    assert np.abs(np.array(passed)[free, 2:] - on_path[free]).max() < 1e-3
    # Led back to the arm it goes back once, and else on.
    assert np.sum(np.diff(row) < 0.0) <= 1


def test_a_slow_part_of_a_path_is_reached_and_left_within_the_limits() -> None:
    robot = Robot.load("kr6")
    guard = Guard(robot, robot.home)
    guard.watches.append(_Says(10**9))
    rows = moves(robot, [robot.home, robot.home + 0.4], 0.1)
    timed = guard.timed(rows)
    speed = np.diff(timed, axis=0) / robot.t_ipo
    usual = np.diff(rows, axis=0) / robot.t_ipo
    middle = np.abs(timed[:-1, 0] - robot.home[0] - 0.2) < 0.05
    assert np.abs(speed[middle]).max() <= 0.06 * np.abs(usual).max()
    assert (np.abs(np.diff(speed, axis=0)).max(axis=0) / robot.t_ipo <= robot.a_max).all()
    np.testing.assert_allclose(timed[[0, -1]], rows[[0, -1]])
