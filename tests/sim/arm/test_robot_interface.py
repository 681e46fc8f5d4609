"""The laws of ``RobotInterface``, over the simulated arm itself and over one behind KUKA RSI and UR's RTDE."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, LimitError
from ideal_robot.robots.interface import RobotInterface
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.rtde import RtdeRobot
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rtde_controller import RtdeController
from tests.sim.devices.controllers import PATIENCE, controlled, serving

ROBOT = Robot.load("kr6")
KINDS = ("simulated", "rsi_absolute", "rsi_relative", "rtde")


def opened(kind: str, world: World, stack: ExitStack) -> RobotInterface:
    arm = stack.enter_context(SimulatedArm(ROBOT, world, np.random.default_rng(3)))
    if kind == "simulated":
        return arm
    if kind == "rtde":
        controller = stack.enter_context(serving(RtdeController(arm, timeout=PATIENCE)))
        host, port = controller.address
        rtde = stack.enter_context(RtdeRobot(ROBOT, host, port=port, timeout=PATIENCE))
        rtde.connect()
        return rtde
    relative = kind == "rsi_relative"
    link = stack.enter_context(RsiRobot(ROBOT, port=0, relative=relative, timeout=PATIENCE))
    stack.enter_context(controlled(arm, link.address[1], relative=relative))
    link.connect(PATIENCE)
    return link


@pytest.fixture(params=KINDS)
def interface(request: pytest.FixtureRequest) -> Iterator[RobotInterface]:
    with ExitStack() as stack:
        yield opened(request.param, World.ideal("kr6"), stack)


def ramp(cycles: int) -> Array:
    share = np.clip(np.arange(1, cycles + 1) / cycles, 0.0, 1.0)[:, None]
    return np.asarray(ROBOT.home + share**2 * (3 - 2 * share) * np.array([0.1, -0.05, 0.08, 0.2, -0.1, 0.3]))


def test_a_cycle_is_a_cycle(interface: RobotInterface) -> None:
    states = [interface.cycle(ROBOT.home) for _ in range(4)]
    np.testing.assert_allclose([state.t for state in states], ROBOT.t_ipo * np.arange(1, 5), atol=1e-9)
    assert all(state.q.shape == state.tau.shape == (ROBOT.n,) for state in states)
    assert interface.t_ipo == ROBOT.t_ipo


def test_commanded_to_stay_it_stays(interface: RobotInterface) -> None:
    for _ in range(10):
        state = interface.cycle(ROBOT.home)
    np.testing.assert_allclose(state.q, ROBOT.home, atol=1e-4)


def test_it_goes_where_it_is_commanded(interface: RobotInterface) -> None:
    path = np.vstack([ramp(40), np.tile(ramp(40)[-1], (40, 1))])
    for q_c in path:
        state = interface.cycle(q_c)
    np.testing.assert_allclose(state.q, path[-1], atol=2e-4)


def test_what_cannot_be_commanded_is_refused_and_nothing_moves(interface: RobotInterface) -> None:
    interface.cycle(ROBOT.home)
    for bad in (np.zeros(5), np.full(6, np.nan)):
        with pytest.raises(InputError, match="6 finite"):
            interface.cycle(bad)
    with pytest.raises(LimitError, match=r"joint 2.*angle"):
        interface.cycle(np.where(np.arange(6) == 1, ROBOT.q_max + 0.01, ROBOT.home))
    with pytest.raises(LimitError, match=r"joint 4.*velocity"):
        interface.cycle(ROBOT.home + np.array([0, 0, 0, 1.0, 0, 0]))
    state = interface.cycle(ROBOT.home)
    np.testing.assert_allclose(state.q, ROBOT.home, atol=1e-4)
    assert state.t == pytest.approx(2 * ROBOT.t_ipo)


@pytest.mark.parametrize("kind", KINDS[1:])
def test_behind_a_controller_the_same_arm_moves_the_same(kind: str) -> None:
    """Same world, same seed: only the six decimals of a degree in the messages differ, and they must not add up."""
    world = World.default("kr6").replace(quantisation=False)
    seen = []
    for which in ("simulated", kind):
        with ExitStack() as stack:
            arm = opened(which, world, stack)
            if (which, kind) == ("simulated", "rtde"):
                # Until the registers are written, a cycle has passed behind RTDE.
                arm.cycle(ROBOT.home)
            seen.append([arm.cycle(q_c) for q_c in ramp(60)])
    direct, behind = seen
    np.testing.assert_allclose([s.q for s in behind], [s.q for s in direct], atol=1e-7)
    np.testing.assert_allclose([s.tau for s in behind], [s.tau for s in direct], atol=0.05)
