"""The true friction: what a test rig measures when it turns one drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from sim.arm.drive import drive_parameters, drive_start
from sim.arm.friction import steady_friction
from sim.arm.kernel import L_ANGLE, L_TORQUE, L_VELOCITY, LOGGED, X_LUBRICANT, X_TEMPERATURE, drive_step
from sim.arm.world import STEP, World

ROBOT = Robot.load("kr6")
N = ROBOT.n
WORLD = World.default("kr6").replace(elasticity=False, torque_ripple=0.0, load_friction=0.0, thermal=False,
                                     log_cycle=STEP)


class Rig:
    """Turns all drives at imposed speeds; friction is what of the motor torque does not arrive."""

    def __init__(self, world: World) -> None:
        self.p, self.s, self.counts = drive_parameters(world, ROBOT, ROBOT.rotor_inertia, np.ones(N), np.zeros(N))
        self.x = drive_start(self.p, np.zeros(N), np.zeros(N), world.per_joint("start_temperature", N))
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
