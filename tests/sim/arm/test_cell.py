"""What an arm in a cell has beyond the default world: each effect alone, of the size that its key says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from sim.arm import kernel
from sim.arm.arm import SimulatedArm
from sim.arm.drive import drive_parameters, drive_start, notch, top_of
from sim.arm.specimen import draw_specimen
from sim.arm.structure import Structure
from sim.arm.world import OF_A_CELL, World
from tests.arms import written

ROBOT = Robot.load("kr6")
IDEAL = World.ideal("kr6")
ELASTIC = IDEAL.replace(elasticity=True)
STEP = 0.002


def arm_of(world: World, q0: Array | None = None, robot: Robot = ROBOT) -> SimulatedArm:
    return SimulatedArm(robot, world, np.random.default_rng(0), q0=q0)


def held(world: World, q0: Array) -> Array:
    """Torque ``(6,)`` [N m] that holds the arm at rest."""
    with arm_of(world, q0) as arm:
        return np.mean([arm.cycle(q0).tau for _ in range(60)][-20:], axis=0)


def moved_along(world: World, joint: int, angle: Any, cycles: int, q0: Array | None = None) -> dict[str, Array]:
    """Log of a motion of one joint (from 0) by ``angle(k)`` [rad] from ``q0``."""
    start = ROBOT.home if q0 is None else q0
    unit = np.eye(ROBOT.n)[joint]
    with arm_of(world, start) as arm:
        for k in range(cycles):
            arm.cycle(start + angle(k) * unit)
        return arm.history()


@pytest.mark.parametrize("elastic", [False, True])
@pytest.mark.parametrize("joint", [0, 3])
def test_gears_turn_unevenly_once_and_twice_per_turn(elastic: bool, joint: int) -> None:
    world = IDEAL.replace(elasticity=elastic, transmission_once=3e-4, transmission_twice=1.5e-4)
    start = ROBOT.home - 1.2 * np.eye(ROBOT.n)[joint]
    log = moved_along(world, joint, lambda k: 0.01 * (k - 20.0 * (1.0 - np.exp(-k / 20.0))), 260, start)
    steady = slice(800, None)
    q_m = log["q_m"][steady, joint]
    rows = [q_m**0, np.sin(q_m), np.cos(q_m), np.sin(2 * q_m), np.cos(2 * q_m)]
    twist = log["tau_gear"][steady, joint] / world.per_joint("stiffness", ROBOT.n)[joint] if elastic else 0.0
    fitted = np.linalg.lstsq(np.array(rows).T, log["q_a"][steady, joint] + twist - q_m, rcond=None)[0]
    assert np.hypot(*fitted[1:3]) == pytest.approx(3e-4, rel=0.15)
    assert np.hypot(*fitted[3:]) == pytest.approx(1.5e-4, rel=0.15)


@pytest.mark.parametrize("width", [2e-5, 2e-4])
@pytest.mark.parametrize("joint", [0, 4])
def test_the_loop_of_a_hysteretic_gear_is_as_wide_as_the_key_says(joint: int, width: float) -> None:
    """Links turned to and fro on motors that are too heavy to move: twist where the gear's torque is zero."""
    world = ELASTIC.replace(hysteresis=width, damping=0.0)
    heavy = replace(draw_specimen(ROBOT, world), rotor_inertia=np.full(ROBOT.n, 1e15))
    p, s, counts = drive_parameters(world, ROBOT, heavy)
    x = drive_start(p, np.zeros(ROBOT.n), np.zeros(ROBOT.n), np.zeros(ROBOT.n), np.full(ROBOT.n, 35.0))
    links, row, none = np.zeros((4, ROBOT.n)), np.zeros(1 + len(kernel.LOGGED) * ROBOT.n), np.zeros(ROBOT.n)
    twists, torques = 20.0 * width * np.sin(2.0 * np.pi * np.arange(4000) / 1000), []
    for tick, twist in enumerate(twists):
        links[kernel.L_ANGLE, joint] = -twist
        kernel.drive_step(tick, p, s, counts, x, links, none, row)
        torques.append(links[kernel.L_TORQUE, joint])
    later, torque = twists[1000:], np.array(torques[1000:])
    rising, falling = (np.interp(0.0, side * torque[up], later[up]) for side, up in
                       ((1.0, slice(750, 1250)), (-1.0, slice(1250, 1750))))
    assert abs(falling - rising) == pytest.approx(width, rel=0.1)


def test_a_soft_gear_is_softer_by_its_factor() -> None:
    sags = []
    for scale in (1.0, 0.5):
        with arm_of(ELASTIC.replace(stiffness_scale=(1.0, scale, 1.0, 1.0, 1.0, 1.0))) as arm:
            truth = arm.truth
            sags.append(truth.q_m - truth.q_a)
    assert sags[1][1] == pytest.approx(2.0 * sags[0][1], rel=0.02)
    assert sags[1][2] == pytest.approx(sags[0][2], rel=0.02)


@pytest.mark.parametrize("world", [IDEAL, ELASTIC], ids=["rigid", "elastic"])
def test_a_balancer_carries_joint_2_and_nothing_where_the_arm_stands_upright(world: World) -> None:
    top = top_of(ROBOT)
    for turn, wanted in ((0.0, 0.0), (0.5 * np.pi, 500.0)):
        q0 = ROBOT.home.copy()
        q0[1] = top + (turn if top + turn < ROBOT.q_max[1] else -turn)
        weight = pin.computeGeneralizedGravity(ROBOT.pinocchio, ROBOT.pinocchio.createData(), q0)[1]
        helped = held(world, q0) - held(world.replace(balancer=500.0), q0)
        assert abs(helped[1]) == pytest.approx(wanted, abs=6.0)
        assert wanted == 0.0 or np.sign(helped[1]) == np.sign(weight)
        np.testing.assert_allclose(np.delete(helped, 1), 0.0, atol=0.5)


def test_the_balancers_pressure_rises_with_its_stroke() -> None:
    """A gas spring is no sine: its torque at the same angle from top and bottom differs."""
    assert kernel.balancer_shape(0.5 * np.pi) == pytest.approx(1.0)
    assert kernel.balancer_shape(-0.7) == pytest.approx(-kernel.balancer_shape(0.7))
    assert abs(kernel.balancer_shape(0.7) - kernel.balancer_shape(np.pi - 0.7)) > 0.05


@pytest.mark.parametrize("axes", [((0, 0, 1), (0, 0, 1)), ((0, 1, 0), None)], ids=["vertical", "slides"])
def test_only_an_arm_whose_second_joint_carries_weight_has_a_balancer(tmp_path: Path, axes: Any) -> None:
    joint = "".join(
        f'<link name="l{i}"><inertial><mass value="2"/><origin xyz="0.2 0 0"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{i}" type="{"prismatic" if axis is None else "revolute"}"><parent link="l{i - 1}"/>'
        f'<child link="l{i}"/><origin xyz="0.3 0 0"/>'
        f'<axis xyz="{"1 0 0" if axis is None else " ".join(map(str, axis))}"/>'
        '<limit lower="-1" upper="1" effort="100" velocity="2"/></joint>' for i, axis in enumerate(axes, 1))
    text = (f'<robot name="two"><link name="l0"/>{joint}<link name="tool0"/><joint name="t" type="fixed">'
            '<parent link="l2"/><child link="tool0"/></joint></robot>')
    with pytest.raises(InputError, match="balance") as refused:
        top_of(Robot.load(str(written(tmp_path, text))))
    assert refused.value.field == "world.balancer"


def test_a_hose_pulls_home_and_turns_round_with_the_motion() -> None:
    free, pulled = (moved_along(IDEAL.replace(**hose), 4, lambda k: 0.5 * np.sin(np.pi * k / 300) ** 2, 320)
                    for hose in ({}, {"hose": (0.0, 0.0, 0.0, 0.0, 8.0, 0.0),
                                      "hose_friction": (0.0, 0.0, 0.0, 0.0, 2.0, 0.0)}))
    extra = (pulled["tau_motor"] - free["tau_motor"])[:, 4]
    angle = pulled["q_a"][:, 4] - ROBOT.home[4]
    for part, sign in ((slice(600, 800), 1.0), (slice(1350, 1600), -1.0)):
        np.testing.assert_allclose(extra[part], 8.0 * angle[part] + 2.0 * sign, atol=0.35)


# What bends between base and tool.

BENDING = IDEAL.replace(stiffness=3e5, link_bending=0.4)


def structure(world: World, q: Array) -> Structure:
    made = Structure.of(ROBOT, draw_specimen(ROBOT, world).model, world, STEP)
    assert made is not None
    made.reset(q, np.full(ROBOT.n, world.reference_temperature))
    return made


def pushed(world: World, q: Array, force: Array) -> Array:
    """By how much a force at the tool ``(3,)`` [N] moves it at rest ``(6,)`` [m, rad]."""
    bends, still = structure(world, q), np.zeros(ROBOT.n)
    before = bends.off
    bends.touch = force
    for _ in range(500):
        bends.update(q, still, np.full(ROBOT.n, world.reference_temperature))
    return bends.off - before


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_bending_is_that_of_springs(seed: int) -> None:
    """Its compliance at the tool is symmetric and positive (Betti): work does not depend on the order of forces."""
    q = ROBOT.home + np.random.default_rng(seed).uniform(-0.5, 0.5, ROBOT.n)
    world = BENDING.replace(column_stiffness=5e6, column_damping=0.5)
    compliance = np.array([pushed(world, q, 100.0 * unit)[:3] for unit in np.eye(3)]).T / 100.0
    np.testing.assert_allclose(compliance, compliance.T, atol=1e-3 * np.abs(compliance).max())
    assert np.linalg.eigvalsh(0.5 * (compliance + compliance.T))[0] > -1e-12
    force = np.array([60.0, -50.0, 80.0])
    half = pushed(world.replace(link_bending=0.2, column_stiffness=1e7), q, force)[:3]
    np.testing.assert_allclose(half, 0.5 * compliance @ force, rtol=1e-2, atol=1e-7)


def test_a_bending_arm_sags_and_its_motors_do_not_see_it() -> None:
    rigid, bending = arm_of(IDEAL), arm_of(BENDING.replace(elasticity=False))
    with rigid, bending:
        for arm in (rigid, bending):
            for _ in range(20):
                arm.cycle(ROBOT.home)
        np.testing.assert_array_equal(rigid.truth.q_m, bending.truth.q_m)
        off = bending.truth.tcp.translation - rigid.truth.tcp.translation
        assert off[2] < -5e-5
        t = bending.t - 0.5 * STEP
        np.testing.assert_allclose(bending.tcp_at(t).translation, bending.truth.tcp.translation, atol=1e-7)
        recorded = bending.recording(external=True).columns
        assert recorded["z"][-1] == pytest.approx(bending.truth.tcp.translation[2], abs=1e-8)
        np.testing.assert_allclose(bending.tcp_path()[1][-1], bending.truth.tcp.translation, atol=1e-8)


@pytest.mark.parametrize("frequency", [8.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_the_column_swings_at_its_frequency(frequency: float) -> None:
    world = IDEAL.replace(column_stiffness=4e6, column_frequency=frequency, column_damping=0.02)
    column, still = structure(world, ROBOT.home), np.zeros(ROBOT.n)
    column.touch = np.array([0.0, 400.0, 0.0])
    heights = []
    for _ in range(2000):
        column.update(ROBOT.home, still, np.full(ROBOT.n, world.reference_temperature))
        heights.append(column.off[1])
    swing = np.array(heights) - heights[-1]
    spectrum = np.abs(np.fft.rfft(swing))
    assert np.fft.rfftfreq(len(swing), STEP)[np.argmax(spectrum[1:]) + 1] == pytest.approx(frequency, abs=0.3)


def test_links_grow_with_the_heat_of_their_gears() -> None:
    cold, warm = (IDEAL.replace(thermal_expansion=1e-5, start_temperature=t) for t in (35.0, 45.0))
    with arm_of(cold) as arm:
        at_reference, first = arm.truth.tcp, arm._model.jointPlacements[1].translation
    with arm_of(warm) as arm:
        grown = arm.truth.tcp.translation - at_reference.translation
    np.testing.assert_allclose(grown, 1e-4 * (at_reference.translation - first), atol=1e-9)


# The drive.

@pytest.mark.parametrize("frequency", [15.0, 60.0, 200.0])
def test_a_notch_takes_its_frequency_away_and_nothing_that_is_slow(frequency: float) -> None:
    b0, b1, b2, a1, a2 = notch(np.array([frequency]), 5e-4)[:, 0]

    def gain(hz: float) -> float:
        z = np.exp(-2j * np.pi * hz * 5e-4)
        return float(abs((b0 + b1 * z + b2 * z * z) / (1.0 + a1 * z + a2 * z * z)))

    assert gain(0.0) == pytest.approx(1.0)
    assert gain(frequency) == pytest.approx(0.2, rel=1e-6)
    assert gain(0.05 * frequency) > 0.98
    assert min(gain(f) for f in np.linspace(1.0, 900.0, 900)) == pytest.approx(gain(frequency), rel=0.05)


def test_a_notch_starts_at_rest() -> None:
    world = IDEAL.replace(notch_frequency=40.0)
    with arm_of(world) as arm:
        for _ in range(20):
            arm.cycle(ROBOT.home)
        np.testing.assert_allclose(arm.truth.q_m, ROBOT.home, atol=1e-7)


def test_a_drive_that_compensates_friction_follows_better_after_a_reversal() -> None:
    friction = ELASTIC.replace(friction=True)
    paths = [moved_along(world, 0, lambda k: 0.1 * np.cos(2 * np.pi * k / 150) - 0.1, 300)["q_m"][600:, 0]
             for world in (ELASTIC, friction, friction.replace(friction_compensation=0.6))]
    assert np.ptp(paths[2] - paths[0]) < 0.7 * np.ptp(paths[1] - paths[0])


def test_gains_follow_the_posture_by_their_share() -> None:
    q = ROBOT.home.copy()
    q[2] -= 1.0
    gains = []
    for share in (0.0, 0.5, 1.0):
        with arm_of(IDEAL.replace(gain_schedule=share), q) as arm:
            arm.cycle(q)
            gains.append(arm._p[kernel.C_KP].copy())
    assert np.abs(gains[2] / gains[0] - 1.0).max() > 0.05
    np.testing.assert_allclose(gains[1] - gains[0], 0.5 * (gains[2] - gains[0]), rtol=1e-9, atol=1e-9)


# A user's way: each by one key.

WARM: dict[str, Any] = {"current_noise": 0.0, "start_temperature": 40.0}
ONE_KEY: dict[str, Any] = {
    "payload_mass": 4.0, "backlash": [0.0, 8e-4, 0.0, 0.0, 0.0, 0.0], "friction_scale": 1.5, "start_temperature": 15.0,
    "stiffness_scale": [1.0, 1.0, 0.5, 1.0, 1.0, 1.0], "balancer": 600.0, **{key: 1e-4 for key in (
        "hysteresis", "transmission_once", "transmission_twice")}, "thermal_expansion": 2e-5,
    "link_bending": 0.3, "column_stiffness": 1e7, "hose": 5.0, "hose_friction": 2.0, "friction_compensation": 0.6,
    "notch_frequency": 40.0, "gain_schedule": 0.5,
}


@pytest.mark.parametrize("key", ONE_KEY)
def test_one_key_of_a_scenes_world_makes_another_motion(key: str) -> None:
    worlds = [World.from_table("kr6", table) for table in (
        WARM, {**WARM, key: ONE_KEY[key]})]
    paths = []
    for world in worlds:
        with arm_of(world) as arm:
            for k in range(80):
                arm.cycle(ROBOT.home + 0.2 * np.sin(np.pi * k / 80) ** 2 * np.array([1, 0.7, -0.8, 1.2, 1.0, 1.5]))
            paths.append(arm.tcp_path()[1])
    assert np.abs(paths[1] - paths[0]).max() > 1e-6
    assert key not in OF_A_CELL or key in worlds[1].table()
    assert not set(worlds[0].table()) & set(OF_A_CELL)


# The whole of it.

@pytest.mark.parametrize("name", ["kr6", "kr15", "manutec_r15", "kr500"])
def test_an_arm_in_a_cell_has_every_effect_and_stands_still(name: str) -> None:
    robot, world = Robot.load(name), World.cell(name)
    without = {"stiffness_scale", "balancer", "column_frequency", "column_damping"}
    assert set(world.table()) >= set(OF_A_CELL) - without
    assert (world.balancer > 0.0) == (name == "kr500")
    with arm_of(world.replace(current_noise=0.0), robot.home, robot) as arm:
        for k in range(110):
            arm.cycle(robot.home + 5e-3 * min(k / 30, 1.0))
        log = arm.history()
    torque = log["tau_motor"][-100:] / np.where(np.isfinite(robot.tau_max), robot.tau_max, np.inf)
    assert np.ptp(torque, axis=0).max() < 0.02


def test_a_cell_is_what_a_table_begins_from() -> None:
    assert World.from_table("kr6", {"cell": True}) == World.cell("kr6")
    changed = World.from_table("kr6", {"cell": True, "hysteresis": 0.0, "friction_scale": 1.5})
    assert changed == World.cell("kr6").replace(hysteresis=0.0, friction_scale=1.5)
    with pytest.raises(InputError, match="true or false"):
        World.from_table("kr6", {"cell": "yes"})
