"""The diagnosis on recordings whose truth is known, on real ones, and on such that say too little."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.channels.motor_torque import torque_regression, with_reversal_width
from ideal_robot.diagnosis.statistics.dependence import reversal_widths
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.result import Diagnosis
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.diagnosis.page import summary, unexplained, unused
from studies.strangers.arm import robot_of
from studies.strangers.integrator import simulate
from studies.strangers.logger import Logger, record
from studies.strangers.plant import Plant, Run
from studies.strangers.score import score
from studies.strangers.trial import Trial, draw_trial
from tests.arms import a_logger, a_motion, a_plant, an_arm, written
from tests.sources import DATA

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="measured data (../shared/data) are not beside the checkout")


@cache
def stranger(seed: int, kind: str) -> Trial:
    return draw_trial(seed, kind, size=(3.0, 10.0), seconds=(12.0, 15.0))


@pytest.mark.parametrize(("seed", "kind"), [(770002, "none"), pytest.param(770017, "inside", marks=pytest.mark.slow),
                                            pytest.param(770017, "outside", marks=pytest.mark.slow),
                                            pytest.param(770036, "two", marks=pytest.mark.slow)])
def test_recording_of_a_stranger(seed, kind):
    """Short ones in other physics than the library has; more in ``tests/studies``.

    All are of chains of two joints, which are drawn whether measured arms are there or not.
    """
    trial = stranger(seed, kind)
    with robot_of(trial.urdf) as robot:
        diagnosis = diagnose(trial.recording, robot)
    assert score(trial, diagnosis).right, (trial.causes, diagnosis.effects)
    for channel in diagnosis.channels:
        assert channel.rms_after <= 1.2 * channel.rms_before


def arm(tmp_path: Path) -> Robot:
    return Robot.load(written(
        tmp_path, '<robot name="one"><link name="a"/><link name="b"><inertial><origin xyz="0.3 0 0"/><mass value="5"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="5"/></joint></robot>'))


def torque(t: np.ndarray, q: np.ndarray, rounded: float = 2e-3) -> np.ndarray:
    """Torques of that arm with rotor, viscous friction, and dry friction rounded at a speed [rad/s]."""
    qd = np.gradient(q, t, axis=0)
    return np.asarray(0.6 * np.gradient(qd, t, axis=0) - 14.7 * np.cos(q) + 2.0 * np.tanh(qd / rounded) + 1.5 * qd)


def strokes() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, positions, velocities and noisy torques of that arm."""
    t = np.arange(0.0, 40.0, 0.004)
    q = 0.6 * np.sin(0.7 * t)[:, None] + 0.3 * np.sin(1.9 * t)[:, None]
    return t, q, np.gradient(q, t, axis=0), torque(t, q) + 0.03 * np.random.default_rng(3).normal(size=q.shape)


def meandering(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Angles ``(N,)`` over about two radians, of three harmonics of 10 s."""
    order = np.arange(1.0, 4.0)
    size, phase = rng.uniform(0.5, 0.9, 3) / order, rng.uniform(0.0, 6.0, 3)
    return np.asarray(np.sin(np.outer(t, 0.2 * np.pi * order) + phase) @ size)


def test_too_little_motion_is_said_instead_of_a_verdict(tmp_path):
    t = np.arange(0.0, 20.0, 0.004)
    rng = np.random.default_rng(0)
    still = Recording.from_arrays(t, q=0.3 + 1e-6 * rng.normal(size=(len(t), 1)),
                                  tau=rng.normal(size=(len(t), 1)) + 4.0)
    diagnosis = diagnose(still, arm(tmp_path))
    assert diagnosis.verdict == "undecided"
    assert 1 in diagnosis.undecided
    assert diagnosis.to_dict()["undecided"][0]["joint"] == 1


def test_where_no_sample_is_left_between_reversals_nothing_is_decided(tmp_path):
    t = np.arange(0.0, 10.0, 0.01)
    q = 0.1 * np.sin(26.0 * t)[:, None]
    diagnosis = diagnose(Recording.from_arrays(t, q=q, tau=4.0 * np.cos(26.0 * t)[:, None]), arm(tmp_path))
    assert diagnosis.verdict == "undecided"
    assert "no sample" in diagnosis.undecided[1]


@pytest.mark.parametrize("spoil", ["missing", "joints", "degrees", "backwards"])
def test_wrong_input_is_refused_with_the_field(spoil, tmp_path):
    t = np.arange(0.0, 10.0, 0.004)
    q = np.sin(t)[:, None]
    columns = {"q": q, "tau": 3.0 * np.cos(t)[:, None]}
    if spoil == "missing":
        del columns["tau"]
    if spoil == "joints":
        columns = {key: np.tile(values, (1, 2)) for key, values in columns.items()}
    if spoil == "degrees":
        columns["q"] = np.degrees(q)
    if spoil == "backwards":
        t = t[::-1].copy()
    with pytest.raises(InputError) as error:
        diagnose(Recording.from_arrays(t, **columns), arm(tmp_path))
    assert error.value.field


def rippled(arm_: Robot, phase: float, seed: int) -> Recording:
    """One joint with gravity, friction, and a ripple of 0.4 N m whose phase depends on where the encoder started."""
    t, rng = np.arange(0.0, 30.0, 0.004), np.random.default_rng(seed)
    q = meandering(rng, t)
    tau = torque(t, q) + 0.4 * np.cos(40.0 * q + phase) + 0.03 * rng.normal(size=len(t))
    return Recording.from_arrays(t, q=q[:, None], tau=tau[:, None])


def test_the_extended_model_predicts_what_was_found(tmp_path):
    robot = arm(tmp_path)
    diagnosis, other = diagnose(rippled(robot, 0.0, 1), robot), rippled(robot, 0.0, 2)
    again = Model.load(diagnosis.model.save(tmp_path / "model.json"))
    assert [e.name for e in again.effects] == [e.fitted.name for e in (*diagnosis.effects, *diagnosis.unknown)]
    # What it leaves stands in it, for who diagnoses against it.
    assert again.noise_std == pytest.approx([channel.rms_after for channel in diagnosis.channels], rel=0.1)
    bare = dataclasses.replace(again, effects=())
    with_effect, without = (m.predict(other).relative_error_percent[0] for m in (again, bare))
    assert with_effect < 0.5 * without


@pytest.mark.parametrize(("phase", "transfers"), [(0.0, True), (2.5, False)])
def test_an_effect_is_added_only_if_it_transfers_to_the_other_recording(phase, transfers, tmp_path):
    robot = arm(tmp_path)
    diagnosis = diagnose(rippled(robot, 0.0, 1), robot, validate=rippled(robot, phase, 2))
    assert ("torque_ripple" in [e.fitted.name for e in diagnosis.effects]) is transfers
    assert any("torque_ripple" in warning for warning in diagnosis.warnings) is not transfers
    if transfers:
        assert diagnosis.channels[0].rms_after < 0.3 * diagnosis.channels[0].rms_before
    else:
        # Without it the model is no worse than before.
        assert diagnosis.channels[0].rms_after < 1.02 * diagnosis.channels[0].rms_before


def test_drift_of_one_recording_is_none_of_another(tmp_path):
    robot = arm(tmp_path)
    t, q, _, tau = strokes()
    drifting = Recording.from_arrays(t, q=q, tau=tau + 2.0 * np.sin(2.0 * np.pi * t / t[-1])[:, None])
    alone = diagnose(drifting, robot)
    assert [u.depends_on for u in alone.unknown] == [("t",)]
    diagnosis = diagnose(drifting, robot, validate=Recording.from_arrays(t, q=q, tau=tau))
    assert diagnosis.channels[0].rms_after < 1.02 * diagnosis.channels[0].rms_before


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize(("folder", "one", "other"), [
    ("panda", "panda_a", "panda_b"), ("panda", "panda_b", "panda_a"), ("tiago", "tiago_a", "tiago_b"),
    ("tiago", "tiago_b", "tiago_a")])
def test_no_channel_of_another_recording_is_predicted_worse(folder, one, other):
    robot = Robot.load(DATA / folder / f"{folder}.urdf")
    diagnosis = diagnose(Recording.read(DATA / folder / f"{one}.parquet"), robot,
                         validate=Recording.read(DATA / folder / f"{other}.parquet"))
    assert all(c.rms_after <= 1.01 * c.rms_before for c in diagnosis.channels)


@needs_data
def test_emps_asymmetry_is_found_without_being_told():
    robot = Robot.load(DATA / "emps" / "emps.urdf")
    diagnosis = diagnose(Recording.read(DATA / "emps" / "emps_estimation.parquet"), robot,
                         validate=Recording.read(DATA / "emps" / "emps_validation.parquet"))
    names = [e.fitted.name for e in diagnosis.effects]
    assert names == ["asymmetric_friction"]
    channel = diagnosis.channels[0]
    # In the band that is looked at, apart from reversals; the published 5.95 % are of all frequencies and samples.
    before, after = (100.0 * value / channel.rms_signal for value in (channel.rms_before, channel.rms_after))
    assert before > 3.5
    assert after <= 3.2


@needs_data
@pytest.mark.slow
def test_ur10e_load_dependent_friction_is_found():
    robot = Robot.load(DATA / "ur10e" / "ur10e.urdf")
    diagnosis = diagnose(Recording.read(DATA / "ur10e" / "free_12harm_50s.parquet"), robot,
                         validate=Recording.read(DATA / "ur10e" / "free_8harm_20s.parquet"))
    # By its size or by who drives whom: on this recording the one explains as much as the other, which is said.
    causes = {e.fitted.joint: {e.fitted.name, *e.indistinguishable_from} for e in diagnosis.effects}
    assert "load_dependent_friction" in causes[2]
    assert "load_dependent_friction" in causes[3]
    # What does not transfer by luck of the halves may cost a few percent, never more.
    assert all(c.rms_after < 1.1 * c.rms_before for c in diagnosis.channels)


def test_what_nothing_explains_is_not_called_nothing(tmp_path):
    robot, rng, (t, q, _, tau) = arm(tmp_path), np.random.default_rng(3), strokes()
    diagnosis = diagnose(Recording.from_arrays(t, q=q, tau=tau), robot)
    assert diagnosis.verdict == "none"
    assert not diagnosis.unexplained
    # Kicks that no column tells of, at random times, in random directions.
    for start in rng.integers(0, len(t) - 5, 150):
        tau[start : start + 5] += 4.0 * rng.normal()
    diagnosis = diagnose(Recording.from_arrays(t, q=q, tau=tau), robot)
    assert not diagnosis.effects
    assert [c.channel for c in diagnosis.unexplained] == ["tau_1"]
    assert "Nothing is missing" not in summary(diagnosis)
    assert "tau_1" in unexplained(diagnosis)


@pytest.mark.parametrize("width", [0.004, pytest.param(0.006, marks=pytest.mark.slow)])
def test_how_sharply_friction_changes_sign_is_found_and_is_no_effect(width, tmp_path):
    robot, (t, q, qd, _) = arm(tmp_path), strokes()
    speed = width * np.percentile(np.abs(qd), 99)
    tau = torque(t, q, speed) + 0.01 * np.random.default_rng(5).normal(size=q.shape)
    recording = Recording.from_arrays(t, q=q, tau=tau)
    nominal = Model.nominal(robot)
    raw = torque_regression(recording, robot, nominal)
    reversal_width = reversal_widths(Problem(raw), nominal)
    assert reversal_width[0] == pytest.approx(speed, rel=0.15)
    # About a model that has friction, the residual holds the same change of sign as the columns.
    law = type(nominal.friction.laws[0])(np.array([[1.5], [2.0]]))
    rubbing = dataclasses.replace(nominal, friction=PerJointFriction([law]))
    sharpened = with_reversal_width(raw, rubbing, reversal_width)
    beta = np.zeros(sharpened.W.shape[2])
    beta[nominal.base.count : nominal.base.count + 2] = 1.5, 2.0
    bare = with_reversal_width(raw, nominal, reversal_width)
    assert sharpened.y == pytest.approx(bare.y - bare.W @ beta, abs=1e-9)
    assert diagnose(recording, robot).verdict == "none"


def test_acceleration_is_not_lost_as_in_a_soft_gear(tmp_path):
    t, w = np.arange(0.0, 40.0, 0.01), 2.0 * np.pi * 3.0
    q = 0.4 * np.sin(w * t)[:, None] + 0.3 * np.sin(0.2 * w * t)[:, None]
    raw = torque_regression(Recording.from_arrays(t, q=q, tau=np.zeros_like(q)), arm(tmp_path),
                     Model.nominal(arm(tmp_path)), cutoff=15.0)
    exact = -0.4 * w**2 * np.sin(w * t) - 0.3 * (0.2 * w) ** 2 * np.sin(0.2 * w * t)
    # Central differences would lose (w dt)^2 / 3 = 1.2 % of the fast part.
    assert raw.signals.qdd[100:-100, 0] == pytest.approx(exact[100:-100], abs=1e-3 * np.abs(exact).max())


@pytest.mark.parametrize(("name", "says"), [("one", "1 joints"), ("kr15", "sits elsewhere")])
def test_a_model_of_another_arm_is_refused(name, says, tmp_path):
    single, kr6 = arm(tmp_path), Robot.load("kr6")
    other = Model.nominal(single if name == "one" else Robot.load(name))
    t = np.arange(0.0, 10.0, 0.004)
    q = np.sin(np.outer(t, np.ones(6)))
    with pytest.raises(InputError, match=says) as error:
        diagnose(Recording.from_arrays(t, q=q, tau=q), kr6, model=other)
    assert error.value.field == "model"


# Channels of some joints or axes only, in physics that is not the model's: used as far as they go, the rest said.

def moved_arm(folder: Path, n: int) -> tuple[Robot, Plant, Run, Logger]:
    """An arm under its cascade, as an independent integrator moves it, and what of it can be recorded."""
    arm = an_arm(seed=11, n=n)
    plant = a_plant(arm)
    run = simulate(plant, a_motion(arm, seconds=12.0))
    logger = a_logger(np.random.default_rng(2), n, qa=(0, 1, 2), encoder=2e-6, noise=0.005 * np.std(run.tau, axis=0))
    return Robot.load(written(folder, arm.urdf)), plant, run, logger


@pytest.fixture(scope="module")
def arm_and_run(tmp_path_factory):
    return moved_arm(tmp_path_factory.mktemp("arm"), 6)


def names(found: Diagnosis) -> list[tuple[str, int, str]]:
    return [(e.fitted.name, e.fitted.joint, e.fitted.channel) for e in (*found.effects, *found.unknown)]


@pytest.mark.parametrize("n", [3, pytest.param(6, marks=pytest.mark.slow)])
def test_late_encoders_on_the_arms_side_of_three_joints_are_one_delay_and_no_gear(n, tmp_path):
    robot, plant, run, logger = moved_arm(tmp_path, n)
    diagnosis = diagnose(record(dataclasses.replace(logger, qa_delay=0.003), plant, run), robot)
    (late,) = [e for e in diagnosis.effects if e.fitted.channel.startswith("qa")]
    assert (late.fitted.name, late.fitted.joint) == ("dead_time", 0)
    assert late.fitted.coefficients[0] == pytest.approx(0.003, rel=0.02)
    assert not [name for name in names(diagnosis) if name[0] in ("joint_elasticity", "backlash")]
    assert [c.channel for c in diagnosis.channels if c.channel.startswith("qa")] == ["qa_1", "qa_2", "qa_3"]


@pytest.mark.slow
def test_a_delay_of_one_encoder_stays_that_of_its_joint(arm_and_run):
    robot, plant, run, logger = arm_and_run
    good = record(logger, plant, run)
    late = np.interp(good.t - 0.003, good.t, good.columns["qa_2"])
    diagnosis = diagnose(Recording({**good.columns, "qa_2": late}), robot)
    assert [name for name in names(diagnosis) if name[2].startswith("qa")] == [("dead_time", 2, "qa_2")]


def test_a_dead_torque_channel_is_named_and_its_joint_left_out(arm_and_run):
    robot, plant, run, logger = arm_and_run
    good = record(dataclasses.replace(logger, qa=()), plant, run)
    dead = np.where(np.random.default_rng(1).random(len(good.t)) < 0.8, 0.0, good.columns["tau_5"])
    diagnosis = diagnose(Recording({**good.columns, "tau_5": dead}), robot)
    assert "dead torque channel" in diagnosis.undecided[5]
    assert any(text.startswith("dead-channel: tau_5") for text in diagnosis.warnings)
    assert not [name for name in names(diagnosis) if name[1] == 5]
    counted = {c.channel: c.counted for c in diagnosis.channels}
    assert counted["tau_5"] == 0.0
    assert 0.5 < counted["tau_1"] < 1.0
    percent = {c["channel"]: c["samples_counted_percent"] for c in diagnosis.to_dict()["channels"]}
    assert percent["tau_1"] == pytest.approx(100.0 * counted["tau_1"])


@pytest.mark.slow
def test_clipped_torques_cost_samples_and_name_nothing(arm_and_run):
    robot, plant, run, logger = arm_and_run
    good = record(dataclasses.replace(logger, qa=()), plant, run)
    tau = good.columns["tau_2"]
    clipped = Recording({**good.columns, "tau_2": np.clip(tau, *np.quantile(tau, [0.02, 0.98]))})
    healthy, diagnosis = diagnose(good, robot), diagnose(clipped, robot)
    assert names(diagnosis) == names(healthy)
    assert any(text.startswith("clipped-channel: tau_2") for text in diagnosis.warnings)
    assert diagnosis.channels[1].counted < healthy.channels[1].counted - 0.03


def test_temperatures_of_some_joints_are_used_and_what_is_not_is_said(arm_and_run):
    robot, plant, run, logger = arm_and_run
    good = record(logger, plant, run)
    rise = 30.0 + 5.0 * (1.0 - np.exp(-good.t / 15.0))
    gaps = np.where(good.t > 5.0, np.nan, rise)
    mixed = Recording({**good.columns, "temp_2": rise, "temp_3": gaps, "qx": rise, "switch": np.ones(len(good.t))})
    signals = torque_regression(mixed, robot, Model.nominal(robot)).signals
    assert np.ptp(signals.temperature[:, 1]) > 2.0
    assert np.ptp(signals.temperature[:, [0, 2, 3, 4, 5]]) == 0.0
    diagnosis = diagnose(mixed, robot, only=())
    assert diagnosis.unused == {"temp_3": "it holds gaps", "qx": "the tool's orientation is not looked at",
                                "switch": "it never changes"}
    assert {"columns": "temp_3", "reason": "it holds gaps"} in diagnosis.to_dict()["unused"]
    assert "temp_3 (it holds gaps)" in unused(diagnosis)
