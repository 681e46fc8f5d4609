"""Ripple of the motors found in slow motion, and carried by the ideal robot."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.identification.ripple_fit import fit_ripple
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.feedforward.plant import commands, motion, plant, rms
from tests.ideal_robot.feedforward.test_laws import nominal_model

ROBOT = Robot.load("kr15")


def recording(model: Model, amplitude: float, seed: int = 0) -> Recording:
    """Slow motion whose torque is the model's, a ripple of joint 1, and noise of 13 N m."""
    rng = np.random.default_rng(seed)
    t = 0.002 * np.arange(6000)
    q = ROBOT.home + 0.05 * np.sin(np.outer(t, 2 * np.pi * np.array([0.2, 0.25, 0.3, 0.35, 0.4, 0.45])))
    qd = np.gradient(q, 0.002, axis=0)
    tau = model.inverse_dynamics(q, qd, np.gradient(qd, 0.002, axis=0), t=t)
    tau[:, 0] += amplitude * np.cos(2 * ROBOT.gear_ratio[0] * q[:, 0] - 0.5)
    return Recording.from_arrays(t, q=q + rng.normal(scale=1e-6, size=q.shape),
                                 tau=tau + rng.normal(scale=13.0, size=q.shape))


def test_finds_amplitude_and_order_and_nothing_else():
    model = Model.nominal(ROBOT)
    found = fit_ripple([recording(model, 10.0)], model, ROBOT)
    assert [(effect.joint, effect.theta) for effect in found] == [(1, (2 * ROBOT.gear_ratio[0],))]
    assert found[0].parameters[0].value == pytest.approx(10.0, rel=0.1)
    again = fit_ripple([recording(model, 10.0, seed=1)], model.with_effects(found), ROBOT)
    assert again == ()


def test_finds_nothing_where_there_is_nothing():
    model = Model.nominal(ROBOT)
    assert fit_ripple([recording(model, 0.0)], model, ROBOT) == ()


def test_the_ideal_robot_carries_it():
    model = nominal_model()
    effects = fit_ripple([recording(Model.nominal(ROBOT), 10.0)], Model.nominal(ROBOT), ROBOT)
    ripple = loop_model(dataclasses.replace(model, effects=effects), ROBOT).ripple
    # Slow enough that the arm can answer: 0.3 rad/s make 12 Hz of two periods per motor turn.
    q_d = motion(amplitude=0.05)
    arm = plant().replace(ripple=ripple)
    error = {known: rms(simulate(arm, commands(IdealRobot(loop), q_d)).q_a[40:-1, 0] - q_d[40:, 0])
             for known, loop in ((True, arm), (False, plant()))}
    assert error[True] < 0.6 * error[False]
