"""Inverse kinematics: right, warm-started, and clear where it ends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.arrays import Array
from ideal_robot.dynamics.inverse_kinematics import Tool, log6, tool_jacobian
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError, PlanningError
from planning.path.kinematics import InverseKinematics
from planning.path.pose_history import PoseHistory
from tests.arms import urdf, written
from tests.planning.cell import T, joint_path, kr6, reference


def gap(a: pin.SE3, b: pin.SE3) -> float:
    return float(np.linalg.norm(pin.log6(a.actInv(b)).vector))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_solution_reaches_the_pose_it_was_asked_for(seed: int) -> None:
    rng, robot = np.random.default_rng(seed), kr6()
    kinematics = InverseKinematics(robot)
    q = robot.home + rng.uniform(-0.3, 0.3, 6)
    target = kinematics.fk(q)
    solution = kinematics.solve(target, q + rng.uniform(-0.1, 0.1, 6))
    assert gap(kinematics.fk(solution), target) < 1e-8


def test_search_finds_the_posture_near_home() -> None:
    robot = kr6()
    kinematics = InverseKinematics(robot)
    q = robot.home + np.array([0.6, 0.3, -0.2, 0.2, 0.1, -0.4])
    solution = kinematics.search(kinematics.fk(q), robot.home)
    np.testing.assert_allclose(solution, q, atol=1e-6)


def test_path_and_refinement_agree() -> None:
    robot, path = kr6(), joint_path()
    kinematics = InverseKinematics(robot)
    rows = slice(50, 90)
    targets = reference().poses(path.s[rows])
    rng = np.random.default_rng(1)
    refined = kinematics.refine(targets, path.q[rows] + rng.normal(0.0, 3e-4, (40, 6)))
    np.testing.assert_allclose(refined, path.q[rows], atol=1e-6)
    assert max(gap(kinematics.fk(q), target) for q, target in zip(refined, targets, strict=True)) < 1e-6


def test_a_seventh_joint_is_used_by_the_damped_inverse() -> None:
    robot = kr6()
    turntable = pin.Model()
    turntable.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turntable")
    turntable.addFrame(pin.Frame("table", 1, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model, _ = pin.appendModel(
        turntable,
        robot.pinocchio,
        pin.GeometryModel(),
        pin.GeometryModel(),
        turntable.getFrameId("table"),
        pin.SE3.Identity(),
    )
    seven = replace(
        robot, pinocchio=model, q_min=np.full(7, -6.3), q_max=np.full(7, 6.3), home=np.concatenate([[0.0], robot.home])
    )
    kinematics = InverseKinematics(seven)
    target = kinematics.fk(seven.home + 0.1)
    assert gap(kinematics.fk(kinematics.solve(target, seven.home, 200)), target) < 1e-6


def test_out_of_reach_tells_the_distance_left() -> None:
    robot = kr6()
    kinematics = InverseKinematics(robot)
    far = kinematics.fk(robot.home)
    far.translation = far.translation + np.array([2.0, 0.0, 0.0])
    with pytest.raises(OutOfReachError, match=r"mm away; move the path") as failure:
        kinematics.solve(far, robot.home)
    assert failure.value.joint == 0
    assert failure.value.error > 0.1


def test_joint_limit_names_joint_angle_and_limit() -> None:
    robot = kr6()
    beyond = robot.home.copy()
    beyond[4] = robot.q_max[4] + 0.1
    kinematics = InverseKinematics(robot)
    for solve in (
        lambda: kinematics.solve(kinematics.fk(beyond), beyond - 0.01),
        lambda: kinematics.refine([kinematics.fk(beyond)], beyond[None] - 1e-4),
    ):
        with pytest.raises(OutOfReachError, match="joint 5 would be at") as failure:
            solve()
        assert failure.value.joint == 5
        assert failure.value.limit == pytest.approx(robot.q_max[4])


# The compiled inverse kinematics of a whole horizon against Pinocchio's.

SEEDS = st.integers(0, 2**32 - 1)


def random_arm(rng: np.random.Generator) -> pin.Model:
    """Six joints about and along any axes, and a tool."""
    model, parent = pin.Model(), 0
    for i in range(6):
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        kind = pin.JointModelPrismaticUnaligned if rng.random() < 0.3 else pin.JointModelRevoluteUnaligned
        parent = model.addJoint(parent, kind(*axis), pin.SE3.Random(), f"joint_{i}")
    model.addFrame(pin.Frame("tool", parent, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    return model


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_jacobian_and_pose_are_pinocchios(seed: int) -> None:
    pin.seed(seed)
    rng = np.random.default_rng(seed)
    model = random_arm(rng)
    q, data, frame = rng.uniform(-2.0, 2.0, 6), model.createData(), model.getFrameId("tool")
    expected = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
    pin.framesForwardKinematics(model, data, q)
    J, R, p = np.empty((6, 6)), np.empty((3, 3)), np.empty(3)
    tool_jacobian(Tool.of(model, frame), q, J, R, p)
    np.testing.assert_allclose(J, expected, atol=1e-12)
    np.testing.assert_allclose(R, data.oMf[frame].rotation, atol=1e-12)
    np.testing.assert_allclose(p, data.oMf[frame].translation, atol=1e-12)


@settings(max_examples=200, deadline=None)
@given(SEEDS, st.sampled_from([0.0, 1e-9, 1e-6, 9.9e-5, 1.1e-4, 1e-2, 1.0, 2.5, 2.69, 3.0, np.pi - 1e-5]))
def test_the_twist_of_a_motion_is_pinocchios(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    motion = pin.SE3(pin.exp3(angle * axis / np.linalg.norm(axis)), rng.standard_normal(3))
    twist = np.empty(6)
    log6(np.ascontiguousarray(motion.rotation), np.array(motion.translation), twist)
    np.testing.assert_allclose(twist, pin.log6(motion).vector, atol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_half_a_turn_has_one_of_its_two_twists(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis, twist = rng.standard_normal(3) * [1.0, seed % 2, 1.0], np.empty(6)
    motion = pin.SE3(pin.exp3(np.pi * axis / np.linalg.norm(axis)), rng.standard_normal(3))
    log6(np.ascontiguousarray(motion.rotation), np.array(motion.translation), twist)
    np.testing.assert_allclose(pin.exp6(pin.Motion(twist)).homogeneous, motion.homogeneous, atol=1e-9)


def horizon(robot: Robot, rng: np.random.Generator) -> tuple[Array, list[pin.SE3]]:
    """Joint angles of a motion, and its poses."""
    q = robot.home + 0.3 * np.sin(np.linspace(0.0, 3.0, 30)[:, None] * rng.uniform(0.5, 2.0, 6))
    pose = robot.fk()
    return q, [pose(row) for row in q]


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_a_horizon_is_solved_as_pose_by_pose(seed: int) -> None:
    rng, robot = np.random.default_rng(seed), Robot.load("kr6")
    q, poses = horizon(robot, rng)
    kinematics, guess = InverseKinematics(robot), q + rng.normal(0.0, 1e-3, q.shape)
    together = kinematics.refine(poses, guess, 1e-12)
    np.testing.assert_allclose(together, q, atol=1e-9)
    alone = [kinematics.refine([pose], row[None], 1e-12)[0] for pose, row in zip(poses, guess, strict=True)]
    np.testing.assert_allclose(together, alone, atol=1e-12)


def test_a_posture_from_which_six_joints_cannot_move_in_all_directions_has_a_step() -> None:
    """The wrist stretched: two axes are one, so the Jacobian has no inverse."""
    robot = Robot.load("kr6")
    stretched = robot.home.copy()
    stretched[4] = 0.0
    kinematics = InverseKinematics(robot)
    solution = kinematics.refine([kinematics.fk(stretched)], stretched[None])
    np.testing.assert_allclose(kinematics.fk(solution[0]).homogeneous, kinematics.fk(stretched).homogeneous, atol=1e-6)


# Poses between the controller's samples.

def motion(t: float) -> np.ndarray:
    return kr6().home + 0.2 * np.sin(2.0 * t + np.arange(6))


def filled(count: int = 30) -> PoseHistory:
    history = PoseHistory(kr6())
    for k in range(count):
        history.add(k * T, motion(k * T))
    return history


def test_samples_themselves_are_exact() -> None:
    history = filled()
    for k in (0, 3, 15, 29):
        np.testing.assert_allclose(history.q(k * T), motion(k * T), atol=1e-12)


def test_between_samples_the_error_is_that_of_a_cubic() -> None:
    history = filled()
    t = np.linspace(T, 28 * T, 97)
    error = max(np.max(np.abs(history.q(x) - motion(x))) for x in t)
    # |f''''| T⁴ · 3/128, and 1/24 in the last interval.
    assert error < 0.2 * 2.0**4 * T**4 / 24.0


def test_pose_and_velocity_fit_the_motion() -> None:
    history, fk = filled(), kr6().fk()
    t = 0.1234
    np.testing.assert_allclose(history.pose(t).translation, fk(motion(t)).translation, atol=1e-7)
    v, w = history.velocity(t)
    before, after = fk(motion(t - 1e-4)), fk(motion(t + 1e-4))
    np.testing.assert_allclose(v, (after.translation - before.translation) / 2e-4, atol=1e-4)
    S = (after.rotation - before.rotation) / 2e-4 @ fk(motion(t)).rotation.T
    np.testing.assert_allclose(w, [S[2, 1], S[0, 2], S[1, 0]], atol=1e-3)


def test_a_little_ahead_is_extrapolated_and_more_is_refused() -> None:
    history = filled()
    np.testing.assert_allclose(history.q(29.5 * T), motion(29.5 * T), atol=1e-6)
    for t in (-0.01, 29 * T + 0.06):
        with pytest.raises(PlanningError, match="no pose at"):
            history.q(t)
    with pytest.raises(PlanningError, match="nothing"):
        PoseHistory(kr6()).q(0.0)


def test_few_samples_are_enough_to_begin_with() -> None:
    history = filled(2)
    np.testing.assert_allclose(history.q(0.5 * T), 0.5 * (motion(0.0) + motion(T)), atol=1e-12)


def test_old_samples_are_forgotten_and_time_runs_forwards() -> None:
    history = filled(300)
    with pytest.raises(PlanningError, match="no pose at"):
        history.q(0.1)
    # A scene's camera is up to 2 s late.
    late = 299 * T - 2.0
    np.testing.assert_allclose(history.q(late), motion(late), atol=1e-6)
    with pytest.raises(PlanningError, match="came after"):
        history.add(1.0, motion(1.0))


# Arms with more or fewer than six joints.

def straight(robot: Robot, length: float = 0.2) -> list[pin.SE3]:
    """Poses along a straight line across the arm, from where its tool is at home."""
    tool = robot.fk()(robot.home)
    return [pin.SE3(tool.rotation, tool.translation + np.array([0.0, y, 0.0])) for y in np.linspace(0.0, length, 101)]


def bare(joints: int, home: list[float], folder: Path) -> Robot:
    return replace(Robot.load(written(folder, urdf(joints))), home=np.array(home))


def test_seven_joints_are_a_smooth_function_of_the_pose(tmp_path: Path) -> None:
    """From anywhere near the posture wanted the same joint angles come out, and along a path they are smooth."""
    robot = bare(7, [0.1, 0.5, 0.2, 1.2, 0.1, 0.8, 0.0], tmp_path)
    kinematics, poses = InverseKinematics(robot), straight(robot)
    q = kinematics.path(poses, robot.home)
    assert max(gap(kinematics.fk(row), pose) for row, pose in zip(q, poses, strict=True)) < 1e-8
    assert np.abs(np.diff(q, 3, axis=0)).max() < 0.02 * np.abs(np.diff(q, axis=0)).max()
    rng = np.random.default_rng(0)
    free = [kinematics.refine(poses, q + rng.normal(0.0, 0.01, q.shape)) for _ in range(2)]
    assert np.abs(free[0] - free[1]).max() > 1e-3
    rows = [pose.rotation for pose in poses], [pose.translation for pose in poses]
    guided = [kinematics.refine_rows(*map(np.array, rows), q + rng.normal(0.0, 0.01, q.shape), 1e-12, wanted=q)
              for _ in range(2)]
    np.testing.assert_allclose(guided[0], q, atol=1e-5)
    np.testing.assert_allclose(guided[1], q, atol=1e-5)


def test_five_joints_keep_the_place_and_as_much_of_the_tool_axis_as_they_can(tmp_path: Path) -> None:
    robot = bare(5, [0.0, 0.4, 1.2, np.pi - 1.6, 0.0], tmp_path)
    kinematics, poses = InverseKinematics(robot), straight(robot)
    q = kinematics.path(poses, robot.home)
    turned = pin.SE3(pin.exp3(np.array([0.02, 0.0, 0.0])), np.zeros(3))
    leaning = [pose * turned for pose in poses]
    for targets, lean in ((poses, 1e-6), (leaning, 0.021)):
        for row, pose in zip(kinematics.refine(targets, q), targets, strict=True):
            reached = kinematics.fk(row)
            assert np.linalg.norm(reached.translation - pose.translation) < 1e-6
            assert np.arccos(min(1.0, float(reached.rotation[:, 2] @ pose.rotation[:, 2]))) < lean + 1e-3
    with pytest.raises(OutOfReachError):
        kinematics.solve(pin.SE3(pin.exp3(np.array([0.6, 0.0, 0.0])) @ poses[0].rotation, poses[0].translation), q[0])


def test_a_search_begins_within_the_limits_and_all_over_them(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, starts = kr6(), []

    def nowhere(self: InverseKinematics, target: pin.SE3, guess: Array) -> Array:
        starts.append(guess)
        raise OutOfReachError(np.zeros(3), 1.0)

    monkeypatch.setattr(InverseKinematics, "solve", nowhere)
    with pytest.raises(OutOfReachError):
        InverseKinematics(robot).search(pin.SE3.Identity(), robot.home)
    low, high = np.maximum(robot.q_min, robot.home - np.pi), np.minimum(robot.q_max, robot.home + np.pi)
    begun = np.array(starts)
    np.testing.assert_array_equal(begun[0], robot.home)
    assert np.all((begun >= low - 1e-9) & (begun <= high + 1e-9))
    # Half of the way from home to either limit.
    np.testing.assert_allclose(begun.min(axis=0), 0.5 * (low + robot.home), atol=0.2)
    np.testing.assert_allclose(begun.max(axis=0), 0.5 * (high + robot.home), atol=0.2)
