"""Channels of some joints or axes only, in physics that is not the model's: used as far as they go, the rest said."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.validation.result import Diagnosis
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.diagnosis.page import unused
from tests.trials.strangers.plants import a_motion, a_plant, an_arm
from trials.strangers.integrator import simulate
from trials.strangers.logger import draw_logger, record


@pytest.fixture(scope="module")
def arm_and_run(tmp_path_factory):
    """A six-joint arm under its cascade, as an independent integrator moves it, and what of it can be recorded."""
    arm = an_arm(seed=11, n=6)
    plant = a_plant(arm)
    run = simulate(plant, a_motion(arm, seconds=24.0))
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(arm.urdf, encoding="utf-8")
    logger = dataclasses.replace(
        draw_logger(np.random.default_rng(2), 6, qa=(0, 1, 2)), every=8, torque="sampled", encoder=2e-6, jitter=0.0,
        dropped=0.0, spikes=0.0, temp=(), xy=False, noise=0.005 * np.std(run.tau, axis=0))
    return Robot.load(path), plant, run, logger


def names(found: Diagnosis) -> list[tuple[str, int, str]]:
    return [(e.fitted.name, e.fitted.joint, e.fitted.channel) for e in (*found.effects, *found.unknown)]


def test_late_encoders_on_the_arms_side_of_three_joints_are_one_delay_and_no_gear(arm_and_run):
    robot, plant, run, logger = arm_and_run
    found = diagnose(record(dataclasses.replace(logger, qa_delay=0.003), plant, run), robot)
    (late,) = [e for e in found.effects if e.fitted.channel.startswith("qa")]
    assert (late.fitted.name, late.fitted.joint) == ("dead_time", 0)
    assert late.fitted.coefficients[0] == pytest.approx(0.003, rel=0.02)
    assert not [name for name in names(found) if name[0] in ("joint_elasticity", "backlash")]
    assert [c.channel for c in found.channels if c.channel.startswith("qa")] == ["qa_1", "qa_2", "qa_3"]


def test_a_delay_of_one_encoder_stays_that_of_its_joint(arm_and_run):
    robot, plant, run, logger = arm_and_run
    good = record(logger, plant, run)
    late = np.interp(good.t - 0.003, good.t, good.columns["qa_2"])
    found = diagnose(Recording({**good.columns, "qa_2": late}), robot)
    assert [name for name in names(found) if name[2].startswith("qa")] == [("dead_time", 2, "qa_2")]


def test_a_dead_torque_channel_is_named_and_its_joint_left_out(arm_and_run):
    robot, plant, run, logger = arm_and_run
    good = record(dataclasses.replace(logger, qa=()), plant, run)
    dead = np.where(np.random.default_rng(1).random(len(good.t)) < 0.8, 0.0, good.columns["tau_5"])
    found = diagnose(Recording({**good.columns, "tau_5": dead}), robot)
    assert "dead torque channel" in found.undecided[5]
    assert any(text.startswith("dead-channel: tau_5") for text in found.warnings)
    assert not [name for name in names(found) if name[1] == 5]
    counted = {c.channel: c.counted for c in found.channels}
    assert counted["tau_5"] == 0.0
    assert 0.5 < counted["tau_1"] < 1.0
    said = {c["channel"]: c["samples_counted_percent"] for c in found.to_dict()["channels"]}
    assert said["tau_1"] == pytest.approx(100.0 * counted["tau_1"])


def test_clipped_torques_cost_samples_and_name_nothing(arm_and_run):
    robot, plant, run, logger = arm_and_run
    good = record(dataclasses.replace(logger, qa=()), plant, run)
    tau = good.columns["tau_2"]
    clipped = Recording({**good.columns, "tau_2": np.clip(tau, *np.quantile(tau, [0.02, 0.98]))})
    healthy, found = diagnose(good, robot), diagnose(clipped, robot)
    assert names(found) == names(healthy)
    assert any(text.startswith("clipped-channel: tau_2") for text in found.warnings)
    assert found.channels[1].counted < healthy.channels[1].counted - 0.03


def test_temperatures_of_some_joints_are_used_and_what_is_not_is_said(arm_and_run):
    robot, plant, run, logger = arm_and_run
    good = record(logger, plant, run)
    rise = 30.0 + 5.0 * (1.0 - np.exp(-good.t / 30.0))
    gaps = np.where(good.t > 5.0, np.nan, rise)
    mixed = Recording({**good.columns, "temp_2": rise, "temp_3": gaps, "qx": rise, "switch": np.ones(len(good.t))})
    signals = torque_regression(mixed, robot, Model.nominal(robot)).signals
    assert np.ptp(signals.temperature[:, 1]) > 2.0
    assert np.ptp(signals.temperature[:, [0, 2, 3, 4, 5]]) == 0.0
    found = diagnose(mixed, robot, only=())
    assert found.unused == {"temp_3": "it holds gaps", "qx": "the tool's orientation is not looked at",
                            "switch": "it never changes"}
    assert {"columns": "temp_3", "reason": "it holds gaps"} in found.to_dict()["unused"]
    assert "temp_3 (it holds gaps)" in unused(found)
