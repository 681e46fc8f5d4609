"""Playing a path on any arm: what is recorded, and what happens at a limit or when the arm is lost."""

from __future__ import annotations

import numpy as np
import pytest

import ideal_robot as ir
from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.execution.precorrect import path_at_cycles
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
    return ROBOT.home + size * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


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
    class Counting(type(ir.feedforward("none", None, ROBOT))):  # type: ignore[misc]
        def init(self, q0: Array) -> int:
            return 0

        def step(self, state: int, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, int]:
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


@pytest.mark.parametrize(("q_d", "field"), [(np.zeros(50), "q_d"), (np.full((50, 6), np.nan), "q_d"),
                                            (np.zeros((50, 5)), "q_d")])
def test_paths_that_cannot_be_played_are_refused_before_anything_moves(q_d: Array, field: str) -> None:
    arm = Follower()
    with pytest.raises(InputError) as caught:
        ir.play(arm, ir.feedforward("none", None, ROBOT), q_d, robot=ROBOT)
    assert caught.value.field == field
    assert not arm.commands


# A path at the cycles of a controller.

KR6 = Robot.load("kr6")


@pytest.mark.parametrize("duration", [1e-3, 0.5, 0.504, 0.5101])
def test_the_end_of_a_path_is_reached_wherever_in_a_cycle_it_lies(duration: float) -> None:
    """A path within one cycle was left out altogether, and none of its limits were looked at."""
    t = np.linspace(0.0, duration, 200)
    q = KR6.home + 0.05 * (t / duration)[:, None] ** 2
    times, positions = path_at_cycles(t, q, KR6, rest=0.12)
    np.testing.assert_allclose(np.diff(times), KR6.t_ipo)
    np.testing.assert_allclose(positions[0], q[0])
    np.testing.assert_allclose(positions[-1], q[-1], atol=1e-12)
