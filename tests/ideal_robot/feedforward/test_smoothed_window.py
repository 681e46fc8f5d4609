"""Motion and torque smoothed alike: they keep to each other whatever the frequency."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.feedforward.smoothed_window import CYCLES, Drive, Smoothed, noted, smoothed, turned
from tests.ideal_robot.feedforward.plant import T, plant


def seen(loop, q, tau, z=None):
    """Motion and torque in the middle of measurements ``(CYCLES, n)``; friction turned as they say, or as ``z``."""
    window, drive = np.zeros((3, CYCLES, loop.n)), Drive.of(loop, T)
    measured = np.stack([q, tau, np.zeros_like(q)], axis=1)
    assert noted(window, 0, measured, drive) == CYCLES
    if z is not None:
        window[2] = z
    return Smoothed(*(one[0] for one in smoothed(window, drive)))


AT = T * (np.arange(CYCLES) - CYCLES // 2)[:, None]


@pytest.mark.parametrize("frequency", [1.0, 4.0, 8.0])
def test_inertia_is_the_same_at_every_frequency(frequency):
    """The second derivative of a cubic through nine positions lacks a tenth at 4 Hz."""
    loop, omega = plant(elastic=False), 2.0 * np.pi * frequency
    q = 0.01 * np.cos(omega * AT) * np.ones(loop.n)
    tau = -loop.rotor_inertia * omega**2 * q
    found = seen(loop, q, tau)
    np.testing.assert_allclose(found.tau, loop.rotor_inertia * found.motor_a, rtol=0.01)
    np.testing.assert_allclose(found.a, found.motor_a)


def test_the_arm_lags_behind_its_gears():
    """Arm and motor swing at 2.5 Hz, with 30 kg m² behind each gear."""
    loop, omega, inertia = plant(), 2.0 * np.pi * 2.5, 30.0
    arm = 0.01 * np.cos(omega * AT) * np.ones(loop.n)
    motor = arm * (1.0 - inertia * omega**2 / loop.stiffness)
    tau = -inertia * omega**2 * arm - loop.rotor_inertia * omega**2 * motor
    lagging, rigid = seen(loop, motor, tau, 0.0), seen(plant(elastic=False), arm, tau, 0.0)
    np.testing.assert_allclose(lagging.a, rigid.a, rtol=2e-3)


def test_friction_turns_over_the_bend_and_jumps_without():
    assert turned(1.0, 0.0, 3e-4) == 1.0
    np.testing.assert_allclose(turned(1.0, -3e-4, 3e-4), 2.0 * np.exp(-1.0) - 1.0)
    assert turned(1.0, -1e-9, 0.0) == -1.0
    assert turned(1.0, 0.0, 0.0) == 1.0


def test_ripple_is_taken_out_behind_the_gain():
    """It acts on the motor: where more torque is read than acts, of the ripple too."""
    ripple = np.zeros((1, 3, 6))
    ripple[0, :, 1] = 20.0, 3.0, 4.0
    gain = np.full(6, 1.2)
    loop = plant(elastic=False).replace(ripple=ripple, gain=gain)
    q = 0.3 + 0.1 * AT * np.ones(loop.n)
    waves = np.zeros_like(q)
    waves[:, 1] = 3.0 * np.cos(20.0 * q[:, 1]) + 4.0 * np.sin(20.0 * q[:, 1])
    np.testing.assert_allclose(seen(loop, q, gain * (5.0 + waves)).tau, 5.0)


def test_a_hole_starts_the_window_anew():
    loop = plant()
    measured = np.zeros((CYCLES + 2, 3, loop.n))
    measured[3, 1, 2] = np.nan
    assert noted(np.zeros((3, CYCLES, loop.n)), 0, measured, Drive.of(loop, T)) == CYCLES - 2
