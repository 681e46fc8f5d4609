"""The tip on a surface: spring, friction, nothing where there is no touch, and the arm feels it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.elasticity.payload_stiffness import identify_from_payloads
from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.world import STEP, World
from sim.bullet import pybullet
from sim.contact.clamp import ClampedArm, _dry_friction, _loaded_pose, hang_payloads
from sim.contact.clamp_world import ClampWorld
from sim.contact.contact import ForceSensor, ForceSensorSettings, HeightSurface, Tip, TipContact


def test_pressed_tip_is_a_spring_that_the_arm_feels() -> None:
    robot = Robot.load("kr6")
    world = World.default("kr6").replace(friction=False)
    with SimulatedArm(robot, world, np.random.default_rng(0)) as arm:
        tip = arm.truth.tcp
        down = pin.SE3(np.eye(3), tip.translation)
        contact = TipContact(arm, HeightSurface(down, offset=0.005), Tip(stiffness=5000.0))
        for _ in range(80):
            arm.cycle(robot.home)
        pressed = contact.history()
        depth = 0.005 - pressed["tip"][-1, 2]
        assert pressed["normal"][-1] == pytest.approx(5000.0 * depth, rel=0.02)
        assert 15.0 < pressed["normal"][-1] < 25.0
        # The arm is bent upwards by the force.
        assert arm.truth.tcp.translation[2] > tip.translation[2] + 2e-5
        np.testing.assert_allclose(contact.force_at(arm.t), pressed["force"][-1])


def test_without_touch_nothing_happens() -> None:
    robot = Robot.load("kr6")
    world = World.ideal("kr6").replace(elasticity=True)
    poses = []
    for touch in (False, True):
        with SimulatedArm(robot, world, np.random.default_rng(0)) as arm:
            if touch:
                contact = TipContact(arm, HeightSurface(pin.SE3(np.eye(3), np.zeros(3))), Tip())
            for k in range(20):
                arm.cycle(robot.home + 0.01 * np.sin(0.3 * k))
            poses.append(arm.truth.q_a)
    np.testing.assert_array_equal(poses[0], poses[1])
    assert not contact.history()["normal"].any()


def test_samples_come_at_their_rate_and_late() -> None:
    sensor = ForceSensor(ForceSensorSettings(rate=250.0, latency=0.02, jitter=0.0), np.random.default_rng(0))
    samples = [s for k in range(100) for s in sensor.due(0.012 * k, 0.012 * (k + 1), lambda t: pin.SE3.Identity(),
                                                        lambda t: np.zeros(3))]
    assert len(samples) == 300
    np.testing.assert_allclose(np.diff([s.t for s in samples]), 0.004)
    np.testing.assert_allclose([s.t_arrival - s.t for s in samples], 0.02)


# What touches the arm: forces from a hook, and bodies in its physics client.

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


# The clamped arm is in equilibrium, and its parts do what they say.

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


def gears_alone(robot: Robot) -> ClampWorld:
    return replace(ClampWorld.default(robot), link_stiffness=np.full(robot.n, np.inf), environment=(np.inf, np.inf),
                   friction=0.0, force_control=0.0, drive_gain_std=0.0, current_noise=0.0, encoder=0.0,
                   wrench_noise=(0.0, 0.0), wrench_bias=(0.0, 0.0), clock_offset=0.0, clock_drift=0.0, gaps=False)


def test_a_tool_at_the_base_has_a_bench_too() -> None:
    """Its distance from there was what the bench's stiffness was divided by."""
    arm, name = Robot.load("kr500"), "at_base"
    model = arm.pinocchio.copy()
    frame = model.frames[arm.tool_id]
    tip = frame.placement * arm.fk()(arm.home).inverse()
    model.addFrame(pin.Frame(name, frame.parentJoint, arm.tool_id, tip, pin.FrameType.OP_FRAME))
    hard = ClampWorld.default(replace(arm, pinocchio=model, tool_frame=name)).environment[0]
    assert hard < 100.0 * ClampWorld.default(arm).environment[0]


def test_with_a_rigid_clamp_the_arm_stands() -> None:
    robot = Robot.load("kr500")
    arm = ClampedArm(robot, gears_alone(robot), Q)
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
    motion = np.concatenate([np.linspace(0, 1e-3, 200), np.linspace(1e-3, 0, 200)])[:, None]
    torque = _dry_friction(motion, np.array([50.0]), 2e-5)
    assert torque[199, 0] == pytest.approx(50.0, rel=1e-6)
    assert torque[-1, 0] == pytest.approx(-50.0, rel=1e-6)


@pytest.mark.parametrize("lever", [np.zeros(3), np.array([0.4, -0.3, 0.2])], ids=["flange", "lever"])
def test_payload_bends_gears_as_a_body_of_its_mass_does(lever: np.ndarray) -> None:
    """k (q_m − q) = G(q), G of the arm with one more body at the lever's end; and the gears are found from it."""
    robot = Robot.load("kr500")
    world = gears_alone(robot)
    postures, masses = np.array([Q, Q + 0.4, Q - 0.3]), np.array([0.0, 200.0])
    carrying = robot.pinocchio.copy()
    flange = carrying.frames[robot.tool_id]
    carrying.inertias[flange.parentJoint] += flange.placement.act(pin.Inertia(200.0, lever, np.zeros((3, 3))))
    q = Q.copy()
    for _ in range(30):
        q = Q - pin.computeGeneralizedGravity(carrying, carrying.createData(), q) / world.stiffness
    offset = robot.fk()(q).inverse() * _loaded_pose(robot, world, Q, 200.0, lever)
    np.testing.assert_allclose(pin.log6(offset).vector, 0.0, atol=1e-8)
    recording = hang_payloads(robot, world, postures, masses, lever, np.random.default_rng(0), tracker=(0.0, 0.0))
    stiffness = {fit.joint: fit.stiffness for fit in identify_from_payloads([recording], robot)}
    np.testing.assert_allclose([stiffness[joint] for joint in (2, 3, 4, 5)], world.stiffness[1:5], rtol=3e-3)
