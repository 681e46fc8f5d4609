"""The clamped arm is in equilibrium, and its parts do what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.elasticity.payload_stiffness import identify_from_payloads
from ideal_robot.robots.robot import Robot
from sim.contact.clamp import ClampedArm, dry_friction
from sim.contact.clamp_world import ClampWorld
from sim.contact.payload_rig import hang_payloads, loaded_pose

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


@pytest.mark.parametrize("lever", [np.zeros(3), np.array([0.4, -0.3, 0.2])], ids=["flange", "lever"])
def test_payload_bends_gears_as_a_body_of_its_mass_does(lever: np.ndarray) -> None:
    """k (q_m − q) = G(q), G of the arm with one more body at the lever's end; and the gears are found from it."""
    robot = Robot.load("kr500")
    world = ClampWorld.ideal(robot)
    postures, masses = np.array([Q, Q + 0.4, Q - 0.3]), np.array([0.0, 200.0])
    carrying = robot.pinocchio.copy()
    flange = carrying.frames[robot.tool_id]
    carrying.inertias[flange.parentJoint] += flange.placement.act(pin.Inertia(200.0, lever, np.zeros((3, 3))))
    q = Q.copy()
    for _ in range(30):
        q = Q - pin.computeGeneralizedGravity(carrying, carrying.createData(), q) / world.stiffness
    seen = robot.fk()(q).inverse() * loaded_pose(robot, world, Q, 200.0, lever)
    np.testing.assert_allclose(pin.log6(seen).vector, 0.0, atol=1e-8)
    recording = hang_payloads(robot, world, postures, masses, lever, np.random.default_rng(0), samples=1,
                              tracker=(0.0, 0.0))
    for one in identify_from_payloads([recording], robot):
        assert one.stiffness == pytest.approx(world.stiffness[one.joint - 1], rel=0.02)
