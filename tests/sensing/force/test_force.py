"""Force sensing: calibration by moving, filter, and the deviation of [L] (3)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from sensing.force.force_calibration import ToolLoad, identify_elasticity, identify_tool
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


def test_an_untouched_tool_shows_no_contact_in_any_orientation() -> None:
    """Weight acts at the tool's centre: its moment about the sensor is com × weight, and is taken away as such."""
    com, mass, bias = np.array([0.02, -0.01, 0.07]), 1.3, np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    rng = np.random.default_rng(3)
    for _ in range(5):
        rotation = pin.exp3(rng.uniform(-2.0, 2.0, 3))
        weight = rotation.T @ np.array([0.0, 0.0, -9.81 * mass])
        sensed = bias + np.concatenate([weight, np.cross(com, weight)])
        touch = rng.normal(size=6)
        load = ToolLoad(bias, mass, com, np.zeros(2))
        np.testing.assert_allclose(load.contact(sensed + touch, rotation), touch, atol=1e-12)
        felt = ForceSensor(ForceSensorSettings(mass=mass, com=tuple(com), noise=(0.0, 0.0), bias=(0.0, 0.0)), rng)
        np.testing.assert_allclose(felt.sample(0.0, pin.SE3(rotation, np.zeros(3)), np.zeros(3)).wrench, sensed - bias)


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


@pytest.mark.parametrize("force", [19.9, 12.0, 40.0])
def test_the_deviation_is_as_sure_as_its_noise_and_the_stiffness_let_it_be(force: float) -> None:
    """Over contacts whose true stiffness is about the assumed one: what is left scatters as the deviation says."""
    rng, up, wanted, assumed, sigma, error = np.random.default_rng(6), np.array([0.0, 0.0, 1.0]), 20.0, 5e3, 0.3, 0.1
    true = (force - wanted) / assumed
    left, said = [], []
    for _ in range(4000):
        felt = wanted + true * assumed / (1.0 + error * rng.standard_normal()) + sigma * rng.standard_normal()
        seen = force_deviation(felt * up, up, wanted, assumed, sigma=sigma, elasticity_error=error)
        left.append(seen.value - true)
        said.append(seen.sigma)
    assert np.median(said) == pytest.approx(np.std(left), rel=0.06)
