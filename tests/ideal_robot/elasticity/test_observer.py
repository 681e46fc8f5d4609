"""The arm angles behind elastic gears, against the simulated arm that the observer does not know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.elasticity.observer import ArmObserver
from ideal_robot.elasticity.observer_adaptation import adapt_observer
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.models import shipped_model
from sim.arm.arm import SimulatedArm
from sim.arm.world import World


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


def test_two_measured_directions_adapt_the_observer() -> None:
    """[L] 3.3, [7]: a wrong stiffness is found from two of six degrees of freedom, off line."""
    robot, world = Robot.load("kr6"), World.default("kr6")
    frequency = 2 * np.pi * np.array([0.9, 1.1, 1.3, 1.5, 1.7, 1.9])
    with SimulatedArm(robot, world, np.random.default_rng(0)) as arm:
        for k in range(250):
            swing = np.array([0.12, 0.08, 0.08, 0.1, 0.1, 0.1]) * np.sin(frequency * 0.012 * k)
            arm.cycle(robot.home + swing * (1 - np.exp(-((0.012 * k / 0.3) ** 2))))
        recording = arm.recording(external=True)
    true = np.column_stack([recording.columns[f"qa_{i + 1}"] for i in range(6)])[::6]
    partial = Recording({name: np.array(values) for name, values in recording.columns.items() if name not in "xq"
                         and not name.startswith("qa")}, recording.meta)
    model = Model.load(shipped_model("kr6"))
    assert model.stiffness is not None
    wrong = replace(model, stiffness=np.array(model.stiffness) * np.array([0.75, 1.3, 0.75, 1.0, 1.0, 1.0]))
    assert "x" not in partial.columns
    adapted = adapt_observer(partial, robot, wrong)
    assert adapted.residual_after < 0.6 * adapted.residual_before
    first = ArmObserver(wrong, 0.012).angles(partial.joints("q")[::6])
    for before, after in ((first[40:], adapted.q_a[40:]),):
        assert np.std((after - true[40:])[:, :3]) < 0.6 * np.std((before - true[40:])[:, :3])
    truth = world.per_joint("stiffness", 6)
    assert abs(adapted.model.stiffness[1] / truth[1] - 1) < 0.15  # type: ignore[index]
    with pytest.raises(InputError, match="at least one of x, y, z"):
        adapt_observer(Recording({"t": partial.t}), robot, wrong)
