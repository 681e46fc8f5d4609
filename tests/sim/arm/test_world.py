"""World settings: checked, named when wrong, switchable one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.world import TABLE_KEYS, World


@pytest.mark.parametrize("name", ["kr6", "kr15", "manutec_r15"])
def test_the_default_world_is_not_kind(name: str) -> None:
    world = World.default(name)
    assert world.elasticity
    assert world.friction
    assert world.thermal
    assert world.quantisation
    assert world.correction_delay
    assert world.torque_limits
    assert world.low_pass > 0
    assert world.inertia_tolerance >= 0.1
    for effect in ("current_noise", "degressive", "stribeck", "load_friction", "torque_ripple", "damping"):
        assert np.all(world.per_joint(effect, 6) > 0)


def test_the_ideal_world_has_nothing_on() -> None:
    world = World.ideal("kr15")
    for switch in ("elasticity", "friction", "thermal", "quantisation", "correction_delay", "torque_limits"):
        assert getattr(world, switch) is False
    for size in ("low_pass", "current_lag", "inertia_tolerance", "drive_gain_error", "payload_mass"):
        assert getattr(world, size) == 0.0
    for effect in ("current_noise", "torque_ripple", "backlash"):
        assert np.all(world.per_joint(effect, 6) == 0)


def test_a_table_changes_what_it_names_only() -> None:
    world = World.from_table("kr6", {"stiffness": [1e5] * 6, "friction_scale": 0.5, "individual": 7, "low_pass": 0})
    assert world.per_joint("stiffness", 6).tolist() == [1e5] * 6
    assert world.individual == 7
    unchanged = world.replace(stiffness=World.default("kr6").stiffness, friction_scale=1.0, individual=1,
                              low_pass=World.default("kr6").low_pass)
    assert unchanged == World.default("kr6")
    assert World.from_table("kr6", {"ideal": True, "friction": True}) == World.ideal("kr6").replace(friction=True)
    assert World.from_table("kr6", World.default("kr6").table()) == World.default("kr6")


def test_an_unknown_key_is_named_with_the_allowed_ones() -> None:
    with pytest.raises(InputError, match=r"stifness: unknown key; allowed here are ideal, .*stiffness") as caught:
        World.from_table("kr6", {"stifness": 1e5})
    assert caught.value.field == "world.stifness"
    assert "extra_torque" not in TABLE_KEYS


@pytest.mark.parametrize(("key", "value"), [
    ("friction", 1), ("individual", 1.5), ("individual", -1), ("stiffness", -1.0), ("stiffness", "soft"),
    ("stiffness", [1e5, [2]]), ("low_pass", [0.1]), ("low_pass", float("nan")), ("damping", float("inf")),
    ("inertia_tolerance", 1.5), ("t_ipo", 0.0123), ("t_ipo", 0.013), ("log_cycle", 0.0), ("payload_com", [0, 1]),
    ("time_compression", -1), ("payload_mass", True), ("ideal", "yes"), ("log_cycle", 1e-320), ("t_ipo", 360.0),
])
def test_wrong_values_are_refused_by_name(key: str, value: Any) -> None:
    with pytest.raises(InputError, match=rf"world\.{key}"):
        World.from_table("kr6", {key: value})


def test_lists_must_fit_the_robot() -> None:
    with pytest.raises(InputError, match="one per joint"):
        World.default("kr6").replace(backlash=[0.0, 0.1]).per_joint("backlash", 6)


def test_no_world_for_an_unknown_robot() -> None:
    with pytest.raises(InputError, match="kr6"):
        World.default("kr7")


URDF = """<robot name="two"><link name="a"/><link name="b"><inertial><origin xyz="0.3 0 0"/><mass value="5"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0.01" izz="0.2"/></inertial></link><link name="c"><inertial>
<origin xyz="0 0 0.1" rpy="0.3 0 0"/><mass value="2"/><inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.02" iyz="0"
izz="0.01"/></inertial></link><link name="tip"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="{effort}" velocity="2"/></joint>
<joint name="k" type="{second}"><parent link="b"/><child link="c"/><origin xyz="0.6 0 0" rpy="0 0.4 0"/>
<axis xyz="0 0.6 0.8"/><limit lower="-1" upper="1" effort="{effort}" velocity="2"/></joint>
<joint name="f" type="fixed"><parent link="c"/><child link="tip"/><origin xyz="0 0 0.2"/></joint></robot>"""
DATA = "[joints]\ngear_ratio = [100, 100]\nrotor_inertia = [1e-4, 5e-5]\n"


@pytest.mark.parametrize("effort", [0, 300])
@pytest.mark.parametrize("second", ["revolute", "prismatic"])
@pytest.mark.parametrize("data", ["", DATA])
def test_any_arm_gets_a_world_that_it_can_move_in(tmp_path: Path, effort: int, second: str, data: str) -> None:
    urdf = tmp_path / "two.urdf"
    urdf.write_text(URDF.format(effort=effort, second=second))
    if data:
        urdf.with_suffix(".toml").write_text(data)
    world, robot = World.default(str(urdf)), Robot.load(urdf)
    assert np.all(world.per_joint("extra_rotor_inertia", 2) > 0) is np.bool(not data)
    with SimulatedArm(robot, world, np.random.default_rng(0), q0=np.array([0.1, 0.2])) as arm:
        for k in range(150):
            state = arm.cycle(np.array([0.1, 0.2]) + 0.1 * np.sin(np.pi * min(k, 100) / 100) ** 2)
        log = arm.history()
    np.testing.assert_allclose(state.q, [0.1, 0.2], atol=2e-3)
    assert np.abs(log["q_a"] - log["q_c"]).max() < 0.03
    assert np.all(np.ptp(log["q_a"], axis=0) > 0.08)


def test_replace_names_what_does_not_exist() -> None:
    with pytest.raises(InputError, match="no such effect"):
        World.default("kr6").replace(hysteresis=1.0)


def _cycles(count: int, **changes: Any) -> None:
    robot = Robot.load("kr6")
    with SimulatedArm(robot, World.default("kr6").replace(**changes), np.random.default_rng(0)) as arm:
        for k in range(count):
            arm.cycle(robot.home + 0.3 * np.sin(0.012 * k) ** 2)


def test_gears_without_dry_friction_are_a_world_too() -> None:
    _cycles(100, coulomb=0.0, stribeck=0.0)


@pytest.mark.parametrize("change", [{"damping": 360.0}, {"payload_mass": 1e6}])
def test_a_world_without_a_stable_motion_ends_in_one_line(change: dict[str, float]) -> None:
    with pytest.raises(IdealRobotError, match=r"unstable|too much for the step|cannot be integrated"):
        _cycles(400, **change)
