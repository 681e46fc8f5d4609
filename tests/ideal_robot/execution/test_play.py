"""Playing a path on any arm: what is recorded, and what happens at a limit or when the arm is lost.

The law of all commands: whatever is asked for, every limit is kept, and what keeps them passes unchanged.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ideal_robot as ir
from ideal_robot.arrays import Array, eased
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.execution.command_governor import ACCELERATION, CommandGovernor
from ideal_robot.execution.precorrect import path_at_cycles
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward, methods
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from tests.sources import MODELS

ROBOT = ir.Robot.load("kr6")
MODEL = ir.Model.load(MODELS / "kr6.json")


class Follower:
    """An arm that is where it was commanded the cycle before, and breaks down after so many cycles."""

    t_ipo = ROBOT.t_ipo

    def __init__(self, lasts: int = 10_000) -> None:
        self.commands: list[Array] = []
        self.lasts = lasts

    def cycle(self, q_c: Array) -> RobotState:
        if len(self.commands) >= self.lasts:
            raise IdealRobotError("the cable is out")
        self.commands.append(q_c)
        return RobotState(self.t_ipo * len(self.commands), self.commands[max(len(self.commands) - 2, 0)], np.ones(6))


def path(size: float = 0.2, seconds: float = 1.0) -> Array:
    s = np.clip(np.linspace(-0.2, 1.2, round(1.4 * seconds / ROBOT.t_ipo)), 0.0, 1.0)[:, None]
    return ROBOT.home + size * eased(s)


def test_every_cycle_is_handed_over_and_recorded() -> None:
    arm, q_d = Follower(), path()
    law = ir.feedforward("ideal", MODEL, ROBOT)
    played = ir.play(arm, law, q_d, robot=ROBOT, meta={"who": "test"})
    assert played.failure is None
    np.testing.assert_array_equal(played.q_c, law.along(q_d))
    np.testing.assert_array_equal(np.array(arm.commands), played.q_c)
    recording = played.recording
    assert len(recording.t) == len(q_d) - 1
    np.testing.assert_allclose(recording.t, ROBOT.t_ipo * np.arange(1, len(q_d)))
    np.testing.assert_array_equal(recording.joints("q_c"), played.q_c[1:])
    np.testing.assert_array_equal(recording.joints("q")[1:], played.q_c[:-2])
    assert recording.meta["who"] == "test"


def test_observe_is_told_of_every_cycle() -> None:
    class Counting(PassThrough):
        def init(self, q0: Array) -> int:  # type: ignore[override]
            return 0

        def step(self, state: int, q_d: Array, tau_ext_d: Array | None = None  # type: ignore[override]
                 ) -> tuple[Array, int]:
            return q_d[0], state

        def observe(self, state: int, measured: RobotState) -> int:
            return state + 1

    q_d = path()
    assert ir.play(Follower(), Counting(ROBOT.t_ipo), q_d).state == len(q_d)


def test_at_a_limit_the_arm_comes_to_rest_on_the_path() -> None:
    arm = Follower()
    q_d = path(size=1.4, seconds=0.7)
    played = ir.play(arm, ir.feedforward("none", None, ROBOT), q_d, robot=ROBOT)
    assert played.failure is not None
    assert "velocity" in played.failure
    steps = np.diff(played.q_c, axis=0) / ROBOT.t_ipo
    assert np.all(np.abs(steps) <= ROBOT.v_max * (1 + 1e-9))
    assert np.max(np.abs(steps[-5:])) < 1e-6
    # On the path all joints move alike; where each brakes by its own limit they part a little.
    share = played.q_c - q_d[0]
    np.testing.assert_allclose(share, np.tile(share[:, :1], (1, 6)), atol=0.03)
    assert 0.0 < share[-1, 0] < 1.4


def test_a_lost_arm_ends_the_play_and_keeps_the_recording() -> None:
    played = ir.play(Follower(lasts=30), ir.feedforward("none", None, ROBOT), path())
    assert played.failure == "the cable is out"
    assert len(played.recording.t) == 29


class Broken(Follower):
    """Tells positions ``(q,)`` and torques ``(tau,)``."""

    def __init__(self, q: int, tau: int) -> None:
        super().__init__()
        self.q, self.tau = q, tau

    def cycle(self, q_c: Array) -> RobotState:
        super().cycle(q_c)
        return RobotState(self.t_ipo, np.zeros(self.q), np.zeros(self.tau))


@pytest.mark.parametrize(("q", "tau", "what"), [(5, 6, "q"), (6, 7, "tau")])
def test_a_driver_that_tells_of_other_joints_ends_the_play_in_the_first_cycle(q: int, tau: int, what: str) -> None:
    """At the end of the path its recording could not be made any more."""
    arm = Broken(q, tau)
    with pytest.raises(ir.InputError, match=f"cycle of Broken has to return a state with {what} of shape"):
        ir.play(arm, ir.feedforward("none", None, ROBOT), path(), robot=ROBOT)
    assert len(arm.commands) == 1


def test_a_driver_whose_clock_stands_still_ends_the_play_in_the_second_cycle() -> None:
    """Its recording could not be used by anything."""
    arm = Broken(6, 6)
    played = ir.play(arm, ir.feedforward("none", None, ROBOT), path(), robot=ROBOT)
    assert "its clock stands still" in str(played.failure)
    assert len(arm.commands) == 2


@pytest.mark.parametrize("q_d", [np.zeros(50), np.full((50, 6), np.nan), np.zeros((50, 5))])
def test_paths_that_cannot_be_played_are_refused_before_anything_moves(q_d: Array) -> None:
    arm = Follower()
    with pytest.raises(InputError) as caught:
        ir.play(arm, ir.feedforward("none", None, ROBOT), q_d, robot=ROBOT)
    assert caught.value.field == "q_d"
    assert not arm.commands


# A path at the cycles of a controller.

@pytest.mark.parametrize("duration", [1e-3, 0.5, 0.504, 0.5101])
def test_the_end_of_a_path_is_reached_wherever_in_a_cycle_it_lies(duration: float) -> None:
    """A path within one cycle was left out altogether, and none of its limits were looked at."""
    t = np.linspace(0.0, duration, 200)
    q = ROBOT.home + 0.05 * (t / duration)[:, None] ** 2
    times, positions, _ = path_at_cycles(t, q, ROBOT, rest=0.12)
    np.testing.assert_allclose(np.diff(times), ROBOT.t_ipo)
    np.testing.assert_allclose(positions[0], q[0])
    np.testing.assert_allclose(positions[-1], q[-1], atol=1e-12)


def _largest(robot: Robot, p: Array, jerk: Array) -> dict[str, float]:
    """How far a path of commands goes, as a share of each limit."""
    T = robot.t_ipo
    v = np.diff(p, axis=0) / T
    a = np.diff(v, axis=0) / T
    j = np.diff(a, axis=0) / T
    middle, half = 0.5 * (robot.q_max + robot.q_min), 0.5 * (robot.q_max - robot.q_min)
    return {"position": float(np.max(np.abs(p - middle) / half)), "speed": float(np.max(np.abs(v) / robot.v_max)),
            "acceleration": float(np.max(np.abs(a) / (ACCELERATION * robot.a_max))),
            "jerk": float(np.max(np.abs(j) / jerk))}


def _asked(kind: str, rng: np.random.Generator, robot: Robot, last: Array) -> Array:
    if kind == "jumps":
        return rng.uniform(3.0 * robot.q_min, 3.0 * robot.q_max)
    if kind == "walk":
        return np.asarray(last + rng.normal(size=robot.n) * robot.v_max * robot.t_ipo)
    if kind == "nan":
        return np.where(rng.random(robot.n) < 0.3, np.nan, rng.uniform(robot.q_min, robot.q_max))
    return np.full(robot.n, rng.choice([np.inf, -np.inf, 1e300, -1e300, 0.0]))


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("kind", ["jumps", "walk", "nan", "huge"])
@pytest.mark.parametrize("smooth", [False, True])
def test_every_limit_is_kept_under_any_input(name: str, kind: str, smooth: bool) -> None:
    robot, rng = Robot.load(name), np.random.default_rng(1)
    acceleration = np.where(np.isfinite(robot.a_max), robot.a_max, 1e3)
    jerk = (60.0 if smooth else 2.0 * ACCELERATION / robot.t_ipo) * acceleration
    start = 0.5 * (robot.q_min + robot.q_max)
    governor = CommandGovernor(robot, start, j_max=jerk)
    path = [start] * 3
    for _ in range(500):
        path.append(governor.allowed(_asked(kind, rng, robot, path[-1])))
    shares = _largest(robot, np.array(path), jerk)
    if not np.isfinite(robot.a_max).all():
        del shares["acceleration"]
    assert max(shares.values()) <= 1.0 + 1e-6, shares
    # What cannot be reached does not stop the arm from moving.
    assert kind == "nan" or np.ptp(np.array(path), axis=0).max() > 0.1


@settings(max_examples=60)
@given(st.lists(st.floats(-0.6, 0.6), min_size=6, max_size=6), st.floats(0.3, 3.0))
def test_what_keeps_the_limits_passes_bit_by_bit(amplitude: list[float], pace: float) -> None:
    start = ROBOT.home
    governor = CommandGovernor(ROBOT, start)
    s = np.clip(np.arange(300) / 250.0, 0.0, 1.0)
    path = start + 0.5 * np.outer(eased(s), amplitude) * min(pace, 1.0)
    for q in path:
        np.testing.assert_array_equal(governor.allowed(q), q)


def test_the_arm_rests_at_its_position_limit_when_driven_beyond() -> None:
    governor = CommandGovernor(ROBOT, ROBOT.home)
    for _ in range(2000):
        last = governor.allowed(2.0 * ROBOT.q_max)
    np.testing.assert_allclose(last, ROBOT.q_max, atol=1e-3)


def test_a_start_outside_the_limits_is_refused() -> None:
    with pytest.raises(InputError, match="within the joint limits"):
        CommandGovernor(ROBOT, 2.0 * ROBOT.q_max)


@pytest.mark.parametrize("key", methods(Needs.MODEL))
def test_every_feedforward_behind_it_keeps_the_limits(key: str) -> None:
    """Horizons that jump, end, and hold NaN; the feedforward may answer anything."""
    law, rng = feedforward(key, MODEL, ROBOT, n_d=10), np.random.default_rng(3)
    governor = CommandGovernor(ROBOT, ROBOT.home)
    state, path = law.init(ROBOT.home), [ROBOT.home] * 3
    horizon = np.tile(ROBOT.home, (10, 1))
    for k in range(400):
        if k % 20 == 0:
            horizon = np.tile(rng.uniform(ROBOT.q_min, ROBOT.q_max), (10, 1))
        if k % 97 == 50:
            horizon = np.full((10, 6), np.nan)
        try:
            with np.errstate(all="ignore"):
                q_c, after = law.step(state, horizon)
        except InputError:
            # Refused by the feedforward itself: the arm brakes.
            q_c, after = np.full(6, np.nan), state
        if np.isfinite(q_c).all():
            state = after
        path.append(governor.allowed(q_c))
    shares = _largest(ROBOT, np.array(path), 2.0 * ACCELERATION * ROBOT.a_max / ROBOT.t_ipo)
    assert max(shares.values()) <= 1.0 + 1e-6, shares


def test_no_command_is_outside_a_position_limit_by_so_much_as_rounding() -> None:
    """An arm refuses such a command and stops at once; seen where braking ends at the limit."""
    rng, governor = np.random.default_rng(5), CommandGovernor(ROBOT, ROBOT.home)
    goal = np.where(rng.random(ROBOT.n) < 0.5, ROBOT.q_min, ROBOT.q_max)
    for k in range(3000):
        if k % 150 == 0:
            goal = np.where(rng.random(ROBOT.n) < 0.5, ROBOT.q_min - 0.1, ROBOT.q_max + 0.1)
        command = governor.allowed(goal + 1e-3 * rng.normal(size=ROBOT.n))
        assert np.all((command >= ROBOT.q_min) & (command <= ROBOT.q_max))
