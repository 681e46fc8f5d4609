"""Inverse kinematics: right, warm-started, and clear where it ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.path.kinematics import InverseKinematics
from planning.planning_error import OutOfReachError
from tests.planning.cell import joint_path, kr6, reference


def gap(a: pin.SE3, b: pin.SE3) -> float:
    return float(np.linalg.norm(pin.log6(a.actInv(b)).vector))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_solution_reaches_the_pose_it_was_asked_for(seed: int) -> None:
    rng, robot = np.random.default_rng(seed), kr6()
    kinematics = InverseKinematics(robot)
    q = robot.home + rng.uniform(-0.3, 0.3, 6)
    target = kinematics.fk(q)
    found = kinematics.solve(target, q + rng.uniform(-0.1, 0.1, 6))
    assert gap(kinematics.fk(found), target) < 1e-8


def test_search_finds_the_posture_near_home() -> None:
    robot = kr6()
    kinematics = InverseKinematics(robot)
    q = robot.home + np.array([0.6, 0.3, -0.2, 0.2, 0.1, -0.4])
    found = kinematics.search(kinematics.fk(q), robot.home)
    np.testing.assert_allclose(found, q, atol=1e-6)


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
