"""The cascade found from commands, motor angles and torques of a simulated arm."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.identification.closed_loop_fit import fit_controller
from ideal_robot.loop.from_model import cascade_gains
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from sim.arm.arm import SimulatedArm
from sim.arm.world import World

ROBOT = Robot.load("kr15")


def recorded(joint: int, seconds: float = 9.0) -> Recording:
    """One joint of the default world's arm through slow and quick sinusoids; the columns of that joint only."""
    world = World.default("kr15")
    t = world.t_ipo * np.arange(round(seconds / world.t_ipo))
    fade = np.clip(np.minimum(t, seconds - t), 0, 1) ** 2
    wave = 0.25 * np.sin(1.5 * t) + 0.08 * np.sin(4.1 * t + 1) + 0.02 * np.sin(12 * t + 2)
    with SimulatedArm(ROBOT, world, np.random.default_rng(4)) as arm:
        for k in range(len(t)):
            q_c = ROBOT.home.copy()
            q_c[joint] += fade[k] * wave[k]
            arm.cycle(q_c)
        whole = arm.recording()
    columns = {"t": whole.t.copy()}
    for prefix in ("q_c", "q", "tau"):
        columns[f"{prefix}_1"] = whole.columns[f"{prefix}_{joint + 1}"].copy()
    return Recording(columns, whole.meta)


@pytest.mark.parametrize("joint", [1, 3])
def test_finds_the_cascade_behind_encoder_steps_and_current_noise(joint):
    world = World.default("kr15")
    fit = fit_controller(recorded(joint), ROBOT)
    true = {name: world.per_joint(name, 6)[joint]
            for name in ("position_gain", "velocity_feedforward", "velocity_gain", "integral_time")}
    k_v, k_ff, k_p, k_i = (float(values[0]) for values in cascade_gains(fit.controller))
    # Gains trade against each other (a quicker integrator for a softer position loop); the commands that follow from
    # them do not: what is left of the torque is the noise of the current below 12 Hz.
    assert fit.error_percent[0] < 5.0
    assert k_p == pytest.approx(true["velocity_gain"], rel=0.1)
    assert k_v == pytest.approx(true["position_gain"], rel=0.35)
    assert k_ff == pytest.approx(true["velocity_feedforward"], abs=0.04)
    assert k_p / k_i == pytest.approx(true["integral_time"], rel=0.4)
    # What the integrator makes of a position error decides slow motions, and is the best determined of all.
    assert k_i * k_v == pytest.approx(true["velocity_gain"] / true["integral_time"] * true["position_gain"], rel=0.1)


def test_refuses_slow_sampling_and_joints_at_rest():
    recording = recorded(3, 3.0)
    slow = Recording({name: values[::6].copy() for name, values in recording.columns.items()})
    with pytest.raises(InputError, match="samples every 2 ms"):
        fit_controller(slow, ROBOT)
    still = Recording({name: (values if name == "t" else np.zeros_like(values))
                       for name, values in recording.columns.items()})
    with pytest.raises(InputError, match="hardly moves"):
        fit_controller(still, ROBOT)
