"""The motors as a witness along a path."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from planning.force.felt_by_motors import BEHIND, BeyondSensor, FeltByMotors
from planning.path.kinematics import InverseKinematics
from scenes.force.cell import set_up
from scenes.scene_file import load_scene

T, UP = 0.004, np.eye(3)[2]


def heard(way: Array, unfelt: float, currents: bool = True, speed: float = 0.2) -> float:
    """What is heard of a force that the sensor does not tell [N], the joints swinging so far ``(n,)`` [rad]."""
    known = set_up(load_scene("force_wave")).known
    robot, model, rng = known.robot, known.model, np.random.default_rng(1)
    motors, kinematics = BeyondSensor(model, T), InverseKinematics(robot)
    t = T * np.arange(800)[:, None]
    q, v, a = (robot.home + way * np.sin(3 * t), 3 * way * np.cos(3 * t), -9 * way * np.sin(3 * t))
    for k in range(len(t)):
        torque = kinematics.torque(q[k], UP)
        tau = model.inverse_dynamics(q[k], v[k], a[k])[0] - torque * (20.0 + unfelt)
        tau = tau + model.noise_std * rng.standard_normal(robot.n)
        motors.hear(RobotState(T * k, q[k], tau if currents else np.full(robot.n, np.nan)), torque, 20.0, speed)
        motors.weigh()
    return motors.excess


@pytest.mark.parametrize("unfelt", [0.0, 10.0, -6.0])
def test_a_force_that_the_sensor_does_not_tell_is_found(unfelt: float) -> None:
    assert heard(np.full(6, 0.1), unfelt) == pytest.approx(unfelt, abs=1.0)


def test_joints_at_rest_a_tip_at_rest_and_controllers_without_currents_say_nothing() -> None:
    assert abs(heard(np.zeros(6), 10.0)) < 1.0
    assert heard(np.full(6, 0.1), 10.0, speed=0.0) == 0.0
    assert heard(np.full(6, 0.1), 10.0, currents=False) == 0.0


def test_motions_before_and_after_lost_cycles_are_no_acceleration() -> None:
    """A follower that was not let run for 50 ms took what the arm had moved meanwhile for one cycle's: 79 N."""
    known = set_up(load_scene("force_wave")).known
    robot, model = known.robot, known.model
    motors, torque = BeyondSensor(model, T), InverseKinematics(robot).torque(robot.home, UP)
    rate, lost, t = np.array([0.2, 0.05, -0.1, 0.02, 0.3, 0.1]), 5, 0.0
    for k in range(400):
        gap = k % 50 == 49
        t += T * (lost if gap else 1)
        tau = model.inverse_dynamics(robot.home + rate * t, rate, 0.0 * rate)[0] - 20.0 * torque
        state = RobotState(T * k, robot.home + rate * t, np.full(robot.n, np.nan) if gap else tau)
        motors.hear(state, torque, 20.0, 0.2)
        motors.weigh()
    assert abs(motors.excess) < 0.5


@pytest.mark.parametrize(("cycle", "needed"), [(0.012, 3), (0.004, 7)])
@pytest.mark.parametrize(("sense", "speed"), [(1.0, 0.3), (-1.0, -0.1)])
def test_the_first_word_of_the_motors_is_what_a_random_walk_lets_expect(cycle: float, needed: int, sense: float,
                                                                       speed: float) -> None:
    """Joints that slide on: the weights of the joints, the prior, and the instant whose motion counts."""
    known = set_up(load_scene("force_wave")).known
    robot, model = known.robot, known.model
    motors, torque = BeyondSensor(model, cycle), InverseKinematics(robot).torque(robot.home, UP)
    rate, rest = sense * np.array([0.2, 0.05, -0.1, 0.02, 0.3, 0.1]), np.array([90.0, -120.0, 60.0, 3.0, -6.0, 3.0])
    q = robot.home + rate * cycle * np.arange(needed)[:, None]
    distance = np.array([float(law.shape[-1, 0]) for law in model.friction.laws])
    for k in range(needed):
        assert motors.excess == 0.0
        turned = 1.0 - np.exp(-k * np.abs(rate) * cycle / distance)
        tau = model.inverse_dynamics(q[k], rate, 0.0 * rate, direction=(np.sign(rate) * turned)[None])[0]
        motors.hear(RobotState(cycle * k, q[k], tau - 20.0 * torque + rest), torque, 20.0, speed)
        motors.weigh()
    middle = needed // 2
    left = np.exp(-middle * np.abs(rate) * cycle / distance)
    friction = model.friction.torque(np.abs(rate)[None], None, None, np.ones((1, 6)))[0]
    waited = needed * cycle
    weight = waited / (2.0 * (model.noise_std + left * friction) ** 2 * (0.3 + 0.02 / np.abs(rate)))
    prior = 55.0**2 * abs(speed) * waited
    expected = -prior * torque @ (weight * rest) / (1.0 + prior * torque @ (weight * torque))
    assert motors.excess == pytest.approx(expected, rel=1e-6)
    assert abs(expected) > 0.1


@pytest.mark.parametrize("force", [0.0, 15.0, -8.0])
@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_a_force_since_the_air_is_found_whatever_friction_the_model_has_wrong(force: float, offset: float) -> None:
    """A straight slow motion: in the air first, then touching; the torque that no model knows stays the same."""
    known = set_up(load_scene("force_wave")).known
    robot, model, rng = known.robot, known.model, np.random.default_rng(2)
    kinematics = InverseKinematics(robot)
    felt = FeltByMotors(model, robot, kinematics, UP, settle=0.4)
    T, late = robot.t_ipo, round(BEHIND / robot.t_ipo)
    way = 0.1 * np.array([0.02, 0.05, -0.04, 0.03, 0.06, -0.02])
    t = T * np.arange(round(2.0 / T))[:, None]
    q, v, a = robot.home + way * t * t, 2.0 * way * t, np.tile(2.0 * way, (len(t), 1))
    for k in range(late, len(t)):
        tau = model.inverse_dynamics(q[k - late], v[k - late], a[k - late])[0] + offset
        if t[k, 0] > 1.2:
            tau = tau - force * kinematics.torque(q[k - late], UP)
        felt.add(q[k], q[k - late], tau + 0.1 * model.noise_std * rng.standard_normal(robot.n))
        # Known once the air was averaged: 0.4 s after friction has settled.
        assert np.isnan(felt.force) == (k - late < round(0.4 / T) + round(0.4 / T) - 2)
    assert felt.force == pytest.approx(force, abs=0.7)
