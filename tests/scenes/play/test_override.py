"""The controller's override, its pauses, its stops and how it is mounted, on our UR controller in lockstep."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array, eased, held
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.rtde import RtdeRobot
from scenes.online.path_player import PathPlayer, PathRun
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rtde_controller import RtdeController, RtdeFaults
from tests.sim.devices.controllers import serving

ROBOT = Robot.load("kr6")
T = ROBOT.t_ipo
REST = 20
WAY = np.array([0.5, -0.3, 0.4, 0.6, -0.4, 0.7])


def path(seconds: float = 2.5) -> Array:
    rows = ROBOT.home + eased(np.linspace(0.0, 1.0, round(seconds / T)))[:, None] * WAY
    return held(rows, before=REST, after=REST)


@contextmanager
def arm(robot: Robot = ROBOT, **faults: Any) -> Iterator[RtdeRobot]:
    with (SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as simulated,
          serving(RtdeController(simulated, RtdeFaults(**faults), timeout=5.0)) as controller,
          RtdeRobot(robot, controller.address[0], port=controller.address[1], timeout=5.0) as link):
        yield link


def played(patience: float = 8.0, **faults: Any) -> tuple[PathRun, RtdeRobot]:
    with arm(**faults) as link:
        player = PathPlayer(link, PassThrough(T), path(), REST)
        return player.play(patience=patience), link


@cache
def unhindered() -> PathRun:
    """The path as it is played when nothing is in its way."""
    return played()[0]


def along(q: Array) -> tuple[Array, Array]:
    """How far along the path's way, in shares, and how far beside it [rad], each row of joint angles is."""
    share = (q - ROBOT.home) @ WAY / (WAY @ WAY)
    return share, np.abs(q - ROBOT.home - np.outer(share, WAY)).max(axis=1)


class Told(PassThrough):
    """Counts what it is told of its commands."""

    def __init__(self) -> None:
        super().__init__(T)
        self.given, self.paired = 0, list[int]()

    def init(self, q0: Array) -> Any:
        self.given = 0
        return super().init(q0)

    def step(self, state: Any, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, Any]:
        self.given += 1
        return super().step(state, q_d, tau_ext_d)

    def observe(self, state: Any, measured: RobotState) -> Any:
        self.paired.append(self.given - len(self.paired))
        return state


def test_a_feedforward_is_told_what_came_of_its_last_command_before_the_next() -> None:
    told = Told()
    with arm() as link:
        run = PathPlayer(link, told, path(), REST).play(patience=8.0)
    assert run.failure is None
    assert len(told.paired) > len(path()) - 2
    assert set(told.paired) == {1}


@pytest.mark.parametrize(("begins", "override"), [
    (60, 0.6), pytest.param(0, 0.3, marks=pytest.mark.slow), pytest.param(110, 0.75, marks=pytest.mark.slow)])
def test_a_path_is_slowed_along_itself_by_the_override(begins: int, override: float) -> None:
    plain = unhindered()
    run, link = played(speed={begins: override})
    assert run.failure is None
    assert link.speed == override
    assert run.details["guard"]["least_speed"] == pytest.approx(override)
    q_d, q = run.recording.joints("q_d"), run.recording.joints("q")
    for rows, beside in ((q_d, 1e-4), (q, 2e-3)):
        share, off = along(rows)
        assert off.max() < beside
        assert share[-1] == pytest.approx(1.0, abs=2e-3)
    # At each place of the path the arm has the override's share of the speed that it has without.
    speeds = []
    for one in (plain, run):
        share = along(one.recording.joints("q_d"))[0]
        speeds.append(np.interp([0.65, 0.75, 0.85], share[1:], np.diff(share)))
    np.testing.assert_allclose(speeds[1] / speeds[0], override, rtol=0.02)
    bend = np.abs(np.diff(run.recording.joints("q_c"), 2, axis=0)) / T**2
    assert np.all(bend <= ROBOT.a_max)


def test_it_goes_faster_again_where_the_override_rises() -> None:
    run, _ = played(speed={60: 0.2, 160: 1.0})
    plain = unhindered()
    assert run.failure is None
    # A hundred cycles at a fifth of the speed are eighty rows that come later.
    assert len(run.recording.t) - len(plain.recording.t) == pytest.approx(80, abs=12)


def test_an_override_of_nothing_is_not_waited_for_without_end() -> None:
    run, _ = played(patience=0.5, speed={100: 0.0})
    assert run.failure is not None
    assert "speed is at zero" in run.failure
    assert along(run.recording.joints("q"))[1].max() < 2e-3


@pytest.mark.parametrize("cycle", [100, *(pytest.param(cycle, marks=pytest.mark.slow) for cycle in (60, 85, 115, 130))])
def test_an_arm_whose_speed_was_set_to_zero_goes_on_along_its_path(cycle: int) -> None:
    run, _ = played(speed={cycle: 0.0, cycle + 150: 1.0})
    assert run.failure is None
    share, off = along(run.recording.joints("q"))
    assert share[-1] == pytest.approx(1.0, abs=2e-3)
    # Joints stand where they are, each as late as its loop is.
    assert off.max() < 5e-3
    assert run.details["guard"]["acceleration_share"] < 1.5


@pytest.mark.parametrize("pause", [range(90, 130), pytest.param(range(150, 260), marks=pytest.mark.slow)])
def test_a_paused_program_is_waited_for(pause: range) -> None:
    run, link = played(pauses=pause)
    assert run.failure is None
    assert link.paused is None
    share, off = along(run.recording.joints("q"))
    assert share[-1] == pytest.approx(1.0, abs=2e-3)
    assert off.max() < 5e-3
    assert run.details["guard"]["waited_s"] > 0.0


@pytest.mark.parametrize("cycle", [pytest.param(60, marks=pytest.mark.slow), 130])
def test_a_protective_stop_ends_on_the_path_and_is_named(cycle: int) -> None:
    run, _ = played(protective_stop=cycle)
    assert run.failure is not None
    assert "protective stop" in run.failure
    assert len(run.recording.t) >= cycle - 5
    share, off = along(run.recording.joints("q"))
    assert off.max() < 2e-3
    assert share[-1] < 1.0


@pytest.mark.parametrize(("gravity", "told"), [((0.0, 0.0, -9.81), False), ((9.81, 0.0, 0.0), True),
                                                  ((0.0, -5.0, -8.44), True), ((0.0, 0.0, 0.0), False)])
def test_how_the_arm_is_mounted_is_compared_with_the_urdf(gravity: tuple[float, float, float], told: bool) -> None:
    with arm(mounted=gravity) as link:
        link.connect(1.0)
        assert ("mount the URDF" in " ".join(link.notes)) == told
        assert link.meta["payload_kg"] == 1.5
        assert link.meta["payload_centre_m"] == [0.0, 0.01, 0.05]
        assert ("gravity_direction" in link.meta) == bool(np.any(gravity))


@pytest.mark.parametrize("unknown", [("payload",), ("speed_scaling", "target_speed_fraction", "payload_cog"),
                                     ("actual_tool_accelerometer",)])
def test_an_older_controller_that_does_not_know_all_of_it_is_led(unknown: tuple[str, ...]) -> None:
    with arm(unknown=unknown) as link:
        link.connect(1.0)
        assert link.cycle(ROBOT.home).columns["speed_scale"] == 1.0
        assert "payload_kg" not in link.meta or "payload" not in " ".join(unknown)
