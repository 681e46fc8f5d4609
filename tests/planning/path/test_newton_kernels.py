"""The compiled inverse kinematics of a whole horizon against Pinocchio's."""

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import chain_of
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from planning.path.newton_kernels import log6, tool_jacobian

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
    q, data, tool = rng.uniform(-2.0, 2.0, 6), model.createData(), model.getFrameId("tool")
    expected = pin.computeFrameJacobian(model, data, q, tool, pin.LOCAL)
    pin.framesForwardKinematics(model, data, q)
    at = model.frames[tool].placement
    J, R, p = np.empty((6, 6)), np.empty((3, 3)), np.empty(3)
    tool_jacobian(chain_of(model), 6, np.ascontiguousarray(at.rotation), np.array(at.translation), q, J, R, p)
    np.testing.assert_allclose(J, expected, atol=1e-12)
    np.testing.assert_allclose(R, data.oMf[tool].rotation, atol=1e-12)
    np.testing.assert_allclose(p, data.oMf[tool].translation, atol=1e-12)


@settings(max_examples=200, deadline=None)
@given(SEEDS, st.sampled_from([0.0, 1e-9, 1e-6, 9.9e-5, 1.1e-4, 1e-2, 1.0, 2.5]))
def test_the_twist_of_a_motion_is_pinocchios(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    motion = pin.SE3(pin.exp3(angle * axis / np.linalg.norm(axis)), rng.standard_normal(3))
    found = np.empty(6)
    assert log6(np.ascontiguousarray(motion.rotation), np.array(motion.translation), found)
    np.testing.assert_allclose(found, pin.log6(motion).vector, atol=1e-9)


def test_half_a_turn_is_said_to_be_one() -> None:
    assert not log6(pin.exp3(np.array([0.0, 0.0, np.pi])), np.zeros(3), np.empty(6))


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
    alone = [kinematics._refined(pose, row, 1e-12) for pose, row in zip(poses, guess, strict=True)]
    np.testing.assert_allclose(together, alone, atol=1e-12)


def test_a_posture_that_cannot_be_solved_by_all_six_joints_is_left_to_pinocchio() -> None:
    """The wrist stretched: two axes are one, so the Jacobian has no inverse and the damped one takes its place."""
    robot = Robot.load("kr6")
    stretched = robot.home.copy()
    stretched[4] = 0.0
    kinematics = InverseKinematics(robot)
    found = kinematics.refine([kinematics.fk(stretched)], stretched[None])
    np.testing.assert_allclose(kinematics.fk(found[0]).homogeneous, kinematics.fk(stretched).homogeneous, atol=1e-6)
