"""Force sensing: calibration by moving, filter, and the deviation of [L] (3)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from sensing.force.force_calibration import identify_elasticity, identify_tool
from sensing.force.force_deviation import WrenchFilter, force_deviation
from sensing.force.wrench import WrenchSample
from sensing.sensing_error import SensingError
from sim.contact.force_sensor import ForceSensor, ForceSensorSettings


def test_bias_and_weight_are_told_apart() -> None:
    rng = np.random.default_rng(0)
    settings = ForceSensorSettings(mass=1.3, com=(0.02, -0.01, 0.07))
    sensor = ForceSensor(settings, rng)
    poses = [pin.SE3(pin.exp3(rng.uniform(-1.5, 1.5, 3)), np.zeros(3)) for _ in range(10)]
    wrenches = np.array([np.mean([sensor.sample(0.0, pose, np.zeros(3)).wrench for _ in range(200)], axis=0)
                         for pose in poses])
    load = identify_tool(wrenches, [pose.rotation for pose in poses])
    assert load.mass == pytest.approx(1.3, abs=0.01)
    np.testing.assert_allclose(load.com, settings.com, atol=1e-3)
    # What is left of a touch in another orientation is the touch.
    pose = pin.SE3(pin.exp3(np.array([0.3, -1.0, 0.5])), np.zeros(3))
    push = np.array([1.0, -2.0, 15.0])
    sensed = np.mean([sensor.sample(0.0, pose, push).wrench for _ in range(400)], axis=0)
    np.testing.assert_allclose(pose.rotation @ load.contact(sensed, pose.rotation)[:3], push, atol=0.1)


def test_one_orientation_is_not_enough() -> None:
    with pytest.raises(SensingError, match="different orientations"):
        identify_tool(np.zeros((5, 6)), [np.eye(3)] * 5)


def test_elasticity_by_moving() -> None:
    rng = np.random.default_rng(1)
    position = np.linspace(0.004, -0.008, 200)
    force = np.maximum(0.0, 4000 * (0.001 - position)) + 0.3 * rng.standard_normal(200)
    found = identify_elasticity(position, force)
    assert abs(found.stiffness - 4000) < 3 * found.std
    assert found.touch == pytest.approx(0.001, abs=5e-5)
    with pytest.raises(SensingError, match="press harder"):
        identify_elasticity(position, 0.1 * np.abs(force) / 4)
    with pytest.raises(SensingError, match="does not rise"):
        identify_elasticity(-position, force)


def test_filter_has_no_lag_on_a_ramp() -> None:
    smooth = WrenchFilter(0.02)
    for k in range(20):
        t = 0.004 * k
        out = smooth.add(WrenchSample(t, t + 0.02, 100.0 * t * np.ones(6)))
    np.testing.assert_allclose(out.wrench, 100.0 * out.t)
    assert smooth.count == 5


def test_deviation_is_force_error_over_elasticity() -> None:
    """[L] (3), and friction along the surface does not count when the normal is known."""
    up = np.array([0.0, 0.0, 1.0])
    weak = force_deviation(np.array([0.0, 0.0, 12.0]), up, 20.0, 4000.0, sigma=0.3)
    assert weak.value == pytest.approx(-0.002)
    normal = np.array([-0.2, 0.0, 1.0]) / np.hypot(0.2, 1.0)
    along = np.array([1.0, 0.0, 0.2]) / np.hypot(0.2, 1.0)
    rubbing = force_deviation(20.0 * normal - 3.0 * along, up, 20.0, 4000.0, sigma=0.3, normal=normal)
    assert rubbing.value == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(InputError, match="positive elasticity"):
        force_deviation(up, up, 20.0, 0.0, sigma=0.3)
