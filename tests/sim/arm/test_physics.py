"""The world itself: PyBullet's links obey the same equations of motion as Pinocchio's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, LimitError
from ideal_robot.robots.interface import RobotInterface
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.rtde import RtdeRobot
from sim.arm.arm import SimulatedArm
from sim.arm.body import load_links, start_physics
from sim.arm.drive import drive_parameters, drive_start, steady_friction
from sim.arm.kernel import L_ANGLE, L_TORQUE, L_VELOCITY, LOGGED, X_LUBRICANT, X_TEMPERATURE, drive_step
from sim.arm.specimen import Specimen
from sim.arm.world import STEP, World
from sim.bullet import pybullet
from sim.devices.rtde_controller import RtdeController
from tests.sim.devices.controllers import PATIENCE, controlled, serving

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


# The true friction: what a test rig measures when it turns one drive.

ROBOT = Robot.load("kr6")
N = ROBOT.n
WORLD = World.default("kr6").replace(elasticity=False, torque_ripple=0.0, load_friction=0.0, thermal=False,
                                     log_cycle=STEP)


SHEET = Specimen(ROBOT.pinocchio, ROBOT.rotor_inertia, np.ones(N), np.zeros(N), np.zeros((2, N)))
"""The arm as its data sheet has it."""


class Rig:
    """Turns all drives at imposed speeds; friction is what of the motor torque does not arrive."""

    def __init__(self, world: World) -> None:
        self.p, self.s, self.counts = drive_parameters(world, ROBOT, SHEET)
        self.x = drive_start(self.p, np.zeros(N), np.zeros(N), np.zeros(N), world.per_joint("start_temperature", N))
        self.q, self.tick = np.zeros(N), 0

    def turn(self, speed: Array) -> Array:
        """Friction ``(N, n)`` at imposed speeds ``(N, n)``."""
        friction = np.zeros_like(speed)
        links, row, none = np.zeros((4, N)), np.zeros(1 + len(LOGGED) * N), np.zeros(N)
        motor = 1 + LOGGED.index("tau_motor") * N
        for k, v in enumerate(speed):
            links[L_ANGLE], links[L_VELOCITY] = self.q, v
            drive_step(self.tick, self.p, self.s, self.counts, self.x, links, none, row)
            friction[k] = row[motor: motor + N] - links[L_TORQUE]
            self.q = self.q + STEP * v
            self.tick += 1
        return friction


def constant(speed: float, seconds: float) -> Array:
    return np.full((round(seconds / STEP), N), speed)


def test_sliding_long_enough_gives_the_steady_curve() -> None:
    for speed in (-2.0, -0.1, 0.02, 0.5, 1.5):
        measured = Rig(WORLD).turn(constant(speed, max(0.5, 0.03 / abs(speed))))[-1]
        np.testing.assert_allclose(measured, steady_friction(WORLD, N, np.full((1, N), speed))[0], rtol=1e-9)


def test_breakaway_is_higher_than_sliding_and_reached_elastically() -> None:
    slow = 0.002
    friction = Rig(WORLD).turn(constant(slow, 2.0))
    breakaway = WORLD.per_joint("coulomb", N) + WORLD.per_joint("stribeck", N)
    np.testing.assert_allclose(friction.max(axis=0), breakaway, rtol=0.05)
    # The first fifth of the presliding range is a spring of the stiffness F_c / presliding.
    presliding = WORLD.per_joint("presliding", N)
    for j in range(N):
        k = round(0.1 * presliding[j] / (slow * STEP))
        slope = (friction[2 * k, j] - friction[k, j]) / (k * slow * STEP)
        assert 0.7 < slope / (WORLD.per_joint("coulomb", N)[j] / presliding[j]) < 1.05


def test_presliding_has_hysteresis_and_sliding_forgets_it() -> None:
    t = np.arange(4000) * STEP
    span = 0.5 * WORLD.per_joint("presliding", N)
    speed = 2 * np.pi * np.cos(2 * np.pi * t)[:, None] * span
    friction = Rig(WORLD).turn(speed)
    q = np.sin(2 * np.pi * t)[:, None] * span
    area = np.sum(friction[2000:-1] * np.diff(q[2000:], axis=0), axis=0)
    assert np.all(area > 0.02 * span * WORLD.per_joint("coulomb", N))


def test_stribeck_falls_and_the_rest_rises_degressively() -> None:
    v = np.linspace(0.002, 2.5, 2000)
    curve = steady_friction(WORLD, N, np.tile(v[:, None], N))
    lowest = curve.argmin(axis=0)
    assert np.all(curve[lowest, range(N)] < 0.95 * curve[0])
    assert np.all(v[lowest] < 0.3)
    for j in range(N):
        rising = curve[v > 4 * WORLD.per_joint("stribeck_velocity", N)[j], j]
        assert np.all(np.diff(rising, 2) < 0), "degressive: the slope falls all the way"


def test_friction_takes_energy_only() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(6000) * STEP
    speed = sum(rng.normal(0, 0.3, N) * np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6, N))
                for f in (0.3, 1.1, 4.0, 9.0))
    work = np.cumsum(Rig(WORLD).turn(speed) * speed * STEP, axis=0)
    # Bent bristles can give back what they store, ½ F²/σ0, and no more.
    stored = 0.5 * (WORLD.per_joint("coulomb", N) + WORLD.per_joint("stribeck", N)) ** 2 / (
        WORLD.per_joint("coulomb", N) / WORLD.per_joint("presliding", N))
    assert np.all(work >= -1.05 * stored)
    assert np.all(work[-1] > 0)


def test_direction_load_and_temperature_matter() -> None:
    speed = constant(0.8, 0.2)
    base = Rig(WORLD).turn(speed)[-1]
    sided = Rig(WORLD.replace(friction_asymmetry=0.2))
    assert np.all(sided.turn(speed)[-1] > base)
    assert np.all(-sided.turn(-constant(0.8, 0.5))[-1] < base)
    warm = Rig(WORLD.replace(start_temperature=65.0)).turn(speed)[-1]
    assert np.all(warm < 0.85 * base)
    np.testing.assert_allclose(warm, steady_friction(WORLD, N, speed[:1], temperature=65.0)[0], rtol=1e-9)
    loaded = Rig(WORLD.replace(load_friction=0.5, torque_limits=False))
    assert np.all(loaded.turn(speed)[-1] > base)


def test_gears_warm_up_with_their_friction_power() -> None:
    world = WORLD.replace(thermal=True, time_compression=2000.0, start_temperature=22.0)
    rig = Rig(world)
    seconds = 4.0 * float(world.per_joint("thermal_time_constant", N).max()) / world.time_compression
    friction = rig.turn(constant(1.0, seconds))
    temperature = rig.x[X_TEMPERATURE]
    settled = world.ambient_temperature + world.per_joint("thermal_resistance", N) * friction[-1] * 1.0
    np.testing.assert_allclose(temperature, settled, atol=1.5)
    assert np.all(temperature > 24.0)
    assert np.all(friction[-1] < friction[200]), "warm gears rub less"


def test_compressed_time_is_the_same_warm_up_sooner() -> None:
    slow, fast = (Rig(replace(WORLD, thermal=True, time_compression=c)) for c in (100.0, 400.0))
    slow.turn(constant(1.0, 2.0))
    fast.turn(constant(1.0, 0.5))
    np.testing.assert_allclose(slow.x[X_TEMPERATURE], fast.x[X_TEMPERATURE], rtol=2e-3)


def test_a_rest_settles_the_lubricant() -> None:
    world = WORLD.replace(lubrication=0.2, time_compression=100.0)
    rig = Rig(world)
    moving = rig.turn(constant(1.0, 3.0))[-1]
    rig.turn(constant(0.0, 3.0))
    assert np.all(rig.x[X_LUBRICANT] < 0.05)
    after_rest = rig.turn(constant(1.0, 0.05))[-1]
    assert np.all(after_rest > 1.1 * moving)
    np.testing.assert_allclose(rig.turn(constant(1.0, 3.0))[-1], moving, rtol=1e-2)


# The laws of ``RobotInterface``, over the simulated arm itself and over one behind KUKA RSI and UR's RTDE.

KINDS = ("simulated", "rsi_absolute", "rsi_relative", "rtde")


def opened(kind: str, world: World, stack: ExitStack) -> RobotInterface:
    arm = stack.enter_context(SimulatedArm(ROBOT, world, np.random.default_rng(3)))
    if kind == "simulated":
        return arm
    if kind == "rtde":
        controller = stack.enter_context(serving(RtdeController(arm, timeout=PATIENCE)))
        host, port = controller.address
        rtde = stack.enter_context(RtdeRobot(ROBOT, host, port=port, timeout=PATIENCE))
        rtde.connect()
        return rtde
    relative = kind == "rsi_relative"
    link = stack.enter_context(RsiRobot(ROBOT, port=0, relative=relative, timeout=PATIENCE))
    stack.enter_context(controlled(arm, link.address[1], relative=relative))
    link.connect(PATIENCE)
    return link


@pytest.fixture(params=KINDS)
def interface(request: pytest.FixtureRequest) -> Iterator[RobotInterface]:
    with ExitStack() as stack:
        yield opened(request.param, World.ideal("kr6"), stack)


def ramp(cycles: int) -> Array:
    share = np.clip(np.arange(1, cycles + 1) / cycles, 0.0, 1.0)[:, None]
    return np.asarray(ROBOT.home + share**2 * (3 - 2 * share) * np.array([0.1, -0.05, 0.08, 0.2, -0.1, 0.3]))


def test_a_cycle_is_a_cycle(interface: RobotInterface) -> None:
    states = [interface.cycle(ROBOT.home) for _ in range(4)]
    np.testing.assert_allclose([state.t for state in states], ROBOT.t_ipo * np.arange(1, 5), atol=1e-9)
    assert all(state.q.shape == state.tau.shape == (ROBOT.n,) for state in states)
    assert interface.t_ipo == ROBOT.t_ipo


def test_commanded_to_stay_it_stays(interface: RobotInterface) -> None:
    for _ in range(10):
        state = interface.cycle(ROBOT.home)
    np.testing.assert_allclose(state.q, ROBOT.home, atol=1e-4)


def test_it_goes_where_it_is_commanded(interface: RobotInterface) -> None:
    path = np.vstack([ramp(40), np.tile(ramp(40)[-1], (40, 1))])
    for q_c in path:
        state = interface.cycle(q_c)
    np.testing.assert_allclose(state.q, path[-1], atol=2e-4)


def test_what_cannot_be_commanded_is_refused_and_nothing_moves(interface: RobotInterface) -> None:
    interface.cycle(ROBOT.home)
    for bad in (np.zeros(5), np.full(6, np.nan)):
        with pytest.raises(InputError, match=r"q_c.*6 finite"):
            interface.cycle(bad)
    with pytest.raises(LimitError, match=r"joint 2.*position"):
        interface.cycle(np.where(np.arange(6) == 1, ROBOT.q_max + 0.01, ROBOT.home))
    with pytest.raises(LimitError, match=r"joint 4.*velocity"):
        interface.cycle(ROBOT.home + np.array([0, 0, 0, 1.0, 0, 0]))
    state = interface.cycle(ROBOT.home)
    np.testing.assert_allclose(state.q, ROBOT.home, atol=1e-4)
    assert state.t == pytest.approx(2 * ROBOT.t_ipo)


@pytest.mark.parametrize("kind", KINDS[1:])
def test_behind_a_controller_the_same_arm_moves_the_same(kind: str) -> None:
    """Same world, same seed: only the six decimals of a degree in the messages differ, and they must not add up."""
    world = World.default("kr6").replace(quantisation=False)
    runs = []
    for which in ("simulated", kind):
        with ExitStack() as stack:
            arm = opened(which, world, stack)
            if (which, kind) == ("simulated", "rtde"):
                # Until the registers are written, a cycle has passed behind RTDE.
                arm.cycle(ROBOT.home)
            runs.append([arm.cycle(q_c) for q_c in ramp(60)])
    direct, behind = runs
    np.testing.assert_allclose([s.q for s in behind], [s.q for s in direct], atol=1e-7)
    np.testing.assert_allclose([s.tau for s in behind], [s.tau for s in direct], atol=0.05)
