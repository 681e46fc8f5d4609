"""The arm angles behind elastic gears, against the simulated arm that the observer does not know."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.elasticity.observer import ArmObserver
from ideal_robot.model import Model
from ideal_robot.robot import Robot
from scenes.models import shipped_model
from sim.arm import SimulatedArm
from sim.world import World


@pytest.fixture(scope="module")
def moved() -> tuple[np.ndarray, np.ndarray]:
    """Motor angles (as the controller tells) and true arm angles of a lively motion."""
    robot, world = Robot.load("kr6"), World.default("kr6")
    frequency = 2 * np.pi * np.array([0.8, 1.1, 1.3, 1.5, 0.9, 1.1])
    motors, arms = [robot.home], []
    with SimulatedArm(robot, world, np.random.default_rng(0)) as arm:
        arms.append(arm.truth.q_a)
        for k in range(250):
            t = 0.012 * k
            swing = np.array([0.1, 0.05, 0.05, 0.1, 0.1, 0.1]) * np.sin(frequency * t) * (1 - np.exp(-((t / 0.3) ** 2)))
            motors.append(arm.cycle(robot.home + swing + 2e-4 * np.sin(2 * np.pi * 7 * t)).q)
            arms.append(arm.truth.q_a)
    return np.array(motors), np.array(arms)


def test_observer_removes_most_of_the_deflection(moved: tuple[np.ndarray, np.ndarray]) -> None:
    """Base joints, which carry the tip's error: below 40 % of the deflection is left, sag included below 10 %."""
    q, q_a = moved
    observed = ArmObserver(Model.load(shipped_model("kr6")), 0.012).angles(q)
    before, after = (q - q_a)[40:, :3], (observed - q_a)[40:, :3]
    assert np.all(np.std(after, axis=0) < 0.4 * np.std(before, axis=0))
    assert np.sqrt(np.mean(after**2)) < 0.1 * np.sqrt(np.mean(before**2))


def test_at_rest_it_is_the_spring_under_weight_and_contact() -> None:
    """[J] (1): k (q − q_a) = G(q_a) − τ_ext, and a long rest does not change it."""
    model = Model.load(shipped_model("kr6"))
    robot = Robot.load("kr6")
    observer = ArmObserver(model, 0.012)
    tau_ext = np.array([10.0, 20.0, -5.0, 1.0, 2.0, 0.5])
    assert model.stiffness is not None
    free, pressed = observer.init(robot.home), observer.init(robot.home, tau_ext)
    np.testing.assert_allclose(pressed.q_a - free.q_a, tau_ext / model.stiffness, rtol=0.02, atol=1e-6)
    state = pressed
    for _ in range(100):
        state = observer.step(state, robot.home, tau_ext)
    np.testing.assert_allclose(state.q_a, pressed.q_a, atol=2e-7)


def test_without_stiffness_the_motors_are_the_arm() -> None:
    robot = Robot.load("kr6")
    observer = ArmObserver(Model.nominal(robot), 0.012)
    q = np.tile(robot.home, (5, 1)) + 0.01 * np.arange(5)[:, None]
    np.testing.assert_array_equal(observer.angles(q)[1:], q[1:])
