"""What is claimed in the end: limits instead of numbers, no signs against physics, nothing that does not help."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy import signal

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.arm import frames_along
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.report import sides, with_limits
from ideal_robot.diagnosis.stages import moved_parameters
from ideal_robot.diagnosis.statistics.problem import with_parameters, with_possible_inertias
from ideal_robot.dynamics.consistent_inertias import pseudo_inertia
from ideal_robot.effects import FittedEffect
from ideal_robot.effects.registry import find
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.diagnosis.page import summary
from tests.ideal_robot.diagnosis.test_diagnose import arm, torque
from tests.sources import ROOT


def moved(seconds: float = 40.0, *, vibration: float = 0.0, stribeck: float = 0.0, kicks: float = 0.0,
          rounded: float = 2e-3) -> tuple[Recording, np.ndarray]:
    """One joint with gravity and friction, and what else there is; also its true torque."""
    rng, t = np.random.default_rng(3), np.arange(0.0, seconds, 0.004)
    q = 0.6 * np.sin(0.7 * t) + 0.3 * np.sin(1.9 * t) + 0.2 * np.sin(3.1 * t)
    qd = np.gradient(q, t)
    tau = torque(t, q, rounded) + vibration * np.sin(2 * np.pi * 110.0 * t)
    tau += stribeck * np.exp(-((qd / 0.3) ** 2)) * np.tanh(qd / 2e-3)
    for start in rng.integers(0, len(t) - 5, 150):
        tau[start : start + 5] += kicks * rng.normal()
    noisy = tau + 0.03 * rng.normal(size=len(t))
    return Recording.from_arrays(t, q=q[:, None], tau=noisy[:, None]), tau


@pytest.fixture
def one(tmp_path: Path) -> Robot:
    return arm(tmp_path)


def test_a_value_at_the_end_of_the_search_is_a_limit_without_a_deviation(one):
    regressed = torque_regression(moved()[0], one, Model.nominal(one))
    effect = find("presliding_hysteresis", "tau")
    least = max(effect.bounds(regressed.signals, 1)[0][0], min(s[0] for s in effect.starts(regressed.signals, 1)) / 3.0)
    for theta, limit in ((least, "≤"), (2.0 * least, "")):
        candidate = Candidate(effect, 1, (theta,))
        parameters = effect.parameters(np.array([1.0]), np.array([0.1]), (theta,), (1e-5,))
        fitted = FittedEffect(effect.name, 1, "tau_1", (1.0,), (0.1,), (theta,), (1e-5,), {}, tuple(parameters))
        level, sigma = with_limits(fitted, candidate, regressed.signals).parameters
        assert (level.limit, sigma.limit) == ("", limit)
        assert level.std == 0.1
        if limit:
            assert sigma.std == 0.0
            assert "±" not in sigma.text
            assert "≤" in sigma.text
            again = json.loads(json.dumps(sigma.to_dict()))
            assert again["std"] is None
            assert type(sigma).from_dict(again) == sigma


def test_both_ends_of_a_bound_and_what_lies_between(one):
    signals = torque_regression(moved()[0], one, Model.nominal(one)).signals
    effect = find("stribeck", "tau")
    low, high = effect.bounds(signals, 1)[0]
    reach = [theta[0] for theta in effect.starts(signals, 1)]
    low, high = max(low, min(reach) / 3.0), min(high, 3.0 * max(reach))
    assert [sides(Candidate(effect, 1, (v,)), signals)[0] for v in (low, np.sqrt(low * high), high)] == [-1, 0, 1]


def friction_less_near_standstill() -> Recording:
    return moved(stribeck=-0.8)[0]


def nothing_but_noise() -> Recording:
    return moved()[0]


def friction_rounded_near_standstill() -> Recording:
    return moved(rounded=0.03)[0]


def late_by_less_than_its_deviation() -> Recording:
    columns = moved()[0].columns
    return Recording({**columns, "tau_1": np.interp(columns["t"] - 3e-5, columns["t"], columns["tau_1"])})


@pytest.mark.parametrize(("recorded", "names"), [
    (friction_less_near_standstill, {"stribeck"}), (nothing_but_noise, {"cable_spring"}),
    (friction_rounded_near_standstill, {"degressive", "stribeck"}), (late_by_less_than_its_deviation, {"dead_time"})])
def test_what_is_not_there_is_not_named(one, recorded, names):
    # Friction that drives, a spring in noise, a law's form near standstill alone, a delay below its deviation.
    assert not names & {effect.fitted.name for effect in diagnose(recorded(), one).effects}


def test_a_recording_that_the_parameters_do_not_predict_judges_nothing(one):
    # Measured: in amperes two short motions of one arm, each of them many times the other's torque off.
    recording = moved(stribeck=0.8)[0]
    other = Recording({**recording.columns, "tau_1": -recording.columns["tau_1"]})
    judged = diagnose(recording, one, validate=recording, only=(("stribeck", 1),))
    diagnosis = diagnose(recording, one, validate=other, only=(("stribeck", 1),))
    assert not any("validation-not-predicted" in text for text in judged.warnings)
    assert any("validation-not-predicted" in text and "tau_1" in text for text in diagnosis.warnings)
    assert diagnosis.held_out_how.startswith("each block")
    assert diagnosis.channels[0].rms_after < 0.2 * diagnosis.channels[0].rms_signal
    assert [e.fitted.name for e in diagnosis.effects] == ["stribeck"]


def test_inertia_that_a_rotor_has_bends_no_gear(one):
    # Torques tell 0.6 kg m² in all, of which the link has a third.
    columns = moved()[0].columns
    t, q = columns["t"], columns["q_1"]
    load = 0.2 * np.gradient(np.gradient(q, t), t) - 14.7 * np.cos(q)
    qa = q - load / 5e3 + 1e-5 * np.random.default_rng(5).normal(size=len(t))
    diagnosis = diagnose(Recording({**columns, "qa_1": qa}), one)
    behind = [e.fitted for e in diagnosis.effects if e.fitted.channel == "qa_1"]
    assert [e.name for e in behind] == ["joint_elasticity"]
    assert not diagnosis.unknown
    assert behind[0].parameters[0].value == pytest.approx(5e3, rel=0.01)


def test_the_noise_floor_is_that_of_the_band_and_never_above_the_residual(one):
    # A vibration far above the band makes the torque's own spectrum a bad witness of the noise within.
    quiet, shaken = (diagnose(moved(vibration=size)[0], one, only=()).channels[0] for size in (0.0, 3.0))
    assert quiet.noise_floor == pytest.approx(0.03 * np.sqrt(12.5 / 125.0), rel=0.2)
    assert shaken.noise_floor <= shaken.rms_after
    assert shaken.noise_floor < 3.0 * quiet.noise_floor


def test_none_is_said_only_where_nothing_is_left_that_matters(one):
    clean, kicked = (diagnose(moved(kicks=size)[0], one) for size in (0.0, 4.0))
    assert (clean.verdict, clean.unexplained) == ("none", ())
    assert kicked.verdict == "unknown"
    assert kicked.to_dict()["unexplained"] == ["tau_1"]
    assert "Nothing is missing" not in summary(kicked)


def test_what_is_never_still_is_nothing_that_a_cause_is_missing_for(one):
    # Encoder steps and jitter that the controller hands on up to its bandwidth: no noise is left above the band.
    recording, tau = moved()
    low = signal.butter(4, 12.0, fs=250.0, output="sos")
    shaken = signal.sosfiltfilt(low, np.random.default_rng(5).normal(size=len(tau)))
    shaken *= 0.15 * np.std(tau) / np.std(shaken)
    diagnosis = diagnose(Recording({**recording.columns, "tau_1": tau + shaken}), one)
    (channel,) = diagnosis.channels
    assert channel.rms_after > 3.0 * channel.noise_floor
    assert channel.rms_after > 0.1 * channel.spread
    assert (diagnosis.verdict, diagnosis.unexplained) == ("none", ())


def test_a_coefficient_of_friction_that_would_drive_is_none_in_the_extended_model(one):
    recording, _ = moved()
    qd = np.gradient(recording.columns["q_1"], recording.t)
    # The controller's record lacks more of the viscous friction than there is.
    lacking = Recording({**recording.columns, "tau_1": recording.columns["tau_1"] - 1.8 * qd})
    diagnosis = diagnose(lacking, one, only=())
    (law,) = diagnosis.model.friction.laws
    viscous, coulomb = law.coefficients[:, 0]
    assert (viscous, coulomb) == (0.0, pytest.approx(2.0, rel=0.15))
    column = diagnosis.model.base.count
    assert diagnosis.model.covariance[column, column] == 0.0
    assert diagnosis.model.covariance[column + 1, column + 1] > 0.0
    free = diagnose(recording, one, only=()).model.friction.laws[0].coefficients[:, 0]
    assert free == pytest.approx([1.5, 2.0], rel=0.05)


def test_a_fast_recording_is_looked_at_no_finer_than_needed_and_says_the_same(one):
    fast, _ = moved(stribeck=1.5)
    t = np.arange(0.0, fast.t[-1], 0.001)
    fine = Recording.from_arrays(t, q=np.interp(t, fast.t, fast.columns["q_1"])[:, None],
                                 tau=np.interp(t, fast.t, fast.columns["tau_1"])[:, None])
    regression, usual = (torque_regression(r, one, Model.nominal(one)) for r in (fine, fast))
    assert regression.signals.dt == pytest.approx(0.004)
    assert regression.t[1] - regression.t[0] == pytest.approx(usual.t[1] - usual.t[0])
    assert len(regression.y) == pytest.approx(len(usual.y), abs=2)
    diagnosis, expected = (diagnose(r, one, only=(("stribeck", 1),)) for r in (fine, fast))
    (own,), (other,) = diagnosis.effects, expected.effects
    assert own.fitted.coefficients == pytest.approx(other.fitted.coefficients, rel=0.05)
    # Where more is measured its noise is averaged over all samples.
    measured = Recording({**fine.columns, "qa_1": fine.columns["q_1"]})
    assert torque_regression(measured, one, Model.nominal(one)).signals.dt == pytest.approx(0.001)


# What a diagnosis makes of a model's parameters: an arm that can be, and one joint is an arm too.

OWN = ROOT / "examples" / "own_robot.urdf"


def test_a_refitted_model_has_bodies_that_can_be() -> None:
    """Its mass matrix was not positive definite, so that no path could be corrected with it."""
    robot = Robot.load("kr6")
    nominal = Model.nominal(robot)
    count = nominal.base.count
    std = np.zeros(len(nominal.covariance))
    std[:count] = 0.3 * np.abs(nominal.base_values) + 0.05
    model = dataclasses.replace(nominal, covariance=np.diag(std**2))
    refitted = with_parameters(model, std * np.random.default_rng(3).normal(size=len(std)))
    possible = with_possible_inertias(refitted, nominal.consistent)

    def smallest(one: Model) -> float:
        return min(float(np.linalg.eigvalsh(pseudo_inertia(one.consistent[10 * i: 10 * i + 10]))[0]) for i in range(6))

    assert smallest(refitted) < 0 < smallest(possible)
    M = pin.crba(possible.dynamics, possible.dynamics.createData(), robot.home)
    assert np.linalg.eigvalsh(np.triu(M) + np.triu(M, 1).T)[0] > 0
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 5, 6))
    np.testing.assert_allclose(possible.inverse_dynamics(q, qd, qdd), refitted.inverse_dynamics(q, qd, qdd), atol=1e-6)


@pytest.mark.filterwarnings("error")
def test_a_fit_far_from_any_body_keeps_near_to_bodies_that_can_be() -> None:
    """Sizes were taken of the fit itself: the root of a negative inertia."""
    nominal = Model.nominal(Robot.load("kr6"))
    count = nominal.base.count
    std = np.zeros(len(nominal.covariance))
    std[:count] = 3.0 * np.abs(nominal.base_values) + 3.0
    fitted = with_parameters(dataclasses.replace(nominal, covariance=np.diag(std**2)), -std)
    inertia = [np.trace(pseudo_inertia(fitted.consistent[10 * i: 10 * i + 10])[:3, :3]) for i in range(6)]
    assert min(inertia) < 0.0
    full = with_possible_inertias(fitted, nominal.consistent).consistent
    assert all(np.linalg.eigvalsh(pseudo_inertia(full[10 * i: 10 * i + 10]))[0] > 0.0 for i in range(6))


def test_frames_of_a_single_joint() -> None:
    """Pinocchio's Jacobian has one dimension then: a turntable with a measured tool could not be diagnosed."""
    frames = frames_along(Robot.load(OWN), np.array([[0.0], [0.5]]))
    np.testing.assert_allclose(frames.axis[:, 0], [[0, 0, 1], [0, 0, 1]])


def test_a_parameter_that_moves_nothing_has_not_moved() -> None:
    nominal = Model.nominal(Robot.load("kr6"))
    change = np.ones(len(nominal.covariance))
    W = np.zeros((20, 6, len(change)))
    W[:, :, 3] = 1.0
    assert moved_parameters(nominal, change, 0.1 * np.eye(len(change)), W) == [(3, pytest.approx(10.0))]
