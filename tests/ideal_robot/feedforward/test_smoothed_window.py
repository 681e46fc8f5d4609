"""Motion and torque smoothed alike: they keep to each other whatever the frequency."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.feedforward.smoothed_window import CYCLES, SmoothedWindow
from tests.ideal_robot.feedforward.plant import T, plant

AT = T * (np.arange(CYCLES) - CYCLES // 2)[:, None]


@pytest.mark.parametrize("frequency", [1.0, 4.0, 8.0])
def test_inertia_is_the_same_at_every_frequency(frequency):
    """The second derivative of a cubic through nine positions lacks a tenth at 4 Hz."""
    loop, omega = plant(elastic=False), 2.0 * np.pi * frequency
    q = 0.01 * np.cos(omega * AT) * np.ones(loop.n)
    tau = -loop.rotor_inertia * omega**2 * q
    seen = SmoothedWindow(loop).of(q, tau, np.zeros_like(q))
    np.testing.assert_allclose(seen.tau, loop.rotor_inertia * seen.motor_a, rtol=0.01)
    np.testing.assert_allclose(seen.a, seen.motor_a)


def test_the_arm_lags_behind_its_gears():
    """Arm and motor swing at 2.5 Hz, with 30 kg m² behind each gear."""
    loop, omega, inertia = plant(), 2.0 * np.pi * 2.5, 30.0
    arm = 0.01 * np.cos(omega * AT) * np.ones(loop.n)
    motor = arm * (1.0 - inertia * omega**2 / loop.stiffness)
    tau = -inertia * omega**2 * arm - loop.rotor_inertia * omega**2 * motor
    seen = SmoothedWindow(loop).of(motor, tau, np.zeros_like(arm))
    rigid = SmoothedWindow(plant(elastic=False)).of(arm, tau, np.zeros_like(arm))
    np.testing.assert_allclose(seen.a, rigid.a, rtol=2e-3)


def test_friction_turns_over_the_bend_and_jumps_without():
    loop = plant()
    window, z = SmoothedWindow(loop), np.ones(loop.n)
    np.testing.assert_allclose(window.turned(z, np.zeros(loop.n)), z)
    np.testing.assert_allclose(window.turned(z, -loop.friction_bend), 2.0 * np.exp(-1.0) - 1.0)
    sudden = SmoothedWindow(loop.replace(friction_bend=np.zeros(loop.n)))
    np.testing.assert_allclose(sudden.turned(z, np.full(loop.n, -1e-9)), -1.0)
    np.testing.assert_allclose(sudden.turned(z, np.zeros(loop.n)), 1.0)
