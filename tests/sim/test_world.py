"""World settings: checked, named when wrong, switchable one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import InputError
from sim.world import TABLE_KEYS, World


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
    ("time_compression", -1), ("payload_mass", True), ("ideal", "yes"),
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


def test_replace_names_what_does_not_exist() -> None:
    with pytest.raises(InputError, match="no such effect"):
        World.default("kr6").replace(hysteresis=1.0)
