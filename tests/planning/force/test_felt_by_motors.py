"""The motors as a witness along a path."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from planning.force.felt_by_motors import BEHIND, BeyondSensor
from planning.path.kinematics import InverseKinematics
from scenes.force.cell import set_up
from scenes.scene_file import load_scene

T, UP = 0.004, np.eye(3)[2]


def heard(way: Array, unfelt: float, currents: bool = True) -> float:
    """What is heard of a force that the sensor does not tell [N], the joints swinging so far ``(n,)`` [rad]."""
    known = set_up(load_scene("force_wave")).known
    robot, model, rng = known.robot, known.model, np.random.default_rng(1)
    motors, kinematics = BeyondSensor(model, T), InverseKinematics(robot)
    t = T * np.arange(800)[:, None]
    q, v, a = (robot.home + way * np.sin(3 * t), 3 * way * np.cos(3 * t), -9 * way * np.sin(3 * t))
    late = round(BEHIND / T)
    for k in range(late, len(t)):
        motors.commanded(q[k])
        torque = kinematics.torque(q[k - late], UP)
        tau = model.inverse_dynamics(q[k - late], v[k - late], a[k - late])[0] - torque * (20.0 + unfelt)
        tau = tau + model.noise_std * rng.standard_normal(robot.n)
        motors.hear(RobotState(T * k, q[k - late], tau if currents else np.full(robot.n, np.nan)), torque, 20.0)
        motors.weigh()
    return motors.excess


@pytest.mark.parametrize("unfelt", [0.0, 10.0, -6.0])
def test_a_force_that_the_sensor_does_not_tell_is_found(unfelt: float) -> None:
    assert heard(np.full(6, 0.1), unfelt) == pytest.approx(unfelt, abs=1.0)


def test_joints_at_rest_and_controllers_without_currents_say_nothing() -> None:
    assert abs(heard(np.zeros(6), 10.0)) < 1.0
    assert heard(np.full(6, 0.1), 10.0, currents=False) == 0.0
