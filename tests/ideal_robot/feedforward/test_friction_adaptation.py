"""Adaptation: it follows friction, does nothing without measurements, and stays bounded whatever it is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal, FrictionAdaptation, adapted
from ideal_robot.feedforward.friction_curve import LARGEST
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.loop.simulation import simulate
from ideal_robot.robots.interface import RobotState
from tests.ideal_robot.feedforward.plant import ROBOT, T, commands, motion, plant, rms


def states(loop, q_d, repeat=3, rng=None):
    """What the controller of ``loop`` would tell along a motion that is repeated."""
    q_d = np.concatenate([q_d] * repeat)
    done = simulate(loop, commands(IdealRobot(loop), q_d))
    tau = done.tau if rng is None else done.tau + rng.normal(scale=0.03, size=done.tau.shape) * np.ptp(done.tau, axis=0)
    return [RobotState(t, q, torque) for t, q, torque in zip(done.t[1:], done.q_m[1:], tau[1:], strict=True)]


def fed(adaptation, measured):
    state = adaptation.init()
    for one in measured:
        state = adaptation.update(state, one)
    return state


def sliding_ratio(loop, theta):
    """Adapted over identified friction at two speeds ``(2, n)``: the two factors trade, what counts is their sum."""
    return table_ratio(loop, adapted(loop, theta)["friction_torque"])


def table_ratio(loop, friction_torque):
    """A table of friction over the loop's at two speeds ``(2, n)``."""
    tables = friction_torque, loop.friction_torque
    return np.array([[np.interp(speed, loop.friction_velocity[:, i], tables[0][0, :, i])
                      / np.interp(speed, loop.friction_velocity[:, i], tables[1][0, :, i]) for i in range(loop.n)]
                     for speed in (0.3, 0.8)])


def loaded(loop, mass=2.0, com=(0.05, 0.0, 0.15)):
    """The loop with a point mass on its last link."""
    chain, com = loop.chain, np.array(com)
    whole = chain.mass[-1] + mass
    centre = (chain.mass[-1] * chain.com[-1] + mass * com) / whole
    masses, coms, inertia = chain.mass.copy(), chain.com.copy(), chain.inertia.copy()
    for m, way in ((chain.mass[-1], chain.com[-1] - centre), (mass, com - centre)):
        inertia[-1] += m * (way @ way * np.eye(3) - np.outer(way, way))
    masses[-1], coms[-1] = whole, centre
    return loop.replace(chain=chain._replace(mass=masses, com=coms, inertia=inertia))


TOOL = np.array([0.0, 0.0, 0.15])
"""Where the mass is looked for: 5 cm beside where ``loaded`` has it."""


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_heavier_tool_is_not_taken_for_friction(factor):
    """Both from a start that knows of neither; in places where a joint goes one way they look the same."""
    loop = plant()
    factors = fed(FrictionAdaptation(loop, tool=TOOL), states(loaded(plant(friction=factor)), motion()))
    np.testing.assert_allclose(factors.mass, 2.0, rtol=0.2)
    np.testing.assert_allclose(sliding_ratio(loop, factors.theta), factor, rtol=0.1)


def test_inertias_that_are_wrong_are_not_taken_for_a_mass():
    """Rotors 5 % heavier than identified, where all is fast; -0.4 kg if all samples counted alike."""
    loop = plant()
    factors = fed(FrictionAdaptation(loop, tool=TOOL),
                  states(loop.replace(rotor_inertia=1.05 * loop.rotor_inertia), motion()))
    assert abs(factors.mass) < 0.3
    np.testing.assert_allclose(sliding_ratio(loop, factors.theta), 1.0, atol=0.1)


def test_contact_that_is_expected_is_not_taken_for_a_lighter_tool():
    loop, rng = plant(), np.random.default_rng(4)
    adaptation = FrictionAdaptation(loop, tool=TOOL)
    free = pressed = adaptation.init()
    for one in states(loop, motion(), repeat=1):
        tau_ext = rng.normal(scale=20.0, size=loop.n)
        free = adaptation.update(free, one)
        pressed = adaptation.update(pressed, RobotState(one.t, one.q, one.tau - loop.gain * tau_ext), tau_ext)
    np.testing.assert_allclose(pressed.mass, free.mass, atol=1e-9)
    np.testing.assert_allclose(pressed.theta, free.theta, atol=1e-9)


def test_what_was_learned_before_the_start_does_not_jerk_the_arm():
    """At rest the motors hold the tool already: nothing is commanded for it (0.2 mrad of joint 2 otherwise)."""
    loop, q_d = plant(), np.tile(ROBOT.home, (60, 1))
    adaptation = FrictionAdaptation(loop, tool=TOOL)
    known = replace(fed(adaptation, states(loaded(loop), motion())), theta=np.ones((loop.n, 2)))
    heavier = commands(AdaptedIdeal(IdealRobot(loop), adaptation, known), q_d)
    np.testing.assert_allclose(heavier, commands(IdealRobot(loop), q_d), atol=2e-6)


def test_it_makes_the_path_better_when_the_tool_is_heavier():
    loop, q_d = plant(), motion()
    heavier = loaded(loop, mass=6.0)
    adaptation = FrictionAdaptation(loop, tool=TOOL)
    known = fed(adaptation, states(heavier, q_d))
    error = {name: rms(simulate(heavier, commands(feedforward, q_d)).q_m[40:-1]
                       - simulate(loop, commands(IdealRobot(loop), q_d)).q_m[40:-1])
             for name, feedforward in (("fixed", IdealRobot(loop)),
                                       ("adapted", AdaptedIdeal(IdealRobot(loop), adaptation, known)))}
    assert error["adapted"] < 0.5 * error["fixed"]


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_finds_how_much_friction_has_changed(factor):
    loop = plant()
    factors = fed(FrictionAdaptation(loop), states(plant(friction=factor), motion()))
    np.testing.assert_allclose(sliding_ratio(loop, factors.theta), factor, rtol=0.1)


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.4])
def test_what_torques_show_of_acceleration_is_not_taken_for_friction(factor):
    """They are read where they jump, the arm lags behind its gears, and friction has to turn after each reversal."""
    loop = plant()
    factors = fed(FrictionAdaptation(loop), states(plant(friction=factor), motion()))
    np.testing.assert_allclose(sliding_ratio(loop, factors.theta), factor, rtol=0.03)


def test_a_joint_that_stands_still_is_thought_to_be_as_cold_as_the_others():
    loop, q_d = plant(), motion()
    q_d[:, 4:] = ROBOT.home[4:]
    factors = fed(FrictionAdaptation(loop), states(plant(friction=1.4), q_d))
    assert factors.used[4] == 0
    assert 1.05 < sliding_ratio(loop, factors.theta)[0, 4] < 1.4


def test_joints_that_slide_slowly_are_learned_too():
    """A tenth of the motion: hardly any joint is faster than 2 % of its limit, and all are far beyond presliding."""
    loop, q_d = plant(), motion()
    factors = fed(FrictionAdaptation(loop), states(plant(friction=1.4), q_d[0] + 0.1 * (q_d - q_d[0])))
    assert np.all(factors.used > 50)
    assert np.all(factors.theta[:, 0] > 1.2)


def test_noise_does_not_move_it_away_from_the_truth():
    """Torque noise of 3 % of its whole range: 25 N m on the base joints, a quarter of their dry friction."""
    loop = plant()
    factors = fed(FrictionAdaptation(loop), states(loop, motion(), rng=np.random.default_rng(3)))
    np.testing.assert_allclose(sliding_ratio(loop, factors.theta), 1.0, atol=0.15)


@pytest.mark.parametrize("curve", [False, True])
def test_without_a_recording_it_is_the_ideal_robot(curve):
    loop, q_d = plant(), motion()
    adapts = AdaptedIdeal(IdealRobot(loop), FrictionAdaptation(loop, tool=TOOL, curve=curve))
    np.testing.assert_array_equal(commands(adapts, q_d), commands(IdealRobot(loop), q_d))


def falling(loop, share=0.3):
    """The loop with friction that falls by a share of the dry one before it rises."""
    speed = loop.friction_velocity / loop.v_max
    return loop.replace(friction_torque=loop.friction_torque - share * loop.friction_torque[:, :1]
                        * (1.0 - np.exp(-((speed / 0.01) ** 2))))


@pytest.mark.parametrize("factor", [0.8, 1.3])
def test_friction_that_falls_before_it_rises_is_found_in_the_torques(factor):
    """At half a percent of the largest speed, where it falls, at three and at twenty."""
    loop, slow = plant(), motion(0.05)
    true = falling(plant(friction=factor))
    missed = {}
    for curve in (False, True):
        adaptation = FrictionAdaptation(loop, curve=curve)
        known = fed(adaptation, [*states(true, motion()), *states(true, slow)])
        found = adaptation.friction(known)["friction_torque"]
        missed[curve] = [np.abs([np.interp(share * loop.v_max[i], loop.friction_velocity[:, i],
                                           (found - true.friction_torque)[0, :, i]) / true.friction_torque[0, 0, i]
                                 for i in range(loop.n)]).max() for share in (0.005, 0.03, 0.2)]
    assert np.all(np.array(missed[True]) < 0.75 * np.array(missed[False]))


def test_an_arm_whose_friction_falls_before_it_rises_is_where_it_should_be():
    """The two factors alone level what friction falls by, and leave it wrong at reversals."""
    loop, q_d = plant(), motion()
    true = falling(loop)
    error = {}
    for curve in (False, True):
        adaptation = FrictionAdaptation(loop, curve=curve)
        known = fed(adaptation, [*states(true, q_d), *states(true, motion(0.05))])
        follows = AdaptedIdeal(IdealRobot(loop), adaptation, known)
        error[curve] = rms(simulate(true, commands(follows, q_d)).q_a[40:-1] - q_d[40:])
    fixed = rms(simulate(true, commands(IdealRobot(loop), q_d)).q_a[40:-1] - q_d[40:])
    assert error[True] < 0.75 * error[False]
    assert error[True] < 0.25 * fixed


def test_where_the_model_leaves_more_than_friction_little_is_learned():
    """A joint torque sensor behind the gear shows hardly any friction: what is left there is not friction's."""
    loop = plant()
    dry, rng = loop.friction_torque[0, 0], np.random.default_rng(5)
    measured = [replace(one, tau=one.tau + 2.0 * dry * rng.standard_normal(loop.n)) for one in states(loop, motion())]
    off = [np.abs(fed(FrictionAdaptation(loop, noise_std=floor), measured).theta - 1.0).max() for floor in (None, dry)]
    assert off[1] < 0.5 * off[0]


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_curve_takes_nothing_away_from_a_heavier_tool(factor):
    loop = plant()
    adaptation = FrictionAdaptation(loop, tool=TOOL, curve=True)
    known = fed(adaptation, states(loaded(plant(friction=factor)), motion()))
    np.testing.assert_allclose(known.mass, 2.0, rtol=0.2)
    np.testing.assert_allclose(table_ratio(loop, adaptation.friction(known)["friction_torque"]), factor, rtol=0.1)


def poisons(kind, rng, n, k):
    return {
        "nan": (np.full(n, np.nan), np.full(n, np.nan)),
        "huge": (rng.normal(scale=1e6, size=n), rng.normal(scale=1e9, size=n)),
        "stuck": (np.zeros(n), np.zeros(n)),
        "noise": (rng.normal(size=n), rng.normal(scale=3000.0, size=n)),
        "reversed": (np.full(n, 0.01 * k), np.full(n, -1e4)),
        "short": (np.zeros(2), np.zeros(2)),
    }[kind]


@pytest.mark.parametrize("curve", [False, True])
@pytest.mark.parametrize("kind", ["nan", "huge", "stuck", "noise", "reversed", "short"])
def test_a_poisoned_recording_leaves_it_bounded(kind, curve):
    loop, q_d = plant(), motion()
    adaptation = FrictionAdaptation(loop, curve=curve)
    rng = np.random.default_rng(9)
    state = adaptation.init()
    for k in range(800):
        q, tau = poisons(kind, rng, loop.n, k)
        state = adaptation.update(state, RobotState(k * T, q, tau))
    low, high = adaptation.bounds
    assert np.all((state.theta >= low) & (state.theta <= high))
    assert np.all(np.isfinite(state.covariance))
    assert np.isfinite(state.mass)
    assert np.all(np.abs(state.curve) <= LARGEST)
    feedforward = AdaptedIdeal(IdealRobot(loop), adaptation)
    begun = feedforward.init(q_d[0], state)
    q_c = []
    for k in range(len(q_d) - 30):
        command, begun = feedforward.step(begun, q_d[k : k + 30])
        q_c.append(command)
    plain = commands(IdealRobot(loop), q_d)[: len(q_c)]
    assert np.max(np.abs(np.array(q_c) - plain)) < 0.05


def test_good_measurements_after_bad_ones_count_again():
    loop = plant()
    adaptation = FrictionAdaptation(loop)
    rng = np.random.default_rng(1)
    state = adaptation.init()
    for k in range(200):
        state = adaptation.update(state, RobotState(k * T, *poisons("nan", rng, loop.n, k)))
    np.testing.assert_array_equal(state.theta, np.ones((loop.n, 2)))
    for one in states(plant(friction=1.3), motion()):
        state = adaptation.update(state, one)
    assert np.all(state.theta[:, 0] > 1.1)


def test_it_makes_the_path_better_when_friction_has_grown():
    loop, worn, q_d = plant(), plant(friction=1.4), motion()
    factors = fed(FrictionAdaptation(loop), states(worn, q_d))
    follows = IdealRobot(loop.replace(**adapted(loop, factors.theta)))
    error = {name: rms(simulate(worn, commands(feedforward, q_d)).q_a[40:-1] - q_d[40:])
             for name, feedforward in (("fixed", IdealRobot(loop)), ("adapted", follows))}
    assert error["adapted"] < 0.5 * error["fixed"]
