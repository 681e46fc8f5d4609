"""The clamped arm is in equilibrium, and its parts do what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.robots.robot import Robot
from sim.contact.clamp import ClampedArm, dry_friction
from sim.contact.clamp_world import ClampWorld
from sim.contact.payload_rig import loaded_pose

Q = np.array([0.3, -1.2, 1.6, 0.4, -0.9, 0.2])


def test_torques_balance_at_equilibrium() -> None:
    """[J] (1): k (q_m − q) = G(q) + J(q)ᵀ F_e."""
    robot = Robot.load("kr500")
    world = ClampWorld.default(robot)
    arm = ClampedArm(robot, world, Q)
    q_m = arm.qm0 + 1e-3 * np.array([1.0, -0.5, 0.7, 2.0, -1.0, 1.5])
    q = arm.equilibrium(q_m, Q)
    data = robot.pinocchio.createData()
    jacobian = pin.computeFrameJacobian(robot.pinocchio, data, q, robot.tool_id, pin.LOCAL)
    load = pin.computeGeneralizedGravity(robot.pinocchio, data, q) + jacobian.T @ arm.wrench(q)
    np.testing.assert_allclose(world.stiffness * (q_m - q), load, rtol=1e-5, atol=1e-2)
    np.testing.assert_allclose(arm.wrench(arm.equilibrium(arm.qm0, Q)), 0.0, atol=1e-3)


def test_with_a_rigid_clamp_the_arm_stands() -> None:
    robot = Robot.load("kr500")
    arm = ClampedArm(robot, ClampWorld.ideal(robot), Q)
    q = arm.equilibrium(arm.qm0 + 1e-3, Q)
    assert np.max(np.abs(q - Q)) < 1e-7


def test_force_control_pushes_along_z_alone() -> None:
    robot = Robot.load("kr500")
    world = replace(ClampWorld.default(robot), force_control=0.0)
    arm = ClampedArm(robot, world, Q)
    push = arm.press(np.array([1000.0, 4000.0]), np.random.default_rng(0))
    for level, force in zip(push.levels, (1000.0, 4000.0), strict=True):
        wrench = arm.wrench(arm.equilibrium(arm.qm0 + push.motion * level, Q))
        assert wrench[2] == pytest.approx(-force, rel=2e-3)
        assert np.max(np.abs(wrench[[0, 1, 3, 4, 5]])) < 0.02 * force


def test_friction_opposes_motion_and_is_a_loop() -> None:
    way = np.concatenate([np.linspace(0, 1e-3, 200), np.linspace(1e-3, 0, 200)])[:, None]
    torque = dry_friction(way, np.array([50.0]), 2e-5)
    assert torque[199, 0] == pytest.approx(50.0, rel=1e-6)
    assert torque[-1, 0] == pytest.approx(-50.0, rel=1e-6)


def test_payload_bends_gears_as_springs() -> None:
    """Δx = J K⁻¹ Jᵀ ΔF for a small load and rigid links."""
    robot = Robot.load("kr500")
    world = ClampWorld.ideal(robot)
    light = loaded_pose(robot, world, Q, 0.0, np.zeros(3))
    heavy = loaded_pose(robot, world, Q, 10.0, np.zeros(3))
    jacobian = pin.computeFrameJacobian(robot.pinocchio, robot.pinocchio.createData(), Q, robot.tool_id,
                                        pin.LOCAL_WORLD_ALIGNED)[:3]
    expected = jacobian @ np.diag(1 / world.stiffness) @ jacobian.T @ np.array([0.0, 0.0, -98.1])
    np.testing.assert_allclose(heavy.translation - light.translation, expected, rtol=0.02, atol=1e-7)
