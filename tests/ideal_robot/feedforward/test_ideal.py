"""The ideal robot on a loop that it knows, roughly knows, or whose path changes under way; and learning on the arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.execution.precorrect import precorrect
from ideal_robot.feedforward.base import CommandLimits, PassThrough
from ideal_robot.feedforward.corrected_arm import CorrectedArm, ForCorrectedArm
from ideal_robot.feedforward.inverse import AHEAD, COMPLETE, Inverse, Options
from ideal_robot.feedforward.learning import LearningLaw, Playback, learn, learn_on_model
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.loop import checked, mass_at
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.models import shipped_model
from tests.arms import ROBOT, T, commands, motion, off, plant, rms


@pytest.mark.parametrize("delay", [0, 1])
def test_inverts_the_loop_it_knows(delay):
    loop, q_d = plant(delay=delay), motion()
    # What is left is what a linear interpolation over 12 ms cannot command at reversals of friction.
    assert off(loop, Inverse(loop), q_d) < 0.01 * off(loop, PassThrough(T), q_d)


def test_the_planners_delay_does_not_matter():
    q_d = motion()
    loops = plant(delay=0), plant(delay=1)
    arms = [simulate(loop, commands(Inverse(loop), q_d)).q_a[40:-1] for loop in loops]
    assert rms(arms[0] - arms[1]) < 1e-5


def test_wrong_inertias_friction_and_stiffness_cost_little():
    loop, q_d = plant(), motion()
    wrong = Inverse(plant(inertia=1.1, friction=0.9, stiffness=1.1))
    assert off(loop, wrong, q_d) < 0.05 * off(loop, PassThrough(T), q_d)


def test_gears_that_are_known_to_be_elastic_are_compensated():
    loop, q_d = plant(), motion()
    assert off(loop, Inverse(loop), q_d) < 0.2 * off(loop, Inverse(loop, options=Options(elastic=False)), q_d)


@pytest.mark.parametrize(("options", "times"), [(COMPLETE, 3.0), (AHEAD, 1.3)])
def test_what_drives_do_by_themselves_is_inverted_with_the_loop(options: Options, times: float) -> None:
    """Friction that they compensate, and gains that follow the inertia: by a loop that knows neither more is left."""
    plain, q_d = plant(), motion()
    half = 0.5 * plain.friction.dry
    known = checked(plain.changed(friction_torque=half, turning_speed=np.full(6, 0.05), schedule=0.6,
                                  scheduled_at=1.4 * np.diag(mass_at(plain.chain, ROBOT.rotor_inertia, ROBOT.home))))
    usual = off(plain, Inverse(plain, options=options), q_d)
    left, without = (off(known, Inverse(loop, options=options), q_d) for loop in (known, plain))
    assert left < 2.0 * usual
    assert without > times * left


HEAVY = 0.9 * np.diag(mass_at(plant().chain, ROBOT.rotor_inertia, ROBOT.home))


@pytest.mark.parametrize(("keys", "share"), [
    ({"integrated": 0.0, "k_ff": np.ones(6)}, 0.02), ({"integrated": 0.4}, 0.02),
    ({"k_i": np.zeros(6), "k_ff": np.zeros(6), "bodies": np.ones(6)}, 0.02),
    ({"k_i": np.zeros(6), "bodies": np.full(6, 0.8)}, 0.05),
    ({"k_ff": np.ones(6), "t_rate": 0.012}, 0.02), ({"integrated": 0.0, "k_ff": np.ones(6), "t_rate": 0.01}, 0.02),
    ({"integrated": 0.3, "k_ff": np.ones(6), "k_a": np.full(6, 0.03), "t_rate": 0.01}, 0.02),
    ({"k_i": np.zeros(6), "k_ff": np.ones(6), "k_a": np.full(6, 0.03), "t_rate": 0.01, "bodies": np.full(6, 1.1),
      "coupled": True, "scheduled_at": HEAVY}, 0.05)])
def test_controllers_beside_the_cascade_are_inverted(keys: dict[str, Any], share: float) -> None:
    """PID control, one between it and a cascade, impedance control, such that sags, inverse dynamics, lagging rates."""
    loop, q_d = checked(plant().changed(**keys)), motion(lead=60)
    assert off(loop, Inverse(loop), q_d, 60) < share * off(loop, PassThrough(T), q_d, 60)



def test_at_rest_the_arm_and_not_the_motor_is_where_it_shall_be():
    loop = plant()
    q_d = np.tile(motion()[0], (250, 1))
    done = simulate(loop, commands(Inverse(loop), q_d))
    assert np.max(np.abs(done.q_a[-1] - q_d[-1])) < 2e-5
    assert np.max(np.abs(done.q_m[-1] - q_d[-1])) > 3e-4


def test_expected_contact_torques_are_carried():
    loop = plant()
    q_d = np.tile(motion()[0], (220, 1))
    t = np.arange(len(q_d))
    torque = np.zeros_like(q_d)
    torque[:, 1] = 150.0 * np.clip((t - 60) / 40, 0, 1)
    feedforward = Inverse(loop)
    ahead = np.concatenate([torque, np.tile(torque[-1], (30, 1))])
    errors = {}
    for known in (True, False):
        state, q_c = feedforward.init(q_d[0]), np.empty_like(q_d)
        for k in range(len(q_d)):
            q_c[k], state = feedforward.step(state, q_d[:1].repeat(30, 0), ahead[k : k + 30] if known else None)
        errors[known] = np.max(np.abs(simulate(loop, q_c, tau_ext=torque).q_a[60:-1] - q_d[60:]))
    assert errors[True] < 0.3 * errors[False]


def test_a_path_that_a_sensor_bends_under_way_is_followed():
    """Every 20 ms the horizon changes sideways by up to 0.2 mrad, as camera fields make it."""
    loop, planned = plant(), motion()
    rng = np.random.default_rng(5)
    shift = np.zeros(len(planned) + 40)
    for start in range(0, len(shift), 2):
        shift[start:] += rng.normal(scale=5e-5)
    feedforward = Inverse(loop)
    state, q_c, desired = feedforward.init(planned[0]), np.empty_like(planned), np.empty_like(planned)
    ahead = np.concatenate([planned, np.tile(planned[-1], (40, 1))])
    for k in range(len(planned)):
        # The future is expected to stay as it is now; when it does not, the horizon steps.
        horizon = ahead[k : k + 30] + shift[k]
        desired[k] = horizon[0]
        q_c[k], state = feedforward.step(state, horizon)
    error = simulate(loop, q_c).q_a[:-1] - desired
    # Steps of 0.05 mrad in the desired path itself are not followed at once; nothing may be amplified beyond that.
    assert rms(error[40:]) < 3e-4
    assert np.max(np.abs(np.diff(q_c, n=2, axis=0))) < 5e-3


def test_noise_on_the_desired_path_is_not_amplified_beyond_the_arms_means():
    loop, q_d = plant(), motion()
    noisy = q_d + np.random.default_rng(2).normal(scale=2e-5, size=q_d.shape)
    difference = commands(Inverse(loop), noisy) - commands(Inverse(loop), q_d)
    assert rms(difference) < 2e-3


@pytest.mark.parametrize("bad", [np.full((30, 6), np.nan), np.zeros((30, 5)), np.zeros((0, 6)), np.zeros(6)])
def test_bad_horizons_are_refused(bad):
    feedforward = Inverse(plant())
    with pytest.raises(InputError, match="finite desired positions"):
        feedforward.step(feedforward.init(motion()[0]), bad)


def test_horizon_must_have_a_row():
    with pytest.raises(InputError, match="at least one row"):
        Inverse(plant(), 0)


# An arm whose geometry is not the drawn one: its tool where the path wants it, and where a follower believes it.

EFFECTS = (FittedEffect("kinematic_error", 2, "tcp_2", (1e-3, 5e-4, 1e-3, -7e-4)),
           FittedEffect("kinematic_error", 6, "tcp_6", (2e-4, -3e-4, 2e-3, 0.0)),
           FittedEffect("zero_error", 3, "tau_3", (4e-3,)))


@pytest.mark.parametrize("name", ["kr15", "kr6", "manutec_r15"])
def test_tool_is_where_the_drawn_arm_would_have_it(name):
    robot = Robot.load(name)
    arm, drawn = CorrectedArm(robot, EFFECTS), robot.fk()
    q = robot.home + 0.2 * np.random.default_rng(3).normal(size=(6, robot.n))
    for desired, moved in zip(q, arm.joints(q), strict=True):
        pose, expected = arm.tool(moved), drawn(desired)
        assert np.linalg.norm(pose.translation - expected.translation) < 1e-8
        assert np.linalg.norm(pin.log3(pose.rotation.T @ expected.rotation)) < 1e-7
        assert np.linalg.norm(arm.tool(desired).translation - expected.translation) > 1e-3
        # What a follower that knows the drawn arm makes of the arm's angles is where the tool is.
        assert np.linalg.norm(drawn(arm.as_drawn(moved)).translation - expected.translation) < 1e-7


def test_no_geometry_changes_nothing():
    robot = Robot.load("kr15")
    arm = CorrectedArm(robot, (FittedEffect("viscous", 2, "tau_2", (3.0,)),))
    q = np.tile(robot.home, (3, 1))
    assert not arm.differs
    assert arm.joints(q) is q
    np.testing.assert_array_equal(arm.as_drawn(q[0]), q[0])


@pytest.mark.parametrize("t_ipo", [0.004, 0.012])
def test_the_correction_is_solved_for_at_as_many_instants_whatever_the_cycle(monkeypatch, t_ipo):
    robot, solved = Robot.load("kr15"), []
    law = ForCorrectedArm(PassThrough(t_ipo), CorrectedArm(robot, EFFECTS))
    monkeypatch.setattr(law.arm, "joints", lambda q: solved.append(len(q)) or q)
    law.step(law.init(robot.home), np.tile(robot.home, (round(0.3 / t_ipo), 1)))
    assert solved == [6]


def test_expected_error_of_a_corrected_path_is_that_of_the_tool():
    """The corrected joint path differs from the drawn one by milliradians; the error that is expected does not."""
    robot, model = Robot.load("kr15"), Model.load(shipped_model("kr15"))
    t = np.arange(0.0, 1.5, 0.012)
    q = robot.home + 0.05 * np.sin(np.pi * t / 1.5)[:, None] ** 2 * np.ones(robot.n)
    plain, moved = (precorrect(t, q, known, robot) for known in (model, model.with_effects(EFFECTS[:2])))
    assert np.max(np.abs(moved.q_c - plain.q_c)) > 5e-4
    assert np.all(moved.expected_rms[0] < plain.expected_rms[0] + 2e-4)


# Learning: it converges where its model is fair, stops where it is not, and never ends worse than it began.

def player(loop, q_d):
    return lambda q_c: q_d - simulate(loop, q_c).q_a[:-1]


def test_four_iterations_leave_little():
    loop, q_d = plant(), motion()
    law = LearningLaw(LinearLoop.of(plant(inertia=1.1, friction=0.8), ROBOT.home), len(q_d))
    done = learn(player(loop, q_d), q_d, law, iterations=4)
    assert done.best < 0.02 * done.criterion[0]
    assert len(done.criterion) == len(done.kept) == 5
    assert rms(player(loop, q_d)(done.q_c)) == pytest.approx(done.best, rel=1e-9)


def test_learning_on_the_model_needs_no_arm():
    """A model wrong by 3 % in inertia and friction and 5 % in stiffness: the figures of issue-sized tolerances."""
    arm, q_d = plant(), motion()
    done = learn_on_model(plant(inertia=1.03, friction=0.97, stiffness=1.05), q_d)
    assert rms(player(arm, q_d)(done.q_c)) < 0.03 * rms(player(arm, q_d)(q_d))


def test_learning_on_the_model_improves_on_the_flat_inverse():
    loop, q_d = plant(), motion()
    done = learn_on_model(loop, q_d, commands(Inverse(loop), q_d))
    assert done.best < 0.7 * done.criterion[0]


def poor_trial(seed: int) -> tuple[float, float]:
    """First and final criterion, measured anew without noise, of learning with a randomly poor linear model."""
    rng = np.random.default_rng(seed)
    loop = plant(friction=rng.uniform(0.3, 2.0), stiffness=rng.uniform(0.5, 2.0), delay=int(rng.integers(2)))
    q_d = motion(amplitude=rng.uniform(0.05, 0.25), lead=15, tail=10, duration=1.2)
    good = LinearLoop.of(plant(), ROBOT.home)
    # Responses late by up to four cycles, of wrong size, with wrong tails and noise: some of them diverge.
    g = np.roll(good.g, int(rng.integers(-1, 5)), axis=0) * rng.uniform(0.3, 2.5)
    g = g + rng.normal(scale=0.03, size=g.shape)
    law = LearningLaw(LinearLoop(g, T), len(q_d), smoothness=float(10 ** rng.uniform(-2, 0)))
    noise = np.random.default_rng(seed + 1000)
    play = player(loop, q_d)
    done = learn(lambda q_c: play(q_c) + noise.normal(scale=2e-5, size=q_c.shape), q_d, law, iterations=5)
    return rms(play(q_d)), rms(play(done.q_c))


@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.slow)])
def test_poor_models_never_end_worse(count):
    results = np.array([poor_trial(seed) for seed in range(count)])
    # 1e-6 rad: two plays that differ by less than the noise's own effect on the criterion count as equal.
    assert np.all(results[:, 1] <= results[:, 0] + 1e-6)
    assert np.median(results[:, 1] / results[:, 0]) < 0.5


def test_divergence_is_noticed_and_stops():
    loop, q_d = plant(), motion()
    wrong_way = LearningLaw(LinearLoop(-LinearLoop.of(loop, ROBOT.home).g, T), len(q_d))
    done = learn(player(loop, q_d), q_d, wrong_way, iterations=10)
    assert done.stopped is not None
    assert len(done.criterion) < 11
    np.testing.assert_array_equal(done.q_c, q_d)


def test_an_arm_that_reports_nonsense_is_not_believed():
    q_d = motion()
    law = LearningLaw(LinearLoop.of(plant(), ROBOT.home), len(q_d))
    plays = 0

    def play(q_c):
        nonlocal plays
        plays += 1
        error = player(plant(), q_d)(q_c)
        return np.full_like(error, np.nan) if plays == 2 else error

    done = learn(play, q_d, law, iterations=3)
    assert np.isfinite(done.q_c).all()
    assert done.best < done.criterion[0]


def test_commands_stay_within_position_and_speed_limits():
    loop, q_d = plant(), motion()
    low, high = q_d.min(axis=0) - 0.004, q_d.max(axis=0) + 0.004
    step = 1.02 * np.max(np.abs(np.diff(q_d, axis=0)), axis=0)
    law = LearningLaw(LinearLoop.of(loop, ROBOT.home), len(q_d))
    done = learn(player(loop, q_d), q_d, law, limits=CommandLimits(low, high, step))
    for q_c in done.kept:
        assert np.all((q_c >= low) & (q_c <= high))
        assert np.all(np.abs(np.diff(q_c, axis=0)) <= step * (1 + 1e-9))


def test_law_and_path_must_fit():
    law = LearningLaw(LinearLoop.of(plant(), ROBOT.home), 100)
    with pytest.raises(InputError, match="100 cycles"):
        learn(lambda q_c: q_c, motion(), law)


def test_playback_plays_and_holds():
    q_c = motion()
    playback = Playback(q_c, T)
    assert playback.t_ipo == T
    played = commands(playback, np.zeros((len(q_c) + 5, 6)))
    np.testing.assert_array_equal(played[: len(q_c)], q_c)
    np.testing.assert_array_equal(played[-1], q_c[-1])
