"""Delays: exact along their chord, of one joint, of all, of a device; what a drive's cycle holds is none."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.effects import Signals
from ideal_robot.effects.drive import LateTorque
from ideal_robot.effects.registry import find
from tests.ideal_robot.effects.test_kinematics import ROBOT, named, swinging_arm, tcp
from tests.ideal_robot.effects.test_laws import motion
from tests.ideal_robot.effects.test_loads import of_a_moved_arm


def test_dead_time_is_exact_at_its_chord():
    signals = motion()
    effect = find("dead_time", "tau")
    delay = 3.0 * signals.dt
    late = effect.columns(signals, 1, (delay,))[:, 0, 0] * delay + signals.torque[:, 0]
    np.testing.assert_allclose(late[10:-10], signals.torque[7:-13, 0], atol=1e-9)


@pytest.mark.parametrize("delay", [-0.0008, 0.0003, 0.0137])
def test_a_delay_is_exact_where_the_chord_is_as_long(delay):
    t = np.arange(0.0, 4.0, 1e-3)
    still = np.zeros((len(t), 1))
    torque = np.sin(2.0 * np.pi * 8.0 * t)[:, None]
    effect = LateTorque()
    theta = effect.consistent_theta(np.array([delay]), (1e-3,))
    signals = Signals(t, still, still, still, still, torque, still)
    late = torque[:, 0] + delay * effect.columns(signals, 1, theta)[:, 0, 0]
    inner = slice(50, -50)
    assert late[inner] == pytest.approx(np.sin(2.0 * np.pi * 8.0 * (t - delay))[inner], abs=1e-5)


def test_one_filter_delays_every_joint():
    _, regression = of_a_moved_arm()
    signals = regression.signals
    column = find("torque_filter", "tau").columns(signals, 0, (0.01,))[:, :, 0]
    steps = round(0.01 / signals.dt)
    late = signals.torque[100 - steps : -100 - steps] - signals.torque[100:-100]
    np.testing.assert_allclose(0.01 * column[100:-100], late, atol=1e-9)


def test_a_late_device_sees_where_the_arm_was():
    signals, h = swinging_arm(2000), 2e-3
    column = named("dead_time", "tcp").columns(signals, 0, ())[:, :, 0]
    before, after = (tcp(ROBOT.pinocchio, np.column_stack([np.interp(signals.t - s * h, signals.t, c)
                                                       for c in signals.q.T])) for s in (-1.0, 1.0))
    np.testing.assert_allclose(column[10:-10], ((after - before) / (2 * h))[10:-10], atol=2e-4)


@pytest.mark.parametrize(("name", "prefix", "early"), [("torque_filter", "tau", -1.0), ("dead_time", "tau", -1.0),
                                                       ("dead_time", "q", 1.0)])
def test_torques_that_are_held_over_a_cycle_are_not_early(name, prefix, early):
    """Half a cycle of a loop of a kilohertz is in every drive: a torque acts from its stamp on until the next."""
    _, regression = of_a_moved_arm()
    effect = find(name, prefix)
    for delay, right in ((early * 2e-4, False), (early * 2e-3, True), (-early * 2e-4, True)):
        assert effect.plausible(np.array([delay]), (), regression.signals, 1) == right
