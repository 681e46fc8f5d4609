"""Other controllers than the cascade hold and move the arm; commands are as late and as smooth as the world says."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array, eased
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from sim.arm.arm import SimulatedArm
from sim.arm.controllers import CommandPath
from sim.arm.world import World

ROBOT = Robot.load("kr6")
WAY = np.array([0.1, -0.08, 0.07, 0.05, -0.06, 0.09])


def played(world: World, seconds: float = 1.2) -> tuple[Recording, Array]:
    """The recording of a movement of ``WAY`` and a rest behind it, and where the motors ended."""
    share = eased(np.clip(np.arange(0.0, seconds, world.t_ipo) / 0.6, 0.0, 1.0))[:, None]
    with SimulatedArm(ROBOT, world, np.random.default_rng(1)) as arm:
        for q_c in ROBOT.home + share * WAY:
            arm.cycle(q_c)
        return arm.recording(), arm.truth.q_m


@pytest.mark.parametrize("controller", ["cascade", "impedance", "pid", "inverse_dynamics"])
@pytest.mark.parametrize("ideal", [True, False])
def test_each_controller_moves_the_arm_where_it_is_told(controller: str, ideal: bool) -> None:
    begin = World.ideal if ideal else World.default
    _, end = played(begin("kr6").replace(controller=controller))
    # Without an integrator the arm stays where friction, and masses that its maker does not know, leave it.
    error = np.abs(end - ROBOT.home - WAY)
    assert np.all(error < {"cascade": 2e-3, "pid": 6e-3}.get(controller, 0.06))
    if ideal and controller != "inverse_dynamics":
        assert np.all(error < 1e-3)


def test_controllers_differ_and_the_usual_one_is_the_cascade() -> None:
    world = World.default("kr6")
    usual, own = (played(w, 0.3)[0].joints("q") for w in (world, world.replace(controller="cascade")))
    assert np.array_equal(usual, own)
    others = [played(world.replace(controller=name), 0.3)[0].joints("q") for name in ("impedance", "pid")]
    assert all(np.max(np.abs(other - usual)) > 1e-4 for other in others)


@pytest.mark.parametrize("smoothing", ["lag", "second_order", "moving_average"])
@pytest.mark.parametrize("late", [0.0, 0.005, 0.031])
@pytest.mark.parametrize("time", [0.02, 0.09])
def test_a_ramp_of_commands_comes_as_late_as_it_is_said(smoothing: str, late: float, time: float) -> None:
    world = World.default("kr6").replace(command_late=late, command_smoothing=smoothing, command_time=time)
    path = CommandPath.of(world)
    assert path is not None
    path.reset(np.zeros(6))
    for k in range(1, 200):
        seen = path.next(np.full(6, k * world.t_ipo))
    behind = 199 * world.t_ipo - seen
    assert behind == pytest.approx(late + (0.5 if smoothing == "moving_average" else 1.0) * time, rel=1e-6)
    for _ in range(200):
        seen = path.next(np.full(6, 199 * world.t_ipo))
    assert seen == pytest.approx(199 * world.t_ipo)


def test_the_recording_holds_commands_as_they_were_handed_over_and_the_arm_comes_late() -> None:
    world = World.default("kr6")
    usual, late = (played(w)[0] for w in (world, world.replace(command_late=0.024)))
    shift = round(0.024 / world.log_cycle)
    assert late.joints("q_c") == pytest.approx(usual.joints("q_c"), abs=1e-12)
    moved = np.ptp(usual.joints("q"), axis=0).max()
    assert late.joints("q")[shift:] == pytest.approx(usual.joints("q")[:-shift], abs=1e-3 * moved)


@pytest.mark.parametrize(("key", "value"), [("controller", "fuzzy"), ("controller", 3), ("command_smoothing", "none"),
                                            ("command_late", -0.1), ("command_time", 2.0)])
def test_what_no_controller_has_is_refused(key: str, value: object) -> None:
    with pytest.raises(InputError) as raised:
        World.from_table("kr6", {key: value})
    assert raised.value.field == f"world.{key}"
