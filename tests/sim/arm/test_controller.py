"""The industrial controller as measured from outside, settings of worlds, and drawn arms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.body import _lay as lay
from sim.arm.generic import LAG, growth
from sim.arm.specimen import draw_specimen
from sim.arm.world import STEP, TABLE_KEYS, World
from sim.bullet import pybullet

ROBOT = Robot.load("kr6")
MOVE = np.array([0.4, 0.3, -0.3, 0.5, 0.4, 0.6])


def smooth(cycles: int, amplitude: Array = MOVE) -> Array:
    """A motion there and back with zero velocity at both ends, ``(cycles, n)``."""
    phase = np.linspace(0, 1, cycles)
    return ROBOT.home + (np.sin(np.pi * phase) ** 2)[:, None] * amplitude


def play(world: World, path: Array, seed: int = 0) -> dict[str, Array]:
    with SimulatedArm(ROBOT, world, np.random.default_rng(seed), q0=path[0]) as arm:
        for q_c in path:
            arm.cycle(q_c)
        return arm.history()


def shift_of(before: Array, after: Array, step: float) -> float:
    """By how much one signal lags another [s], from the best linear prediction by value and slope."""
    slope = np.gradient(before, step)
    basis = np.column_stack([before, -slope])
    return float(np.linalg.lstsq(basis, after, rcond=None)[0][1])


def test_command_is_reached_at_the_end_of_its_cycle_and_interpolated_linearly() -> None:
    path = smooth(60)
    log = play(World.ideal("kr6"), path)
    every = round(0.012 / 0.002)
    np.testing.assert_allclose(log["q_c"][every::every], path[:-1], atol=1e-12)
    first = log["q_c"][10 * every: 11 * every + 1]
    np.testing.assert_allclose(np.diff(first, 2, axis=0), 0.0, atol=1e-12)


def test_standard_planner_delays_by_exactly_one_cycle() -> None:
    path = smooth(60)
    without = play(World.ideal("kr6"), path)
    delayed = play(World.ideal("kr6").replace(correction_delay=True), path)
    every = round(0.012 / 0.002)
    np.testing.assert_allclose(delayed["q_c"][every:], without["q_c"][:-every], atol=1e-12)
    np.testing.assert_allclose(delayed["q_a"][every + 1:], without["q_a"][1:-every], atol=1e-9)


def test_low_pass_delays_by_two_time_constants() -> None:
    path = smooth(200)
    sharp = play(World.ideal("kr6"), path)["q_a"]
    soft = play(World.ideal("kr6").replace(low_pass=0.005), path)["q_a"]
    for j in range(6):
        # The discrete filter of one stage, moving by 1 - exp(-T / T_f) per cycle, lags by T (1 / share - 1).
        share = 1.0 - np.exp(-0.002 / 0.005)
        assert shift_of(sharp[:, j], soft[:, j], 0.002) == pytest.approx(2 * 0.002 * (1 / share - 1), rel=0.05)


def test_following_error_at_constant_speed_is_what_is_not_fed_forward() -> None:
    world = World.ideal("kr6").replace(velocity_feedforward=0.8, log_cycle=0.002)
    speed, ramp = 0.5, 0.2
    t = np.arange(150) * 0.012
    # Joint 1 alone: neither gravity nor inertia changes on its way.
    path = np.repeat(ROBOT.home[None], len(t), axis=0)
    path[:, 0] += speed * np.where(t < ramp, t**2 / (2 * ramp), t - ramp / 2)
    log = play(world, path)
    lag = (log["q_c"] - log["q_a"])[-10:, 0].mean()
    assert lag == pytest.approx((1 - 0.8) * speed / world.per_joint("position_gain", 6)[0], rel=1e-3)


def test_a_four_millisecond_controller_works_too() -> None:
    world = World.default("kr6").replace(t_ipo=0.004, correction_delay=False)
    path = np.repeat(smooth(200)[:, None], 3, axis=1).reshape(-1, 6)
    path = np.column_stack([np.convolve(column, np.ones(3) / 3, mode="same") for column in path.T])[3:-3]
    log = play(world, path)
    assert np.abs(log["q_c"] - log["q_a"]).max() < 0.02
    assert log["t"][-1] == pytest.approx(0.004 * len(path) - 0.002)


def test_encoder_shows_increments() -> None:
    world = World.ideal("kr6").replace(quantisation=True, encoder_increments=4096.0)
    log = play(world, smooth(40))
    increment = 2 * np.pi / (4096.0 * ROBOT.gear_ratio)
    counts = log["q"] / increment
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert np.all(np.abs(log["q"] - log["q_m"]) <= 0.5 * increment + 1e-12)
    assert np.abs(log["q"] - log["q_m"]).max() > 0.3 * increment.min()


def test_torque_stays_within_its_limit_and_recovers() -> None:
    world = World.ideal("kr6").replace(torque_limits=True)
    path = np.vstack([smooth(24)[:12], np.repeat(smooth(24)[11:12], 120, axis=0)])
    log = play(world, path)
    assert np.all(np.abs(log["tau_motor"]) <= ROBOT.tau_max * (1 + 1e-12))
    assert np.any(np.abs(log["tau_motor"]) >= 0.999 * ROBOT.tau_max)
    np.testing.assert_allclose(log["q_a"][-1], path[-1], atol=2e-3)


def test_measured_torque_is_noisy_and_scaled_by_the_drive_gain() -> None:
    world = World.ideal("kr6").replace(current_noise=0.01, drive_gain_error=0.05, individual=3)
    log = play(world, np.repeat(ROBOT.home[None], 200, axis=0))
    np.testing.assert_allclose((log["tau"] - log["tau"].mean(axis=0)).std(axis=0), 0.01 * ROBOT.tau_max, rtol=0.1)
    loaded = [1, 2]  # the joints that carry gravity in this posture
    gain = (log["tau_motor"].mean(axis=0) / log["tau"].mean(axis=0))[loaded]
    assert np.all(np.abs(gain - 1) < 0.06)
    assert np.any(np.abs(gain - 1) > 0.005)


def test_a_logged_torque_is_the_mean_since_the_sample_before() -> None:
    world = World.ideal("kr6").replace(drive_gain_error=0.0)
    fine, coarse = (play(world.replace(log_cycle=cycle), smooth(60)) for cycle in (STEP, 4 * STEP))
    steps = len(fine["tau"]) // 4
    means = fine["tau"][1 : 4 * (steps - 1) + 1].reshape(steps - 1, 4, 6).mean(axis=1)
    np.testing.assert_allclose(coarse["tau"][1:steps], means, rtol=1e-9, atol=1e-9)
    # Not its last value: the torque jumps within a position cycle.
    assert np.abs(coarse["tau"][1:steps] - fine["tau"][4 : 4 * steps : 4]).max() > 1e-3


@pytest.mark.parametrize("constant", ["low_pass", "velocity_filter", "current_lag"])
def test_a_lag_of_the_controller_shows_and_none_is_none(constant: str) -> None:
    """Each of the three low-passes delays what goes through it; at zero it is not there."""
    path = smooth(60)
    without, short, long = (play(World.ideal("kr6").replace(**{constant: value}), path) for value in (0.0, 1e-3, 4e-3))
    near, far = (float(np.abs(run["q"] - without["q"]).max()) for run in (short, long))
    assert 1e-6 < near < 0.6 * far


def test_cascade_written_as_pid_gives_the_cascades_torque() -> None:
    """[G] (16), (17) with the equivalent gains, evaluated at the fast cycle, reproduce the controller's torque."""
    world = World.ideal("kr6").replace(t_ipo=STEP, t_position=STEP, t_velocity=STEP, velocity_filter=0.0,
                                       log_cycle=STEP)
    path = ROBOT.home + (np.sin(np.pi * np.linspace(0, 1, 4000)) ** 4)[:, None] * MOVE
    log = play(world, path)
    # With v_des = K_v e + f q̇_d the P part K_p (v_des - q̇) is K_p K_v e + K_p f ė - K_p (1 - f) q̇.
    k_v, f, k_p = (world.per_joint(name, 6) for name in ("position_gain", "velocity_feedforward", "velocity_gain"))
    k_i = world.t_ipo / world.per_joint("integral_time", 6)
    e = log["q_c"] - log["q"]
    rate = lambda x: np.vstack([np.zeros((1, 6)), np.diff(x, axis=0)]) / STEP  # noqa: E731
    u = k_p * k_v * e + k_p * f * rate(e) - k_p * (1.0 - f) * rate(log["q"])
    torque = log["tau"][0] + np.cumsum(np.vstack([np.zeros((1, 6)), (1 + k_i) * u[1:] - u[:-1]]), axis=0)
    np.testing.assert_allclose(torque, log["tau"], atol=2e-3 * np.abs(log["tau"]).max(axis=0).max())


# World settings: checked, named when wrong, switchable one by one.

SWITCHES = ("elasticity", "friction", "thermal", "quantisation", "correction_delay", "torque_limits")


@pytest.mark.parametrize("name", ["kr6", "kr15", "manutec_r15"])
def test_the_default_world_is_not_kind(name: str) -> None:
    world = World.default(name)
    for switch in SWITCHES:
        assert getattr(world, switch) is True
    assert world.low_pass > 0
    assert world.inertia_tolerance >= 0.1
    for effect in ("current_noise", "degressive", "stribeck", "load_friction", "torque_ripple", "damping"):
        assert np.all(world.per_joint(effect, 6) > 0)


def test_the_ideal_world_has_nothing_on() -> None:
    world = World.ideal("kr15")
    for switch in SWITCHES:
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
    ("stiffness", 10**400), ("residual", [[10**400]]),
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
        World.default("kr6").replace(nonsense=1.0)


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


# Drawn arms: how far they differ from their data, the plate before them, what makes their controllers stable.

IDEAL = World.ideal("kr6")


def test_masses_and_rotors_use_the_whole_of_their_tolerance_and_no_more() -> None:
    """Of 60 drawn arms: masses within the tolerance, rotors and sizes within a third of it, each nearly reached."""
    tolerance, nominal = 0.15, ROBOT.pinocchio.inertias
    world = IDEAL.replace(inertia_tolerance=tolerance)
    arms = [draw_specimen(ROBOT, world.replace(individual=seed)) for seed in range(1, 61)]
    mass = np.array([[arm.model.inertias[j].mass / nominal[j].mass - 1.0 for j in range(1, 7)] for arm in arms])
    rotor = np.array([arm.rotor_inertia / ROBOT.rotor_inertia - 1.0 for arm in arms])
    lever = np.array([[arm.model.inertias[j].lever / np.where(nominal[j].lever == 0.0, np.nan, nominal[j].lever) - 1.0
                       for j in range(1, 7)] for arm in arms])
    for off, most in ((mass, tolerance), (rotor, tolerance / 3.0), (lever, tolerance / 3.0)):
        assert 0.93 * most < np.nanmax(np.abs(off)) <= most
        assert 0.85 * most < np.nanmax(off)
        assert np.nanmin(off) < -0.85 * most


def test_more_mass_of_the_same_shape_has_as_much_more_inertia() -> None:
    """Second moments of a body f times as heavy and a, b, c times as long: f a², f b², f c² of what they were."""
    for seed in range(1, 6):
        arm = draw_specimen(ROBOT, IDEAL.replace(inertia_tolerance=0.2, individual=seed))
        for j in range(1, 7):
            nominal, drawn = ROBOT.pinocchio.inertias[j], arm.model.inertias[j]
            factor = drawn.mass / nominal.mass
            second, after = (0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia for body in (nominal, drawn))
            stretch = np.diag(after) / (factor * np.diag(second))
            assert np.all(np.abs(np.sqrt(stretch) - 1.0) <= 0.2 / 3.0 + 1e-9)
            moved = nominal.lever != 0.0
            np.testing.assert_allclose(drawn.lever[moved] / nominal.lever[moved], np.sqrt(stretch)[moved], rtol=1e-6)


@pytest.mark.parametrize("kind", ["kinematic_error", "zero_error", "twist_error"])
def test_every_joint_is_displaced_within_its_error_and_in_its_own_way(kind: str) -> None:
    error = 1e-3
    nominal = ROBOT.pinocchio.jointPlacements
    sizes = []
    for seed in range(1, 21):
        model = draw_specimen(ROBOT, IDEAL.replace(individual=seed, **{kind: error})).model
        moved = [(nominal[j].rotation.T @ (model.jointPlacements[j].translation - nominal[j].translation),
                  pin.log3(model.jointPlacements[j].rotation @ nominal[j].rotation.T),
                  pin.log3(nominal[j].rotation.T @ model.jointPlacements[j].rotation)) for j in range(1, 7)]
        offset, in_parent, own = (np.array(column) for column in zip(*moved, strict=True))
        size = {"kinematic_error": np.linalg.norm(offset, axis=1), "zero_error": np.linalg.norm(own, axis=1),
                "twist_error": np.linalg.norm(in_parent, axis=1)}[kind]
        sizes.append(size)
        if kind == "zero_error":
            # About the joint's own axis.
            axes = [ROBOT.pinocchio.joints[j].shortname() for j in range(1, 7)]
            for name, turn in zip(axes, own, strict=True):
                np.testing.assert_allclose(np.delete(turn, "XYZ".index(name[-1])), 0.0, atol=1e-9)
        if kind != "kinematic_error":
            np.testing.assert_allclose(offset, 0.0, atol=1e-12)
        else:
            np.testing.assert_allclose(own, 0.0, atol=1e-12)
    most = np.max(sizes, axis=0)
    bound = error * (1.0 if kind == "zero_error" else np.sqrt(3.0))
    assert np.all(most <= bound + 1e-12)
    assert np.all(most > 0.6 * error)
    # No two joints share their draw.
    assert len(np.unique(np.round(sizes[0], 9))) == 6


def test_a_plate_lies_under_the_corners_of_the_paper() -> None:
    """Its upper side is 2 mm below them, whatever the paper's slope, so that a line on it is not hidden."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        turn = pin.exp3(np.array([0.2, -0.1, 0.7]))
        for corners in (np.array([[0, 0, 0], [0.4, 0, 0], [0.4, 0.3, 0], [0, 0.3, 0.0]]),
                        np.array([[0, 0, 0], [0, 0.3, 0], [0.4, 0.3, 0], [0.4, 0, 0.0]])):
            placed = corners @ turn.T + np.array([0.9, 0.1, 0.4])
            lay(placed, client)
            body = pybullet.getNumBodies(client) - 1
            place, quaternion = pybullet.getBasePositionAndOrientation(body, client)
            size = np.array(pybullet.getVisualShapeData(body, physicsClientId=client)[0][3])
            rotation = np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
            assert (rotation @ [0, 0, 1]) @ turn[:, 2] == pytest.approx(1.0)
            np.testing.assert_allclose(np.sort(size), [0.01, 0.3, 0.4], atol=1e-9)
            inside = (placed - place) @ rotation
            expected = [0.5 * size[0], 0.5 * size[1], 0.007]
            np.testing.assert_allclose(np.abs(inside), np.tile(expected, (4, 1)), atol=1e-7)
            assert np.all(inside[:, 2] > 0.0)
    finally:
        pybullet.disconnect(client)


# The stability that worlds of any arm are made by.

@pytest.mark.parametrize("seed", range(8))
def test_growth_is_that_of_the_characteristic_polynomial(seed: int) -> None:
    """P and PI control of a rotor behind two lags, with a link on a spring: the roots of 1 + C(s) L(s) G(s) = 0."""
    rng = np.random.default_rng(seed)
    J, link, k, d = rng.uniform(1.0, 20.0), rng.uniform(1.0, 50.0), 10.0 ** rng.uniform(4, 6), rng.uniform(1.0, 300.0)
    gain, k_v, T_i = rng.uniform(50.0, 2000.0), rng.uniform(5.0, 40.0), rng.uniform(0.02, 0.2)
    p = np.polynomial.polynomial
    plant = p.polymul([0.0, 0.0, 1.0], [k * (J + link), d * (J + link), J * link])
    lags = p.polypow([1.0, 0.5 * LAG], 2)
    open_loop = p.polymul(p.polymul([0.0, 1.0], lags), plant)
    control = gain * p.polymul(p.polymul([k_v, 1.0], [1.0 / T_i, 1.0]), [k, d, link])
    roots = p.polyroots(p.polyadd(open_loop, control))
    np.testing.assert_allclose(growth(gain, J, link, k, d, k_v, T_i), roots.real.max(), rtol=1e-4, atol=1e-3)
