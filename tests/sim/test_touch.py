"""What touches the arm: forces from a hook, and bodies in its physics client."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.robot import Robot
from sim.arm import SimulatedArm
from sim.bullet import pybullet
from sim.world import World

ROBOT = Robot.load("kr6")
# Without friction the motors return exactly to their command, so what is left of a force is the gears' twist.
WORLD = World.default("kr6").replace(inertia_tolerance=0.0, friction=False, quantisation=False, torque_ripple=0.0)


def test_a_force_at_the_tool_twists_the_gears_by_their_compliance() -> None:
    force = np.array([20.0, -30.0, 40.0])
    with SimulatedArm(ROBOT, WORLD, np.random.default_rng(0)) as arm:
        for _ in range(5):
            arm.cycle(ROBOT.home)
        free = arm.truth
        arm.step_hook = lambda t: pybullet.applyExternalForce(
            arm.body, arm.tool_link, force.tolist(), arm.tcp_of(arm.truth.q_a).translation.tolist(),
            pybullet.WORLD_FRAME, physicsClientId=arm.client)
        for _ in range(120):
            arm.cycle(ROBOT.home)
        pushed = arm.truth
    np.testing.assert_allclose(pushed.q_m, free.q_m, atol=2e-6)
    data = ROBOT.model.createData()
    jacobian = pin.computeFrameJacobian(ROBOT.model, data, free.q_a, ROBOT.tool_id,
                                        pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
    twist = jacobian.T @ force / WORLD.per_joint("stiffness", 6)
    np.testing.assert_allclose(pushed.q_a - free.q_a, twist, atol=0.01 * np.abs(twist).max())
    assert np.abs(twist).max() > 5e-5


def test_a_ball_at_the_tcp_presses_on_a_table() -> None:
    radius, gap = 0.02, 0.004
    with SimulatedArm(ROBOT, WORLD, np.random.default_rng(0), tool_radius=radius) as arm:
        tcp = arm.truth.tcp.translation
        shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.3, 0.3, 0.05],
                                              physicsClientId=arm.client)
        table = pybullet.createMultiBody(0.0, shape, basePosition=[tcp[0], tcp[1], tcp[2] - radius - gap - 0.05],
                                         physicsClientId=arm.client)
        pybullet.changeDynamics(table, -1, contactStiffness=2e4, contactDamping=200.0, physicsClientId=arm.client)
        jacobian = pin.computeFrameJacobian(ROBOT.model, ROBOT.model.createData(), ROBOT.home, ROBOT.tool_id,
                                            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        down = np.linalg.solve(jacobian, np.array([0, 0, -1.0, 0, 0, 0]))
        arm.cycle(ROBOT.home)
        assert not pybullet.getContactPoints(arm.body, table, physicsClientId=arm.client)
        for depth in [*np.linspace(0, gap + 0.002, 100), *[gap + 0.002] * 60]:
            arm.cycle(ROBOT.home + depth * down)
        points = pybullet.getContactPoints(arm.body, table, physicsClientId=arm.client)
        force = sum(point[9] for point in points)
        sunk = tcp[2] - radius - gap - (arm.truth.tcp.translation[2] - radius)
        assert points[0][3] == arm.tool_link
    assert force == pytest.approx(2e4 * sunk, rel=0.1)
    assert force > 5.0
