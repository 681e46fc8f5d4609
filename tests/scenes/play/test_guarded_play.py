"""What is noticed while a path is played: an arm that stands is waited for, one that touches something lets go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array, eased, held
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.robots.interface import TOLERANCE, RobotState
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from scenes.online.path_player import Felt, PathPlayer
from tests.scenes.follow.test_guard import UP, Wall

ROBOT = Robot.load("kr6")
T = ROBOT.t_ipo


@dataclass
class _Counts:
    cycles: int = 0


class Lockstep(Wall):
    """The arm at a wall as a ``LinkedRobot``; it stands still from one cycle to another."""

    tolerance, horizon, gone_on, settled = TOLERANCE, 0, 0, True
    fault = paused = None
    speed, notes, unanswered = 1.0, (), ()

    def __init__(self, q: Array, height: float, stiffness: float, standing: tuple[int, int] = (0, 0)) -> None:
        super().__init__(q, height, stiffness, 0.01, 1.0, 1)
        self.counts: Any = _Counts()
        self.meta: dict[str, Any] = {}
        self.player: Any = None
        self.standing, self.wire = standing, list[Array]()
        self.ahead: Array | None = None

    def receive(self) -> RobotState:
        if self.force is None and self.player._force is not None:
            self.force = self.player._force._force
        stands = self.standing[0] <= len(self.taken) < self.standing[1]
        before = self.q.copy()
        state = super().receive()
        if stands:
            self.q = before
            self._late.extend([before] * 3)
            state = RobotState(state.t, before.copy(), state.tau)
        self.wire.append(self.q.copy() if stands else self.commanded.copy())
        return state

    def cause(self, joint: int) -> str:
        return f"joint {joint + 1} does something else"

    def skip(self, q_c: Array) -> None:
        raise AssertionError("no cycle is lost here")


def path(way: Array, seconds: float = 1.5) -> Array:
    """From home along a way ``(n,)`` [rad] and rest at either end."""
    rows = ROBOT.home + eased(np.linspace(0.0, 1.0, round(seconds / T)))[:, None] * way
    return held(rows, before=60, after=60)


@pytest.mark.parametrize("pause", [0.4, 2.5])
def test_a_path_goes_on_from_where_the_arm_was_paused(pause: float) -> None:
    rng = np.random.default_rng(3)
    q_d = path(rng.choice([-1.0, 1.0], 6) * 0.5)
    since = len(q_d) // 2
    link = Lockstep(ROBOT.home, -10.0, 1e3, (since, since + round(pause / T)))
    player = link.player = PathPlayer(link, PassThrough(T), q_d, 60, patience=8.0)  # type: ignore[arg-type]
    run = player.played([])
    assert run.failure is None
    np.testing.assert_allclose(run.recording.joints("q")[-1], q_d[-1], atol=2e-3)
    assert run.details["guard"]["waited_s"] > 0.5
    # Every place that is recorded is one of the path: a straight line here.
    direction = (q_d[-1] - q_d[0]) / np.linalg.norm(q_d[-1] - q_d[0])
    commanded = run.recording.joints("q_c") - q_d[0]
    assert np.abs(commanded - np.outer(commanded @ direction, direction)).max() < 1e-3
    if pause > 1.0:
        # What the controller has to make good when the arm is let go on is no more than it may.
        bend = np.abs(np.diff(np.array(link.wire), n=2, axis=0)) / T**2 / ROBOT.a_max
        assert bend[since + round(0.5 / T) :].max() <= 1.5


def test_an_arm_that_stays_where_it_is_is_not_waited_for_without_end() -> None:
    q_d = path(np.full(6, 0.4))
    link = Lockstep(ROBOT.home, -10.0, 1e3, (len(q_d) // 2, 10**6))
    player = link.player = PathPlayer(link, PassThrough(T), q_d, 60, patience=3.0)  # type: ignore[arg-type]
    run = player.played([])
    assert run.failure is not None
    assert "stands still" in run.failure
    assert "waited for it for 3 s" in run.failure
    # Its commands are led to it as they were going: the next one was computed before the standstill was noticed.
    bend = np.abs(np.diff(np.array(link.taken), n=2, axis=0)) / T**2 / ROBOT.a_max
    assert bend.max() <= 1.5
    np.testing.assert_allclose(link.commanded, link.q, atol=1e-6)


@pytest.mark.parametrize("stiffness", [2e3, 2e4])
def test_a_path_that_touches_something_is_stopped_and_lets_go(stiffness: float) -> None:
    kinematics, z = InverseKinematics(ROBOT), ROBOT.tool_places(ROBOT.home[None])[0][2]
    q_d = path(-kinematics.away(ROBOT.home, 0.03 * UP), 4.0)
    link = Lockstep(ROBOT.home, z - 0.015, stiffness)
    player = link.player = PathPlayer(link, PassThrough(T), q_d, 60, felt=Felt(link))  # type: ignore[arg-type]
    run = player.played([])
    assert run.failure is not None
    assert "N felt by the force sensor" in run.failure
    # Noticed at 15 N; what the tip goes on until it is answered is more on what is stiffer.
    assert max(link.true) < 15.0 + 0.003 * stiffness
    assert link.true[-1] == 0.0
    assert run.details["guard"]["largest_force_N"] == pytest.approx(max(link.true), abs=3.0)
