"""What touches the arm: forces from a hook, and bodies in its physics client."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.world import STEP, World
from sim.bullet import pybullet

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
    data = ROBOT.pinocchio.createData()
    jacobian = pin.computeFrameJacobian(ROBOT.pinocchio, data, free.q_a, ROBOT.tool_id,
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
        jacobian = pin.computeFrameJacobian(ROBOT.pinocchio, ROBOT.pinocchio.createData(), ROBOT.home, ROBOT.tool_id,
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


def test_rigid_rotors_feel_what_touches_the_links() -> None:
    """A push on the ideal arm moves links and rotors as Pinocchio says links with rotors move under it."""
    model = ROBOT.pinocchio.copy()
    model.armature = ROBOT.rotor_inertia
    data = model.createData()
    with SimulatedArm(ROBOT, World.ideal("kr6").replace(log_cycle=STEP), np.random.default_rng(0)) as arm:
        pushes = []

        def push(t: float) -> None:
            force = np.array([60.0, -40.0, 80.0]) * np.sin(2 * np.pi * 3.0 * t)
            pybullet.applyExternalForce(arm.body, arm.tool_link, force.tolist(),
                                        arm.tcp_of(arm.q_a).translation.tolist(), pybullet.WORLD_FRAME,
                                        physicsClientId=arm.client)
            pushes.append(force)

        arm.step_hook = push
        for _ in range(40):
            arm.cycle(ROBOT.home)
        log = arm.history()
    actual = np.diff(log["qd_a"], axis=0) / STEP
    expected, untouched = np.zeros_like(actual), np.zeros_like(actual)
    for k, (q, v, torque, force) in enumerate(zip(log["q_a"][:-1], log["qd_a"], log["tau_motor"], pushes[:-1],
                                                  strict=False)):
        jacobian = pin.computeFrameJacobian(model, data, q, ROBOT.tool_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
        expected[k] = pin.aba(model, data, q, v, torque + jacobian.T @ force)
        untouched[k] = pin.aba(model, data, q, v, torque)
    # At 3 Hz half a millisecond is ω T = 1 % of the push. Until the rotor knows, the link bears it alone and moves by
    # (M + J) / M too much, a lot where the rotor outweighs the link.
    outweighed = 1 + ROBOT.rotor_inertia / np.diag(pin.crba(ROBOT.pinocchio, ROBOT.pinocchio.createData(), ROBOT.home))
    late = 2 * np.pi * 3.0 * STEP * outweighed
    effect = np.sqrt(np.mean((expected - untouched) ** 2, axis=0))
    assert np.all(np.sqrt(np.mean((actual - expected) ** 2, axis=0)) < 3 * late * effect)
    assert np.all(effect > 1e-3)
