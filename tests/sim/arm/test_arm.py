"""The simulated arm as others see it: interface, truth, gears, effects, determinism."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot import row_log
from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import KEPT
from ideal_robot.signals.recording import Recording
from sim import SimError
from sim.arm import history as of_arm
from sim.arm.arm import SimulatedArm, _require_integrable
from sim.arm.body import View, picture
from sim.arm.history import History
from sim.arm.kernel import LOGGED
from sim.arm.specimen import draw_specimen
from sim.arm.world import STEP, World
from sim.bullet import pybullet
from tests.arms import urdf, written

ROBOT = Robot.load("kr6")
DEFAULT, IDEAL = World.default("kr6"), World.ideal("kr6")


def arm_of(world: World, seed: int = 0, q0: Array | None = None) -> SimulatedArm:
    return SimulatedArm(ROBOT, world, np.random.default_rng(seed), q0=q0)


def wave(arm: SimulatedArm, cycles: int = 50) -> None:
    for k in range(cycles):
        arm.cycle(ROBOT.home + 0.15 * np.sin(np.pi * k / cycles) ** 2 * np.array([1, 0.7, -0.8, 1.2, 1.0, 1.5]))


def held(world: World, cycles: int) -> Array:
    """Torque ``(6,)`` [N m] that is measured where the arm is held at home."""
    with arm_of(world) as arm:
        return [arm.cycle(ROBOT.home).tau for _ in range(cycles)][-1]


def test_the_same_seed_gives_the_same_recording_bit_for_bit() -> None:
    hashes = []
    for seed in (4, 4, 5):
        with arm_of(DEFAULT, seed) as arm:
            wave(arm)
            hashes.append(arm.recording(external=True).hash)
    assert hashes[0] == hashes[1] != hashes[2]


def test_a_reset_arm_moves_as_a_new_one() -> None:
    with arm_of(DEFAULT.replace(current_noise=0.0)) as arm:
        wave(arm)
        first = arm.recording().hash
        arm.reset(ROBOT.home)
        assert arm.t == 0.0
        wave(arm)
        assert arm.recording().hash == first


def test_cycle_tells_the_state_at_the_end_of_the_cycle() -> None:
    with arm_of(IDEAL) as arm:
        state = arm.cycle(ROBOT.home)
        assert state.t == pytest.approx(arm.t_ipo)
        np.testing.assert_array_equal(state.q, arm.truth.q_a)
        for k in range(30):
            state = arm.cycle(ROBOT.home + 1e-3 * k)
        assert state.t == pytest.approx(31 * arm.t_ipo)
        np.testing.assert_allclose(state.q, ROBOT.home + 1e-3 * 29, atol=5e-4)


def test_an_arm_at_rest_stays_at_rest() -> None:
    with arm_of(DEFAULT.replace(quantisation=False, torque_ripple=0.0)) as arm:
        before = arm.truth.q_a
        for _ in range(20):
            arm.cycle(ROBOT.home)
        np.testing.assert_allclose(arm.truth.q_a, before, atol=2e-7)


def test_gears_twist_by_torque_over_stiffness() -> None:
    world = DEFAULT.replace(inertia_tolerance=0.0, quantisation=False, torque_ripple=0.0)
    with arm_of(world) as arm:
        for _ in range(10):
            arm.cycle(ROBOT.home)
        truth = arm.truth
        gravity = pin.computeGeneralizedGravity(ROBOT.pinocchio, ROBOT.pinocchio.createData(), truth.q_a)
        np.testing.assert_allclose(truth.q_m - truth.q_a, gravity / world.per_joint("stiffness", 6), atol=3e-7)
        assert np.abs(truth.q_m - truth.q_a).max() > 2e-4


def test_backlash_opens_the_gear() -> None:
    with arm_of(DEFAULT.replace(backlash=1e-3)) as arm:
        for k in range(200):
            arm.cycle(ROBOT.home + np.array([0.05 * np.sin(2 * np.pi * k * 0.012), 0, 0, 0, 0, 0]))
        log = arm.history()
    twist = (log["q_m"] - log["q_a"])[:, 0]
    elastic = log["tau_gear"][:, 0] / DEFAULT.per_joint("stiffness", 6)[0]
    assert twist.max() - twist.min() == pytest.approx(np.ptp(elastic) + 1e-3, rel=0.05)


def test_one_rigid_gear_among_elastic_ones() -> None:
    stiffness = DEFAULT.per_joint("stiffness", 6)
    stiffness[2] = np.inf
    with arm_of(DEFAULT.replace(stiffness=tuple(stiffness))) as arm:
        wave(arm)
        log = arm.history()
    np.testing.assert_array_equal(log["q_m"][:, 2], log["q_a"][:, 2])
    assert np.abs(log["q_m"] - log["q_a"])[:, [0, 1]].max() > 1e-4


def test_very_stiff_gears_approach_rigid_ones() -> None:
    """Two ways to the same arm: springs ever stiffer, and rotors rigidly on their links."""
    unfiltered = IDEAL.replace(velocity_filter=0.0)
    stiff = np.array([2e7, 2e7, 6e6, 2e5, 2e5, 2e4])
    errors = []
    with arm_of(unfiltered) as arm:
        wave(arm, 120)
        rigid = arm.history()["q_m"]
    for factor in (0.05, 1.0):
        world = unfiltered.replace(elasticity=True, stiffness=tuple(factor * stiff),
                              damping=tuple(0.2 * np.sqrt(factor * stiff * ROBOT.rotor_inertia)))
        with arm_of(world) as arm:
            wave(arm, 120)
            errors.append(np.abs(arm.history()["q_m"] - rigid).max())
    assert errors[1] < 0.25 * errors[0]
    assert errors[1] < 1e-4


def test_a_gear_that_turns_no_inertia_is_refused() -> None:
    model = ROBOT.pinocchio.copy()
    model.inertias[6] = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    with arm_of(DEFAULT) as arm, pytest.raises(InputError, match="nothing that has inertia"):
        _require_integrable(model, ROBOT.home, arm._p)


def test_too_stiff_gears_are_refused() -> None:
    with pytest.raises(InputError, match="inf for a rigid gear"):
        arm_of(DEFAULT.replace(stiffness=1e9))


def test_poses_between_samples() -> None:
    with arm_of(DEFAULT) as arm:
        wave(arm)
        fine = {}
        arm.step_hook = lambda t: fine.__setitem__(round(t / STEP), arm.truth.tcp)
        start = round(arm.t / STEP)
        for k in range(10):
            arm.cycle(ROBOT.home + 2e-3 * k)
        for tick, pose in fine.items():
            assert np.linalg.norm(arm.tcp_at(tick * STEP).translation - pose.translation) < 2e-6
        assert len(fine) == 240
        assert min(fine) == start
        np.testing.assert_allclose(arm.tcp_at(arm.t).homogeneous, arm.truth.tcp.homogeneous, atol=1e-12)
        for outside in (-0.01, arm.t + 0.01):
            with pytest.raises(SimError):
                arm.tcp_at(outside)


def test_recording_has_what_a_controller_logs() -> None:
    with arm_of(DEFAULT.replace(log_cycle=0.012)) as arm:
        wave(arm, 20)
        recording = arm.recording(external=True)
        assert arm.recording(external=True).hash == recording.hash
        pose = arm.tcp_at(float(recording.t[7]))
    assert recording.n == 6
    np.testing.assert_allclose(np.diff(recording.t), 0.012, atol=1e-12)
    assert set(recording.columns) == {"t", "x", "y", "z", "qx", "qy", "qz", "qw"} | {
        f"{name}_{i}" for name in ("q_c", "q", "tau", "current", "temp", "qa") for i in range(1, 7)}
    np.testing.assert_allclose(recording.joints("tau"), recording.joints("current") * ROBOT.drive_gain)
    measured = np.array([recording.columns[axis][7] for axis in "xyz"])
    assert 0 < np.linalg.norm(measured - pose.translation) < 6 * DEFAULT.external_position_noise
    assert recording.meta["robot"] == "kr6"
    assert recording.meta["correction_delay"] is True


def test_a_posture_to_start_from_is_checked() -> None:
    with pytest.raises(InputError, match="outside the joint limits"):
        arm_of(DEFAULT, q0=np.full(6, 3.0))


def test_extra_torque_acts_on_the_motor() -> None:
    load = np.array([0.0, 0.0, 25.0, 0.0, 0.0, 0.0])
    loaded = held(IDEAL.replace(extra_torque=lambda t, q_m, qd_m, q_a: load), 80)
    np.testing.assert_allclose(loaded - held(IDEAL, 80), -load, atol=0.2)


def test_payload_is_carried() -> None:
    torque = held(IDEAL.replace(payload_mass=4.0, payload_com=(0.06, -0.05, 0.1)), 10) - held(IDEAL, 10)
    data = ROBOT.pinocchio.createData()
    com = ROBOT.fk()(ROBOT.home).act(np.array([0.06, -0.05, 0.1]))
    jacobian = pin.computeFrameJacobian(ROBOT.pinocchio, data, ROBOT.home, ROBOT.tool_id,
                                        pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    lever = com - ROBOT.fk()(ROBOT.home).translation
    expected = (jacobian[:3] + pin.skew(lever).T @ jacobian[3:]).T @ np.array([0.0, 0.0, 4.0 * 9.81])
    np.testing.assert_allclose(torque, expected, atol=1e-3 * np.abs(expected).max())


def test_individuals_differ_within_the_tolerance_and_stay_physical() -> None:
    nominal = ROBOT.pinocchio.inertias
    masses = []
    for seed in range(1, 8):
        arm = draw_specimen(ROBOT, DEFAULT.replace(individual=seed))
        ratio = np.array([arm.model.inertias[j].mass / nominal[j].mass for j in range(1, 7)])
        masses.append(ratio)
        assert np.all(np.abs(ratio - 1) <= 0.15)
        for j in range(1, 7):
            moments = np.linalg.eigvalsh(arm.model.inertias[j].inertia)
            assert moments[0] > 0
            assert moments[0] + moments[1] > moments[2]
        assert np.all(np.abs(arm.drive_gain - 1) <= DEFAULT.drive_gain_error)
    assert np.std(masses, axis=0).min() > 0.02
    same = draw_specimen(ROBOT, DEFAULT.replace(individual=3))
    np.testing.assert_array_equal(masses[2], [same.model.inertias[j].mass / nominal[j].mass for j in range(1, 7)])


def test_torque_ripple_follows_the_motor() -> None:
    logs = []
    for ripple in (0.0, 0.01):
        with arm_of(IDEAL.replace(torque_ripple=ripple, ripple_order=2.0, log_cycle=STEP)) as arm:
            for k in range(80):
                arm.cycle(ROBOT.home + np.array([1e-3 * k, 0, 0, 0, 0, 0]))
            logs.append(arm.history())
    difference = (logs[1]["tau_motor"] - logs[0]["tau_motor"])[480:, 0]
    turn = 2 * ROBOT.gear_ratio[0] * logs[1]["q_m"][480:, 0]
    basis = np.column_stack([np.sin(turn), np.cos(turn), np.ones_like(turn)])
    explained = basis @ np.linalg.lstsq(basis, difference, rcond=None)[0]
    assert np.var(difference - explained) < 0.2 * np.var(difference)


def test_closing_twice_is_fine_and_history_stays() -> None:
    arm = arm_of(DEFAULT)
    arm.cycle(ROBOT.home)
    arm.close()
    arm.close()
    assert len(arm.history()["t"]) == 6
    assert arm.recording().n == 6


def test_the_true_kinematics_can_differ_from_the_urdf() -> None:
    nominal = ROBOT.fk()(ROBOT.home).translation
    with arm_of(IDEAL.replace(kinematic_error=1e-3)) as arm:
        moved = arm.truth.tcp.translation - nominal
        assert 1e-4 < np.linalg.norm(moved) < np.sqrt(3) * 6e-3
        link = pybullet.getLinkState(arm.body, 5, computeForwardKinematics=1, physicsClientId=arm.client)
        np.testing.assert_allclose(np.array(link[4]) + arm.truth.tcp.rotation @ arm.tool_offset.rotation.T
                                   @ arm.tool_offset.translation, arm.truth.tcp.translation, atol=1e-6)
    turn = draw_specimen(ROBOT, IDEAL.replace(zero_error=2e-3)).model
    data, same = turn.createData(), ROBOT.pinocchio.createData()
    pin.forwardKinematics(turn, data, ROBOT.home)
    pin.forwardKinematics(ROBOT.pinocchio, same, ROBOT.home)
    for joint in range(1, 7):
        twist = pin.log3(same.liMi[joint].rotation.T @ data.liMi[joint].rotation)
        assert 1e-6 < np.linalg.norm(twist) <= 2e-3
        np.testing.assert_allclose(data.liMi[joint].translation, same.liMi[joint].translation, atol=1e-12)


def test_the_true_axes_are_turned_against_the_drawn_ones() -> None:
    """By at most ``twist_error`` about each axis of the joint before, whatever the joint's own angle and zero."""
    error = 2e-3
    placements = draw_specimen(ROBOT, IDEAL.replace(twist_error=error)).model.jointPlacements
    drawn = ROBOT.pinocchio.jointPlacements
    turns = np.array([pin.log3(placements[j].rotation @ drawn[j].rotation.T) for j in range(1, ROBOT.n + 1)])
    assert np.all(np.abs(turns) <= error)
    assert np.all(np.linalg.norm(turns, axis=1) > 0.1 * error)


@pytest.mark.parametrize("elastic", [False, True])
def test_uneven_gears_turn_the_arm_unevenly(elastic: bool) -> None:
    world = IDEAL.replace(elasticity=elastic, transmission_error=2e-4, transmission_order=40.0)
    with arm_of(world) as arm:
        for k in range(300):
            arm.cycle(ROBOT.home + np.array([2e-3 * k, 0, 0, 0, 0, 0]))
        log = arm.history()
    steady = slice(600, None)
    q_m = log["q_m"][steady, 0]
    basis = np.column_stack([np.sin(40 * q_m), np.cos(40 * q_m), np.ones_like(q_m)])
    fitted = np.linalg.lstsq(basis, log["q_a"][steady, 0] - q_m, rcond=None)[0]
    assert np.hypot(*fitted[:2]) == pytest.approx(2e-4, rel=0.05)


# A long run keeps a bounded number of rows in memory and loses none.

def fill(history: History, rows: int) -> None:
    for _ in range(rows):
        history.reserve(1)
        history.next_row[:] = history.rows + np.arange(len(history.next_row)) / 100.0
        history.next_row[0] = history.rows * history.step
        history.rows += 1


def test_rows_in_memory_are_bounded_and_all_rows_are_there() -> None:
    history, rows = History(1, 0.002), 3 * KEPT + 500
    fill(history, rows)
    assert history.kept <= KEPT
    early = history.columns()
    fill(history, KEPT)
    assert history.kept <= KEPT
    late = history.columns()
    assert len(early["t"]) == rows
    assert len(late["t"]) == rows + KEPT
    np.testing.assert_allclose(late["t"], 0.002 * np.arange(rows + KEPT))
    for i, name in enumerate(LOGGED):
        np.testing.assert_array_equal(late[name][:, 0], np.arange(rows + KEPT) + (1 + i) / 100.0)


def test_a_served_arm_holds_no_more_of_its_run_than_a_narrow_log() -> None:
    """Rows of six joints took 16 MB before the first went to the file: `simulate` grew by that in a minute."""
    history, width = History(6, 0.002), 1 + 6 * len(LOGGED)
    fill(history, row_log.IN_MEMORY // width)
    before = history.kept
    fill(history, 5000)
    assert history.kept == before
    assert history.kept * width <= 1.1 * row_log.IN_MEMORY
    np.testing.assert_allclose(history.columns()["t"], history.step * np.arange(history.rows))


def test_a_pose_of_long_ago_is_known() -> None:
    history = History(1, 0.002)
    fill(history, KEPT + 100)
    now = np.zeros(1)
    for row in (3, KEPT - 1, KEPT, KEPT + 50):
        angles = history.pose(row * 0.002, 1e9, now, now)
        np.testing.assert_allclose(angles, row + (1 + LOGGED.index("q_a")) / 100.0, atol=1e-9)


def test_a_recording_of_many_pieces_is_that_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def played() -> tuple[Recording, Array]:
        robot = Robot.load("kr6")
        with SimulatedArm(robot, World.from_table("kr6", {}), np.random.default_rng(3)) as arm:
            for k in range(150):
                arm.cycle(robot.home + 1e-4 * k)
            return arm.recording(external=True), arm.tcp_path()[1]

    whole, tool = played()
    for module in (row_log, of_arm, row_log):
        monkeypatch.setattr(module, "KEPT", 512)
    pieces, tool_of_pieces = played()
    assert len(whole.t) > 512
    assert row_log.in_file(pieces.t)
    assert not row_log.in_file(whole.t)
    assert pieces.hash == whole.hash
    np.testing.assert_array_equal(tool_of_pieces, tool)


# Pictures for reports show the arm where it is.

def test_a_kuka_is_orange_and_moves() -> None:
    robot = Robot.load("kr6")
    assert ET.parse(robot.urdf).getroot().find("./link/visual") is not None
    home = picture(robot, robot.home, View(240, 180))
    assert home.shape == (180, 240, 3)
    assert home.dtype == np.uint8
    red, green, blue = home.astype(int).transpose(2, 0, 1)
    assert np.mean((red - blue > 60) & (red - green > 30)) > 0.05
    turned = picture(robot, robot.home + np.array([1.0, 0, 0, 0, 0, 0]), View(240, 180))
    assert np.mean(np.abs(turned.astype(int) - home).max(axis=2) > 30) > 0.05


def test_a_path_is_drawn() -> None:
    robot = Robot.load("manutec_r15")
    view = View(240, 180, target=(0.6, 0.0, 0.8), distance=3.0)
    line = np.array([[0.9, -0.4, 0.3], [0.9, 0.4, 0.3], [0.9, 0.4, 0.9]])
    without, drawn = picture(robot, robot.home, view), picture(robot, robot.home, view, lines=[line])
    assert np.any(np.abs(drawn.astype(int) - without).max(axis=2) > 30)


def test_posture_must_fit() -> None:
    with pytest.raises(InputError, match="6 joint angles"):
        picture(Robot.load("kr6"), np.zeros(5))


def test_an_arm_without_shapes_is_drawn_as_rods(tmp_path: Path) -> None:
    robot = Robot.load(written(tmp_path, urdf(6)))
    view = View(240, 180, distance=2.0, target=[0.3, 0.0, 0.5])
    at_home = picture(robot, robot.home, view)
    turned = picture(robot, robot.home + np.array([1.0, 0, 0, 0, 0, 0]), view)
    assert (np.abs(at_home.astype(int) - turned).max(axis=2) > 40).sum() > 200


@pytest.mark.parametrize(("key", "value"), [("body", -1), ("body", [1.0, 2.0]), ("residual", [[1.0, 2.0]]),
                                            ("spread", {"stiffness": [1.0]}), ("spread", {"stiffness": float("nan")})])
def test_what_a_twin_holds_is_for_the_joints_of_its_arm(key: str, value: object) -> None:
    with pytest.raises(InputError) as caught:
        arm_of(World.from_table("kr6", {key: value}))
    assert str(caught.value.field).startswith(f"world.{key}")
