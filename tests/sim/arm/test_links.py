"""The world itself: PyBullet's links obey the same equations of motion as Pinocchio's."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.body import load_links, start_physics
from sim.arm.world import STEP, World
from sim.bullet import pybullet

ROBOTS = ("kr6", "kr15", "manutec_r15")


@pytest.fixture
def client() -> Iterator[int]:
    number = start_physics()
    yield number
    pybullet.disconnect(number)


def _state(body: int, n: int, client: int) -> tuple[Array, Array]:
    states = pybullet.getJointStates(body, list(range(n)), physicsClientId=client)
    return np.array([s[0] for s in states]), np.array([s[1] for s in states])


@pytest.mark.parametrize("name", ROBOTS)
def test_forward_dynamics_agree_over_a_random_motion(name: str, client: int) -> None:
    model = Robot.load(name).pinocchio
    data, n = model.createData(), model.nv
    body = load_links(model, client)
    rng = np.random.default_rng(5)
    amplitude = 0.4 * np.array([300.0, 500.0, 200.0, 15.0, 15.0, 4.0])
    frequency, phase = rng.uniform(0.3, 2.5, n), rng.uniform(0.0, 6.0, n)
    q, v = _state(body, n, client)
    fastest = 0.0
    for k in range(1500):
        torque = pin.computeGeneralizedGravity(model, data, q) + amplitude * np.sin(
            2 * np.pi * frequency * k * STEP + phase)
        expected = pin.aba(model, data, q, v, torque)
        pybullet.setJointMotorControlArray(body, list(range(n)), pybullet.TORQUE_CONTROL, forces=torque.tolist(),
                                           physicsClientId=client)
        pybullet.stepSimulation(physicsClientId=client)
        q_next, v_next = _state(body, n, client)
        assert np.linalg.norm((v_next - v) / STEP - expected) <= 1e-6 * np.linalg.norm(expected)
        np.testing.assert_allclose(q_next, q + STEP * v_next, rtol=0, atol=1e-12)
        q, v = q_next, v_next
        fastest = max(fastest, float(np.abs(v).max()))
    assert fastest > 1.0, "the motion must be fast enough for Coriolis terms to count"


def test_kinematics_agree_in_every_joint(client: int) -> None:
    # PyBullet reports frames of links in single precision.
    robot = Robot.load("kr15")
    body = load_links(robot.pinocchio, client)
    q = np.array([0.4, -1.0, 1.3, 0.7, -0.6, 1.9])
    data = robot.pinocchio.createData()
    pin.forwardKinematics(robot.pinocchio, data, q)
    for joint in range(robot.n):
        pybullet.resetJointState(body, joint, q[joint], physicsClientId=client)
    for joint in range(robot.n):
        state = pybullet.getLinkState(body, joint, computeForwardKinematics=1, physicsClientId=client)
        np.testing.assert_allclose(state[4], data.oMi[joint + 1].translation, rtol=0, atol=1e-6)
        rotation = np.array(pybullet.getMatrixFromQuaternion(state[5])).reshape(3, 3)
        np.testing.assert_allclose(rotation, data.oMi[joint + 1].rotation, rtol=0, atol=1e-6)


def test_a_free_arm_keeps_its_energy(client: int) -> None:
    """No torque, gravity only: what PyBullet would damp on its own shows as lost energy."""
    model = Robot.load("kr6").pinocchio
    data, n = model.createData(), model.nv
    body = load_links(model, client)
    for joint, (angle, speed) in enumerate(zip([0.2, -1.2, 1.0, 0.3, 0.5, 0.0], [0.8, 0.3, -0.5, 1.0, 1.0, 2.0],
                                               strict=True)):
        pybullet.resetJointState(body, joint, angle, speed, physicsClientId=client)
    energies = []
    for _ in range(600):
        q, v = _state(body, n, client)
        # Semi-implicit velocities belong to the middle between two steps.
        energies.append(pin.computeKineticEnergy(model, data, q - 0.5 * STEP * v, v)
                        + pin.computePotentialEnergy(model, data, q - 0.5 * STEP * v))
        pybullet.stepSimulation(physicsClientId=client)
    turned_over = max(pin.computeKineticEnergy(model, data, *_state(body, n, client)), 100.0)
    assert np.ptp(energies) < 2e-3 * turned_over


@pytest.mark.parametrize("name", ROBOTS)
def test_ideal_arm_is_links_plus_rotors(name: str) -> None:
    """With every effect off, the arm moves as Pinocchio says links with rotor inertias move under the motor torque."""
    robot = Robot.load(name)
    model = robot.pinocchio.copy()
    model.armature = robot.rotor_inertia
    data = model.createData()
    with SimulatedArm(robot, World.ideal(name).replace(log_cycle=STEP), np.random.default_rng(0)) as arm:
        rate = np.array([0.5, 0.4, 0.6, 0.9, 0.8, 1.1])
        for k in range(80):
            arm.cycle(robot.home + 0.25 * (1 - np.cos(2 * np.pi * rate * k * arm.t_ipo)))
        log = arm.history()
    q, v = log["q_a"][0].copy(), log["qd_a"][0].copy()
    for torque, q_true, v_true in zip(log["tau_motor"], log["q_a"], log["qd_a"], strict=True):
        np.testing.assert_allclose(q_true, q, rtol=0, atol=1e-8)
        np.testing.assert_allclose(v_true, v, rtol=0, atol=1e-7)
        v = v + STEP * pin.aba(model, data, q, v, torque)
        q = q + STEP * v
    np.testing.assert_array_equal(log["q_m"], log["q_a"])
    assert np.abs(log["qd_a"]).max() > 0.5
