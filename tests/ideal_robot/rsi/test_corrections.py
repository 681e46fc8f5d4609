"""Corrections of the pose, against a controller that was written without the client's code."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.rsi.corrections import PoseCorrections, require_led
from ideal_robot.rsi.message import Axes, RobMessage, RsiFormat
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rsi_controller import ControllerRun
from sim.devices.rsi_pose import PoseMotion, matrix, numbers
from tests.sim.devices.controllers import ENDLESS, PATIENCE, controlled

KR6 = Robot.load("kr6")
RNG = np.random.default_rng(5)
TOOL, BASE = np.array([30.0, -20.0, 150.0, 20.0, -35.0, 10.0]), np.array([800.0, 100.0, 300.0, 30.0, 5.0, -10.0])


def arm_with(**table: Any) -> Robot:
    return dataclasses.replace(KR6, data={**KR6.data, "rsi": {**KR6.data["rsi"], **table}})


def path(k: int) -> Array:
    share = 0.5 - 0.5 * np.cos(np.pi * min(k / 120.0, 1.0))
    return np.asarray(KR6.home + share * np.array([0.12, -0.08, 0.1, 0.15, -0.1, 0.2]))


def led(robot: Robot, motion: PoseMotion, *, relative: bool, cycles: int = 160, lost: int = 0, faulty: bool = False,
        hold_on: bool = True, **options: Any) -> tuple[RsiRobot, list[RobotState], ControllerRun]:
    form = RsiFormat("RKorr", pose=True, hold_on=hold_on)
    states: list[RobotState] = []
    with ExitStack() as stack:
        link = stack.enter_context(RsiRobot(robot, port=0, relative=relative, form=form, timeout=PATIENCE))
        arm = stack.enter_context(SimulatedArm(robot, World.ideal("kr6"), np.random.default_rng(1), q0=KR6.home))
        future: Future[ControllerRun]
        count = ENDLESS if faulty else cycles + lost + 1
        with controlled(arm, link.address[1], count, relative=relative, pose=motion, **options) as future:
            link.connect(PATIENCE)
            for k in range(cycles):
                states.append(link.cycle(path(k)))
                if link.fault is not None:
                    break
            else:
                link.send(path(cycles))
        if link.fault is None:
            return link, states, future.result(PATIENCE)
    return link, states, ControllerRun(np.zeros((0, 6)), np.zeros(0), "")


@pytest.mark.parametrize(("relative", "in_tool", "base"), [
    (False, False, np.zeros(6)), (False, False, BASE), (False, True, BASE), (True, False, BASE), (True, True, BASE)])
def test_the_controller_commands_the_joints_that_were_wanted(relative: bool, in_tool: bool, base: Array) -> None:
    robot = arm_with(reference="tool" if in_tool else "base", base=base.tolist())
    link, states, run = led(robot, PoseMotion(robot, TOOL, base, in_tool), relative=relative)
    assert link.fault is None
    q = np.radians(run.commands) * [-1, 1, 1, -1, 1, -1]
    # A millionth of a degree or millimetre is what an answer can say; increments make good what was rounded.
    np.testing.assert_allclose(q[:100], [path(k) for k in range(100)], atol=2e-6)
    np.testing.assert_allclose(states[-1].q, path(200), atol=2e-3)


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("hold_on", [False, True])
def test_what_is_missed_is_made_good(relative: bool, hold_on: bool) -> None:
    if not relative and not hold_on:
        pytest.skip("refused: the arm would return to its start")

    def lost(cycle: int, packet: bytes) -> list[bytes]:
        return [] if cycle in (60, 61, 90) else [packet]

    robot = arm_with()
    # This controller holds the arm where it was: increments are not repeated.
    link, states, _ = led(robot, PoseMotion(robot, TOOL), relative=relative, disturbance=lost, lost=3, cycles=220,
                          hold_on=hold_on and not relative)
    assert link.fault is None
    assert link.counts.lost == 3
    np.testing.assert_allclose(states[-1].q, path(300), atol=2e-3)


@pytest.mark.parametrize(("told", "true"), [({}, {"base": BASE}), ({"reference": "tool"}, {}),
                                            ({"axis_sign": [1.0] * 6}, {})])
def test_a_frame_that_is_not_the_controllers_stops_the_arm_and_is_named(told: dict, true: dict) -> None:
    robot = arm_with(**told)
    link, states, _ = led(robot, PoseMotion(KR6, TOOL, **true), relative=False, faulty=True,
                          sign=(-1.0, 1.0, 1.0, -1.0, 1.0, -1.0))
    assert link.fault is not None
    assert "RIst" in link.fault or "joint" in link.fault
    # It is noticed before the tool is a centimetre away from where it shall be.
    motion = PoseMotion(KR6, TOOL)
    away = np.linalg.norm((np.linalg.inv(motion.pose(KR6.home)) @ motion.pose(states[-1].q))[:3, 3])
    assert away < 0.06


@pytest.mark.parametrize("seed", range(4))
def test_increments_lead_where_whole_corrections_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for reference in ("base", "tool"):
        robot = arm_with(reference=reference)
        axes = Axes.of(robot)
        corrections = PoseCorrections(robot, axes)
        held = axes.angles(KR6.home)
        pose = numbers(PoseMotion(robot, TOOL).pose(KR6.home))
        corrections.begin(held, RobMessage(1, held, pose=pose))
        a, b = (corrections.of(KR6.home + 0.2 * rng.normal(size=6)) for _ in range(2))
        np.testing.assert_allclose(corrections.behind(a, corrections.between(a, b)), b, atol=1e-9)
        q = KR6.home + 0.1 * rng.normal(size=6)
        np.testing.assert_allclose(corrections.joints(corrections.of(q)), q, atol=1e-8)


def test_paths_that_poses_cannot_lead_are_refused_before_anything_moves() -> None:
    straight = KR6.home.copy()
    straight[4] = 0.0
    rows = KR6.home + np.linspace(0.0, 1.0, 50)[:, None] * (straight - KR6.home)
    for relative in (False, True):
        with pytest.raises(InputError, match=r"singularity.*AXISCORR"):
            require_led(rows, KR6, relative=relative, file="path.csv")
    turned = KR6.home + np.linspace(0.0, 1.0, 50)[:, None] * np.array([0, 0, 0, 0, 0, 2.0])
    with pytest.raises(InputError, match=r"quarter.*relative"):
        require_led(turned, KR6, relative=False, file="path.csv")
    require_led(turned, KR6, relative=True, file="path.csv")
    with pytest.raises(InputError, match=r"rsi\.reference"):
        PoseCorrections(arm_with(reference="seam"), Axes.of(KR6))


def test_an_external_axis_that_moves_stops_the_arm() -> None:
    held = Axes.of(KR6).angles(KR6.home)
    with RsiRobot(KR6, port=0, form=RsiFormat(held=("EK.E1",))) as link:
        link._first = RobMessage(1, held, external=np.array([100.0]))
        assert link._external(RobMessage(2, held, external=np.array([100.01]))) is None
        assert "E1 moves" in str(link._external(RobMessage(2, held, external=np.array([100.2]))))


def test_angles_turn_about_z_then_y_then_x() -> None:
    """A turns about Z, B about the new Y, C about the new X."""
    for _ in range(20):
        told = np.append(RNG.uniform(-500, 500, 3), RNG.uniform(-80, 80, 3))
        np.testing.assert_allclose(numbers(matrix(told)), told, atol=1e-9)
    np.testing.assert_allclose(matrix(np.array([0, 0, 0, 90.0, 0, 0]))[:3, 0], [0, 1, 0], atol=1e-12)


def test_another_arm_than_one_of_six_joints_is_refused() -> None:
    with pytest.raises(IdealRobotError, match="six axes"):
        PoseCorrections(dataclasses.replace(KR6, pinocchio=_without_last(KR6)), Axes(np.ones(5), np.zeros(5), True))


def _without_last(robot: Robot) -> Any:
    import pinocchio as pin

    return pin.buildReducedModel(robot.pinocchio, [robot.pinocchio.njoints - 1], robot.home)
