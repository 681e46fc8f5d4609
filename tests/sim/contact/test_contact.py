"""The tip on a surface: spring, friction, nothing where there is no touch, and the arm feels it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.contact.contact import HeightSurface, Tip, TipContact, Wave
from sim.contact.force_sensor import ForceSensor, ForceSensorSettings


def test_heights_and_slopes_belong_together() -> None:
    surface = HeightSurface(pin.SE3.Identity(), (Wave(0.004, 0.2, 0.3, 1.0), Wave(0.001, 0.1, -1.0)), curvature=0.5,
                            crest=0.1, offset=0.002, tilt=(0.02, -0.03))
    x, y, h = 0.13, -0.07, 1e-6
    along, across = surface.slope(x, y)
    assert along == pytest.approx(float(surface.height(x + h, y) - surface.height(x - h, y)) / (2 * h), abs=1e-6)
    assert across == pytest.approx(float(surface.height(x, y + h) - surface.height(x, y - h)) / (2 * h), abs=1e-6)


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
