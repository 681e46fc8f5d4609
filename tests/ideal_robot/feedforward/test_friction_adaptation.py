"""Adaptation: it follows friction, does nothing without measurements, and stays bounded whatever it is told."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from ideal_robot.estimate.recursive import GATE
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal, FrictionAdaptation
from ideal_robot.feedforward.friction_curve import FrictionCurve
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.friction.table import DRY
from ideal_robot.friction.terms import OWN, SHARED, TERMS
from ideal_robot.loop.simulation import simulate
from ideal_robot.robots.interface import RobotState
from tests.arms import ROBOT, T, commands, motion, off, plant, rms


def states(loop, q_d, repeat=3, rng=None):
    """What the controller of ``loop`` would tell along a motion that is repeated."""
    q_d = np.concatenate([q_d] * repeat)
    done = simulate(loop, commands(Inverse(loop), q_d))
    tau = done.tau if rng is None else done.tau + rng.normal(scale=0.03, size=done.tau.shape) * np.ptp(done.tau, axis=0)
    return [RobotState(t, q, torque) for t, q, torque in zip(done.t[1:], done.q_m[1:], tau[1:], strict=True)]


def fed(adaptation, measured, state=None):
    return reduce(adaptation.update, measured, state or adaptation.init())


def sliding_ratio(loop, known, speeds=(0.3, 0.8)):
    """Adapted over identified friction at speeds ``(m, n)``: terms trade, what counts is their sum."""
    adapted, identified = (np.array([[np.interp(speed, v, table) for v, table in
                                      zip(friction.speeds, friction.sliding[:, 0], strict=True)] for speed in speeds])
                           for friction in (known.friction, loop.friction))
    return adapted / identified


def loaded(loop, mass=2.0, com=(0.05, 0.0, 0.15)):
    """The loop with a point mass on its last link."""
    chain, com = loop.chain, np.array(com)
    whole = chain.mass[-1] + mass
    centre = (chain.mass[-1] * chain.com[-1] + mass * com) / whole
    masses, coms, inertia = chain.mass.copy(), chain.com.copy(), chain.inertia.copy()
    for m, offset in ((chain.mass[-1], chain.com[-1] - centre), (mass, com - centre)):
        inertia[-1] += m * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    masses[-1], coms[-1] = whole, centre
    return loop.changed(chain=chain._replace(mass=masses, com=coms, inertia=inertia))


TOOL = np.array([0.0, 0.0, 0.15])
"""Where the mass is looked for: 5 cm beside where ``loaded`` has it."""


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_heavier_tool_is_not_taken_for_friction(factor):
    """Both from a start that knows of neither; in places where a joint goes one way they look the same."""
    loop = plant()
    factors = fed(FrictionAdaptation(loop, tool=TOOL), states(loaded(plant(friction=factor)), motion()))
    np.testing.assert_allclose(factors.mass, 2.0, rtol=0.2)
    np.testing.assert_allclose(sliding_ratio(loop, factors), factor, rtol=0.1)


def test_inertias_that_are_wrong_are_not_taken_for_a_mass():
    """Rotors 5 % heavier than identified, where all is fast; -0.4 kg if all samples counted alike."""
    loop = plant()
    factors = fed(FrictionAdaptation(loop, tool=TOOL),
                  states(loop.changed(rotor_inertia=1.05 * loop.drives.rotor_inertia), motion()))
    assert abs(factors.mass) < 0.3
    np.testing.assert_allclose(sliding_ratio(loop, factors), 1.0, atol=0.1)


def test_two_motions_one_after_the_other_are_not_taken_for_one():
    """A window of the end of a calibration and of the start of a run showed a tool 1 to 2 kg lighter than it is."""
    loop = plant()
    adaptation = FrictionAdaptation(loop, tool=TOOL)
    first = states(loop, motion(), repeat=1)
    second = [RobotState(state.t + 3600.0, state.q, state.tau) for state in first[10:]]
    apart = fed(adaptation, second, adaptation.begun(fed(adaptation, first)))
    together = fed(adaptation, [*first, *second])
    np.testing.assert_array_equal(together.x, apart.x)
    np.testing.assert_array_equal(together.covariance, apart.covariance)


def test_contact_that_is_expected_is_not_taken_for_a_lighter_tool():
    loop, rng = plant(), np.random.default_rng(4)
    adaptation = FrictionAdaptation(loop, tool=TOOL)
    free = pressed = adaptation.init()
    for state in states(loop, motion(), repeat=1):
        tau_ext = rng.normal(scale=20.0, size=loop.n)
        free = adaptation.update(free, state)
        tau = state.tau - loop.drives.gain * tau_ext
        pressed = adaptation.update(pressed, RobotState(state.t, state.q, tau), tau_ext)
    np.testing.assert_allclose(pressed.mass, free.mass, atol=1e-9)
    np.testing.assert_allclose(pressed.values, free.values, atol=1e-9)


def test_what_was_learned_before_the_start_does_not_jerk_the_arm():
    """At rest the motors hold the tool already: nothing is commanded for it (0.2 mrad of joint 2 otherwise)."""
    loop, q_d = plant(), np.tile(ROBOT.home, (60, 1))
    adaptation = FrictionAdaptation(loop, tool=TOOL)
    known = adaptation.init()._replace(mass=2.0)
    heavier = commands(AdaptedIdeal(Inverse(loop), adaptation, known), q_d)
    np.testing.assert_allclose(heavier, commands(Inverse(loop), q_d), atol=2e-6)


def test_it_makes_the_path_better_when_the_tool_is_heavier():
    loop, q_d = plant(), motion()
    heavier = loaded(loop, mass=6.0)
    adaptation = FrictionAdaptation(loop, tool=TOOL)
    known = fed(adaptation, states(heavier, q_d))
    wanted = simulate(loop, commands(Inverse(loop), q_d)).q_m[40:-1]
    fixed, adapted = (rms(simulate(heavier, commands(feedforward, q_d)).q_m[40:-1] - wanted) for feedforward in
                      (Inverse(loop), AdaptedIdeal(Inverse(loop), adaptation, known)))
    assert adapted < 0.5 * fixed


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.4])
def test_finds_how_much_friction_has_changed(factor):
    """What torques show of acceleration is not taken for friction: they are read where they jump, the arm lags behind
    its gears, and friction has to turn after each reversal."""
    loop = plant()
    factors = fed(FrictionAdaptation(loop), states(plant(friction=factor), motion()))
    np.testing.assert_allclose(sliding_ratio(loop, factors), factor, rtol=0.03)


def test_a_joint_that_stands_still_is_thought_to_be_as_cold_as_the_others():
    loop, q_d = plant(), motion()
    q_d[:, 4:] = ROBOT.home[4:]
    factors = fed(FrictionAdaptation(loop), states(plant(friction=1.4), q_d))
    assert factors.used[4] == 0
    assert 1.05 < sliding_ratio(loop, factors)[0, 4] < 1.4


def test_joints_that_slide_slowly_are_learned_too():
    """A tenth of the motion: hardly any joint is faster than 2 % of its limit, and all are far beyond presliding."""
    loop, q_d = plant(), motion()
    factors = fed(FrictionAdaptation(loop), states(plant(friction=1.4), q_d[0] + 0.1 * (q_d - q_d[0])))
    assert np.all(factors.used > 50)
    assert np.all(sliding_ratio(loop, factors, (0.03,)) > 1.3)


def test_noise_does_not_move_it_away_from_the_truth():
    """Torque noise of 3 % of its whole range: 25 N m on the base joints, a quarter of their dry friction."""
    loop = plant()
    factors = fed(FrictionAdaptation(loop), states(loop, motion(), rng=np.random.default_rng(3)))
    np.testing.assert_allclose(sliding_ratio(loop, factors), 1.0, atol=0.15)


def test_without_a_recording_it_is_the_ideal_robot():
    loop, q_d = plant(), motion()
    adapts = AdaptedIdeal(Inverse(loop), FrictionAdaptation(loop, tool=TOOL))
    np.testing.assert_array_equal(commands(adapts, q_d), commands(Inverse(loop), q_d))


def test_what_is_learned_is_used_in_the_adapted_joints_alone():
    """Joints that are left as they were get the ideal robot's torque, the others the adapted one's."""
    loop, q_d = plant(), motion()
    adaptation, curve = FrictionAdaptation(loop), FrictionCurve(loop)
    known = fed(adaptation, states(plant(friction=1.4), q_d))
    inertia = curve.init()
    inertia = inertia._replace(inertia=inertia.inertia + 0.1)
    some = np.arange(loop.n) % 2 == 0
    none, all_, mixed = (AdaptedIdeal(Inverse(loop), adaptation, known, curve, adapted=joints)
                         for joints in (~some & some, None, some))
    after = [law.step(law.init(q_d[0])._replace(curve=inertia), q_d[60:90])[1].ideal.planned
             for law in (none, all_, mixed)]
    plain = Inverse(loop)
    np.testing.assert_array_equal(after[0].tau, plain.step(plain.init(q_d[0]), q_d[60:90])[1].planned.tau)
    np.testing.assert_array_equal(after[2].tau, np.where(some, after[1].tau, after[0].tau))
    assert np.all(after[1].tau != after[0].tau)


def test_a_motor_that_does_not_follow_at_all_strays_farther_than_one_that_follows_badly():
    """Cycles that tell nothing of friction were left out of the sum: the worst play looked like the best."""
    loop, q_d = plant(), motion()
    ideal, curve, sums = Inverse(loop), FrictionCurve(loop), []
    for apart in (0.0, 1.0):
        planned, known = ideal.init(q_d[0]), curve.init()
        for k in range(100):
            _, planned = ideal.step(planned, q_d[k : k + 30])
            known = curve.planned(known, planned)
            known = curve.update(known, known.plans[0].q + apart)
        sums.append(known.strayed)
    assert np.all(sums[0] < sums[1])


@pytest.mark.parametrize("amplitude", [0.0, 1e-4])
def test_where_nothing_tells_anything_it_is_the_ideal_robot_bit_for_bit(amplitude):
    """An arm that stands, and one that stirs by less than friction turns over, pushed by torques of any size."""
    loop, rng = plant(), np.random.default_rng(3)
    q_d = ROBOT.home + amplitude * np.sin(0.5 * T * np.arange(300))[:, None]
    ideal = Inverse(loop)
    adapts = AdaptedIdeal(ideal, FrictionAdaptation(loop, tool=TOOL))
    known, plain = adapts.init(q_d[0]), ideal.init(q_d[0])
    for k in range(len(q_d) - 30):
        q_c, known = adapts.step(known, q_d[k : k + 30])
        expected, plain = ideal.step(plain, q_d[k : k + 30])
        np.testing.assert_array_equal(q_c, expected)
        known = adapts.observe(known, RobotState(k * T, q_d[k], rng.normal(scale=100.0, size=loop.n)))


def falling(loop, share=0.3):
    """The loop with friction that falls by a share of the dry one before it rises."""
    speed = loop.friction.speeds / loop.path.v_max[:, None]
    sizes = loop.friction.sizes.copy()
    sizes[..., DRY] -= share * sizes[:, :, :1, DRY] * (1.0 - np.exp(-((speed / 0.01) ** 2)))[:, None]
    return loop.changed(sizes=sizes)


@pytest.mark.parametrize("factor", [0.8, pytest.param(1.3, marks=pytest.mark.slow)])
def test_friction_that_falls_before_it_rises_is_found_in_the_torques(factor):
    """At half a percent of the largest speed, where it falls, at three and at twenty; over dry friction."""
    loop, slow = plant(), motion(0.05)
    true = falling(plant(friction=factor))
    known = fed(FrictionAdaptation(loop), [*states(true, motion()), *states(true, slow)])
    missed = [np.abs([np.interp(share * loop.path.v_max[i], true.friction.speeds[i],
                                (known.friction.sliding - true.friction.sliding)[i, 0]) / true.friction.dry[i]
                      for i in range(loop.n)]).max() for share in (0.005, 0.03, 0.2)]
    assert np.all(np.array(missed) < (0.1, 0.05, 0.05)), missed


def test_an_arm_whose_friction_falls_before_it_rises_is_where_it_should_be():
    loop, q_d = plant(), motion()
    true, adaptation = falling(loop), FrictionAdaptation(loop)
    known = fed(adaptation, [*states(true, q_d), *states(true, motion(0.05))])
    adapted = AdaptedIdeal(Inverse(loop), adaptation, known)
    assert off(true, adapted, q_d) < 0.25 * off(true, Inverse(loop), q_d)


def test_where_the_model_leaves_more_than_friction_little_is_learned():
    """A joint torque sensor behind the gear shows hardly any friction: what is left there is not friction's."""
    loop = plant()
    dry, rng = loop.friction.dry, np.random.default_rng(5)
    measured = [replace(s, tau=s.tau + 2.0 * dry * rng.standard_normal(loop.n)) for s in states(loop, motion())]
    off = [np.abs(fed(FrictionAdaptation(loop, noise_std=floor), measured).values).max() for floor in (None, dry)]
    assert off[1] < 0.5 * off[0]


def poisons(kind, rng, n, k):
    return {
        "nan": (np.full(n, np.nan), np.full(n, np.nan)),
        "huge": (rng.normal(scale=1e6, size=n), rng.normal(scale=1e9, size=n)),
        "stuck": (np.zeros(n), np.zeros(n)),
        "noise": (rng.normal(size=n), rng.normal(scale=3000.0, size=n)),
        "reversed": (np.full(n, 0.01 * k), np.full(n, -1e4)),
        "short": (np.zeros(2), np.zeros(2)),
    }[kind]


@pytest.mark.parametrize("kind", ["nan", "huge", "stuck", "noise", "reversed", "short"])
def test_a_poisoned_recording_leaves_it_bounded(kind):
    loop, q_d = plant(), motion()
    adaptation = FrictionAdaptation(loop)
    rng = np.random.default_rng(9)
    state = fed(adaptation, [RobotState(k * T, *poisons(kind, rng, loop.n, k)) for k in range(800)])
    assert np.all(np.abs(state.values) <= GATE * (OWN + np.pad(SHARED, (0, TERMS - 2))))
    assert np.all(np.linalg.eigvalsh(state.covariance) > 0.0)
    assert np.isfinite(state.mass)
    feedforward = AdaptedIdeal(Inverse(loop), adaptation)
    begun = feedforward.init(q_d[0], state)
    q_c = []
    for k in range(len(q_d) - 30):
        command, begun = feedforward.step(begun, q_d[k : k + 30])
        q_c.append(command)
    plain = commands(Inverse(loop), q_d)[: len(q_c)]
    assert np.max(np.abs(np.array(q_c) - plain)) < 0.05


def test_good_measurements_after_bad_ones_count_again():
    loop = plant()
    adaptation = FrictionAdaptation(loop)
    nothing = np.full(loop.n, np.nan)
    state = fed(adaptation, [RobotState(k * T, nothing, nothing) for k in range(200)])
    assert not state.values.any()
    assert np.all(sliding_ratio(loop, fed(adaptation, states(plant(friction=1.3), motion()), state)) > 1.2)


def test_it_makes_the_path_better_when_friction_has_grown():
    loop, worn, q_d = plant(), plant(friction=1.4), motion()
    follows = AdaptedIdeal(Inverse(loop), known=fed(FrictionAdaptation(loop), states(worn, q_d)))
    assert off(worn, follows, q_d) < 0.5 * off(worn, Inverse(loop), q_d)
