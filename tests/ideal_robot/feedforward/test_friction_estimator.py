"""One estimate: what comes row by row says what the batch says, and what is long ago is as it was at first."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics
from ideal_robot.errors import InputError
from ideal_robot.estimate.recursive import GATE, correlation, marginal, predict, update
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal
from ideal_robot.feedforward.friction_at_work import FrictionAtWork, friction_at_work
from ideal_robot.feedforward.friction_curve import CurveState, FrictionCurve
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.feedforward.learned_friction import (
    INTERVAL,
    NOISE,
    WARMING,
    estimated,
    noise_variance,
    process_correlation,
)
from ideal_robot.feedforward.method import Setting
from ideal_robot.friction.terms import ALONE, SHAPE, SPEEDS, TERMS, friction_terms, likeness, table_terms, with_terms
from ideal_robot.loop.loop import Loop
from ideal_robot.loop.simulation import simulate
from ideal_robot.signals.recording import Recording
from scenes.arms import model_at
from tests.arms import ROBOT, T, motion, off, plant, rms

P = 7


def rows(rng, count=40):
    """Columns and measurements ``(count, P)``, ``(count,)``."""
    columns, true = rng.normal(size=(count, P)), rng.normal(size=P)
    return columns, columns @ true + 0.3 * rng.normal(size=count)


def counted_all(columns, left, wait=0.0):
    """Parameters and covariance, with a time before each row [s]."""
    x, covariance = np.zeros(P), np.eye(P)
    for h, y in zip(columns, left, strict=True):
        predict(x, covariance, correlation(wait, WARMING))
        assert update(x, covariance, h, y, 0.09)
    return x, covariance


def test_row_by_row_it_is_the_batch():
    columns, residual = rows(np.random.default_rng(1))
    x, covariance = counted_all(columns, residual)
    batch = estimated(columns / 0.3, residual / 0.3)
    # Products of columns round in the ninth digit.
    np.testing.assert_allclose(x, batch.mean, rtol=1e-7)
    np.testing.assert_allclose(covariance, batch.covariance, atol=1e-10)


def test_on_the_way_parameters_wander_as_said():
    """The batch of a walk: rows far apart in time are of parameters that correlate by what is left."""
    columns, residual = rows(np.random.default_rng(2), count=12)
    wait = 60.0
    steps = np.abs(np.subtract.outer(np.arange(12), np.arange(12)))
    prior = correlation(wait, WARMING) ** steps
    signal = prior * (columns @ columns.T)
    x = columns.T @ (prior[-1] * np.linalg.solve(signal + 0.09 * np.eye(12), residual))
    np.testing.assert_allclose(counted_all(columns, residual, wait)[0], x, rtol=1e-9)


def test_what_was_learned_long_ago_is_as_uncertain_as_at_first():
    x, covariance = counted_all(*rows(np.random.default_rng(3)))
    predict(x, covariance, correlation(20.0 * WARMING, WARMING))
    np.testing.assert_allclose(x, 0.0, atol=1e-7)
    np.testing.assert_allclose(covariance, np.eye(P), atol=1e-7)


@pytest.mark.parametrize("seconds", [2.0, 10.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_of_friction_that_warms_steadily_sigma_is_true(seconds):
    """A dry term goes from one draw of its prior to another; a walk of that time constant has σ √2 too wide."""
    rng, runs, h, a = np.random.default_rng(1), 400, ALONE[0] / NOISE, process_correlation(INTERVAL)
    first, last = rng.standard_normal((2, runs))
    mean, covariance = np.zeros((runs, 1)), np.ones((runs, 1, 1))
    for t in np.arange(0.0, seconds, INTERVAL):
        true = last + (first - last) * np.exp(-t / WARMING)
        for k, y in enumerate(h * true + rng.standard_normal(runs)):
            predict(mean[k], covariance[k], a)
            update(mean[k], covariance[k], np.array([h]), y, 1.0)
    assert 0.78 < rms((mean[:, 0] - true) / np.sqrt(covariance[:, 0, 0])) < 1.1


def test_what_is_too_far_changes_nothing():
    x, covariance, h = np.zeros(P), np.eye(P), np.ones(P)
    edge = GATE * np.sqrt(0.09 + P)
    for y in (1.01 * edge, -1.01 * edge, np.inf, np.nan):
        assert not update(x, covariance, h, y, 0.09)
    assert not x.any()
    np.testing.assert_array_equal(covariance, np.eye(P))
    assert update(x, covariance, h, 0.99 * edge, 0.09)


def test_parameters_stay_within_their_bounds():
    x, covariance, h = np.zeros(P), np.eye(P), np.zeros(P)
    for _ in range(1000):
        h[0] = 1.0
        update(x, covariance, h, 4.1, 0.09)
    assert x[0] == GATE


def test_what_is_remembered_of_some_parameters_is_their_marginal():
    """Mean and covariance of those that are kept, as if the others had never been asked for."""
    x, covariance = counted_all(*rows(np.random.default_rng(3)))
    places, forgotten = np.array([1, 4, 5]), np.array([0, 2, 3, 6])
    mean, uncertain = marginal(x[None], covariance[None], places)
    np.testing.assert_array_equal(mean[0, places], x[places])
    np.testing.assert_array_equal(uncertain[0][np.ix_(places, places)], covariance[np.ix_(places, places)])
    assert not mean[0, forgotten].any()
    np.testing.assert_array_equal(uncertain[0][np.ix_(forgotten, forgotten)], np.eye(4))
    assert not uncertain[0][np.ix_(forgotten, places)].any()


def test_the_curve_is_as_uncertain_as_said():
    """Of its components' variance hardly any is left out, between the nodes as at them."""
    one = np.ones(len(SPEEDS))
    at_nodes = friction_terms(SPEEDS, one)[:, 2:]
    np.testing.assert_allclose(at_nodes @ at_nodes.T, SHAPE**2 * likeness(), atol=0.004 * SHAPE**2)
    between = friction_terms(np.array([0.5 * (SPEEDS[3] + SPEEDS[4]), 1.3]), np.ones(2))
    np.testing.assert_allclose(between[0, 2:], 0.5 * (at_nodes[3] + at_nodes[4]))
    np.testing.assert_allclose(between[1, 2:], at_nodes[-1])
    np.testing.assert_allclose(friction_terms(SPEEDS, one)[:, :2], np.column_stack([one, np.sqrt(SPEEDS)]))


@pytest.mark.parametrize("spacing", [0.004, 0.012, 0.048])
def test_samples_that_are_nearer_say_no_more(spacing):
    variance = noise_variance(np.array([100.0, 4.0]), spacing, np.array([0.0, 3.0]))
    np.testing.assert_allclose(spacing * variance, 0.05 * np.array([15.0, 3.0]) ** 2)


def test_terms_are_added_to_the_table_and_dry_friction_scales_what_grows_with_load() -> None:
    """Zero changes nothing; a tenth more of dry friction is a tenth more by load; friction is never negative."""
    loop = plant()
    friction = loop.friction._replace(per_load=np.tile([0.04, -0.02], (loop.n, 1)))
    terms = table_terms(friction, loop.path.v_max)
    none = np.zeros((loop.n, TERMS))
    for before, after in zip(friction, with_terms(friction, terms, none), strict=True):
        np.testing.assert_array_equal(before, after)
    more = none.copy()
    more[:, 0] = 0.1
    changed = with_terms(friction, terms, more)
    np.testing.assert_allclose(changed.sizes, friction.sizes + 0.1 * terms[:, None, 0], atol=1e-12)
    np.testing.assert_allclose(changed.per_load, 1.1 * friction.per_load)
    assert np.all(with_terms(friction, terms, -100.0 * np.ones_like(none)).sliding >= 0.0)


# The friction curve: it finds a shape and an inertia that the model has not, from motor angles, and stays bounded.

SLOW = 0.02
"""Where the sticky arm differs most, in gross sliding [rad/s]."""


def sticky(loop: Loop) -> Loop:
    """The loop with a quarter more dry friction at rest, which is gone from 0.1 rad/s on."""
    more = 1.0 + 0.25 * np.exp(-((loop.friction.speeds / 0.05) ** 2))
    return loop.changed(sizes=loop.friction.sizes * more[:, None, :, None])


def learned(loop: Loop, true: Loop, q_d: Array, repeat: int = 4, scale: float = 1.0) -> CurveState:
    """What is learned while the ideal robot, which does not know, moves the true arm again and again."""
    ideal, curves = Inverse(loop), FrictionCurve(loop)
    q_d = np.concatenate([q_d] * repeat)
    ahead = np.concatenate([q_d, np.tile(q_d[-1], (ideal.n_d, 1))])
    q_c, states = np.empty_like(q_d), [ideal.init(q_d[0])]
    for k in range(len(q_d)):
        q_c[k], state = ideal.step(states[-1], ahead[k : k + ideal.n_d])
        states.append(state)
    done, known = simulate(true, q_c), curves.init()
    for k, state in enumerate(states[1:]):
        known = curves.planned(known, state)
        # The plan knows nothing of what is found.
        known = known._replace(plans=(*known.plans[:-1], known.plans[-1]._replace(x=np.zeros_like(known.x))))
        known = curves.update(known, scale * done.q_m[k + 1])
    return known


@pytest.mark.parametrize("delay", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_friction_that_falls_with_speed_is_found_in_the_motor_angles(delay: int) -> None:
    """The identified law rises from rest on; two factors on it cannot fall."""
    loop = plant(delay=delay)
    true = sticky(loop)
    estimate = FrictionCurve(loop).values(learned(loop, true, motion(amplitude=0.05)))
    more = (true.friction.sliding - loop.friction.sliding)[:, 0]
    ratio = np.array([dry * friction_terms(np.array([SLOW / most]), np.ones(1))[0] @ values / np.interp(SLOW, v, theirs)
                      for dry, most, values, v, theirs in zip(loop.friction.dry, loop.path.v_max, estimate,
                                                              loop.friction.speeds, more, strict=True)])
    assert np.all((ratio > 0.5) & (ratio < 1.2)), ratio


@pytest.mark.parametrize("delay", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_inertia_that_the_model_has_not_is_found_in_the_motor_angles(delay: int) -> None:
    loop = plant(delay=delay)
    more = np.array([0.08, -0.08, 0.08, -0.08, 0.08, -0.08]) * loop.cascade.k_p * loop.t_ipo
    rotor = loop.drives.rotor_inertia
    heavier = loop.changed(rotor_inertia=np.maximum(rotor + more, 0.2 * rotor))
    more = heavier.drives.rotor_inertia - rotor
    estimates = [learned(loop, true, motion()).inertia for true in (loop, heavier)]
    # Where joints move together it is not told apart whose acceleration it is; the torque is what counts.
    qdd = accelerations(loop, motion())
    for i in range(3):
        assert rms(qdd @ (estimates[1] - estimates[0])[i] - qdd[:, i] * more[i]) < 0.35 * rms(qdd[:, i] * more[i])


def accelerations(loop: Loop, q: Array) -> Array:
    return np.asarray(np.gradient(np.gradient(q, loop.t_ipo, axis=0), loop.t_ipo, axis=0))


def test_links_that_other_joints_accelerate_are_found_in_the_motor_angles() -> None:
    """A forearm that is heavier than the model's is felt by the upper arm's motor when the elbow turns."""
    loop, q_d = plant(), motion()
    mass = loop.chain.mass.copy()
    mass[2] *= 1.3
    heavier = loop.changed(chain=loop.chain._replace(mass=mass))
    middle = np.median(q_d, axis=0)
    estimate = learned(loop, heavier, q_d).inertia - learned(loop, loop, q_d).inertia
    q, still = np.tile(middle, (loop.n, 1)), np.zeros((loop.n, loop.n))
    more, less = (inverse_dynamics(true.chain, q, still, np.eye(loop.n))
                  - inverse_dynamics(true.chain, q, still, still) for true in (heavier, loop))
    expected = (more - less)[1:3, 1:3].T
    qdd = accelerations(loop, q_d)[:, 1:3]
    error = rms(qdd @ (estimate[1:3, 1:3] - expected).T)
    assert error < 0.5 * rms(qdd @ expected.T)
    assert error < rms(qdd @ (np.diag(np.diagonal(estimate)[1:3]) - expected).T)


def test_with_the_inertia_of_another_motion_the_arm_is_where_it_should_be() -> None:
    loop = plant()
    heavier = loop.changed(rotor_inertia=loop.drives.rotor_inertia + 0.08 * loop.cascade.k_p * loop.t_ipo)
    curves = FrictionCurve(loop)
    known = curves.inertia_alone(learned(loop, heavier, motion(amplitude=0.05)))
    assert not known.x[:, : TERMS + 1].any()
    assert known.inertia.any()
    q_d = motion()
    knew, fixed, adapted = (off(heavier, feedforward, q_d) for feedforward in (
        Inverse(heavier), Inverse(loop), AdaptedIdeal(Inverse(loop), curve=curves, known_curve=known)))
    assert adapted - knew < 0.35 * (fixed - knew), (knew, fixed, adapted)


@pytest.mark.parametrize(("true", "least"), [(sticky(plant()), 0.6), (plant(), 1.03)], ids=["sticky", "as modelled"])
def test_with_the_curve_the_arm_is_where_it_should_be(true: Loop, least: float) -> None:
    """And an arm as the model has it is moved no worse."""
    loop, q_d = plant(), motion(amplitude=0.05)
    curve = AdaptedIdeal(Inverse(loop), curve=FrictionCurve(loop), known_curve=learned(loop, true, q_d))
    assert off(true, curve, q_d) < least * off(true, Inverse(loop), q_d)


def test_of_another_motion_the_curve_stays_and_the_following_error_does_not() -> None:
    loop = plant()
    known = learned(loop, sticky(loop), motion(amplitude=0.05), repeat=1)
    begun = FrictionCurve(loop).init(known)
    assert np.linalg.norm(begun.x[:, :TERMS] - known.x[:, :TERMS]) < 0.05 * np.linalg.norm(known.x[:, :TERMS])
    assert begun.plans == ()
    assert begun.error is None
    assert not begun.integral.any()
    np.testing.assert_allclose(begun.x[:, TERMS], 0.0, atol=1e-9)


@pytest.mark.parametrize("scale", [np.nan, 1e6, -1.0, 1.001])
def test_motor_angles_that_cannot_be_leave_it_bounded(scale: float) -> None:
    loop = plant()
    known = learned(loop, loop, motion(), repeat=1, scale=scale)
    assert np.all(np.abs(known.x) <= GATE)
    assert np.all(np.linalg.eigvalsh(known.covariance) > 0.0)


# Friction from a slow motion's torques: a shape that the law has not, where the motion goes, and nowhere else.

LOW_SPEEDS = np.array([0.01, 0.02, 0.04, 0.08])
"""At which friction is looked at [rad/s]."""


def sticky_and_bent(loop: Loop) -> Loop:
    """The loop with a fifth more dry friction at rest, gone from 0.1 rad/s on, that turns over half the angle."""
    more = 1.0 + 0.2 * np.exp(-((loop.friction.speeds / 0.05) ** 2))
    return loop.changed(sizes=loop.friction.sizes * more[:, None, :, None], distance=0.5 * loop.friction.distance)


def recorded(loop: Loop) -> Recording:
    """Twelve seconds of all joints but the last, back and forth at up to 0.1 rad/s, with noise of the currents."""
    t = T * np.arange(1000)
    moves = np.append(0.1 / np.array([2.1, 2.7, 3.3, 3.9, 4.5]), 0.0)
    q_d = ROBOT.home + moves * (1.0 - np.cos(np.outer(t, [2.1, 2.7, 3.3, 3.9, 4.5, 1.0])))
    done = simulate(loop, q_d)
    noise = 0.005 * loop.cascade.tau_max * np.random.default_rng(5).standard_normal(done.tau.shape)
    return Recording.from_arrays(T * np.arange(len(done.q_m)), q=done.q_m, tau=done.tau + noise)


def at_speeds(loop: Loop) -> Array:
    """Friction at ``LOW_SPEEDS`` over dry friction of the joints ``(4, n)``."""
    friction, dry = loop.friction, plant().friction.dry
    return np.column_stack([np.interp(LOW_SPEEDS, friction.speeds[j], friction.sliding[j, 0]) / dry[j]
                            for j in range(loop.n)])


@pytest.fixture(scope="module")
def found() -> FrictionAtWork:
    loop = plant()
    return friction_at_work(recorded(sticky_and_bent(loop)), loop)


def test_friction_that_falls_with_speed_is_found(found: FrictionAtWork) -> None:
    """The law's own is off by a fifth of dry friction where joints move slowly."""
    loop = plant()
    moving = slice(0, loop.n - 1)
    true = at_speeds(sticky_and_bent(loop))
    before, after = (np.abs(at_speeds(model) - true)[:, moving] for model in (loop, found.in_loop(loop)))
    assert before.max() > 0.18
    assert np.sqrt(np.mean(after**2, axis=0)).max() < 0.3 * np.sqrt(np.mean(before**2, axis=0)).min()


def test_the_angle_over_which_friction_turns_is_found(found: FrictionAtWork) -> None:
    """Half of what the loop says; of the heavy joints, whose torques the noise leaves clear."""
    assert np.all(found.bend[:3] < 0.75)


def test_a_joint_that_rests_tells_nothing(found: FrictionAtWork) -> None:
    loop = plant()
    np.testing.assert_allclose(at_speeds(found.in_loop(loop))[:, -1], at_speeds(loop)[:, -1], atol=0.01)
    assert found.bend[-1] == 1.0


def test_friction_as_identified_stays() -> None:
    loop = plant()
    same = friction_at_work(recorded(loop), loop).in_loop(loop)
    np.testing.assert_allclose(at_speeds(same), at_speeds(loop), atol=0.03)


def test_methods_are_made_with_it(found: FrictionAtWork) -> None:
    model = model_at("shipped", ROBOT)
    plain = Setting(ROBOT, model, 20).loop()
    other = Setting(ROBOT, model, 20, friction=found).loop()
    np.testing.assert_array_equal(other.friction.sizes, found.in_loop(plain).friction.sizes)
    assert not np.allclose(other.friction.sizes, plain.friction.sizes)


def test_a_recording_without_torques_is_refused() -> None:
    loop = plant()
    q = np.tile(ROBOT.home, (400, 1)) + 0.01 * np.sin(np.arange(400) * T)[:, None]
    with pytest.raises(InputError, match="torques"):
        friction_at_work(Recording.from_arrays(T * np.arange(400), q=q), loop)
    with pytest.raises(InputError, match="joints"):
        friction_at_work(Recording.from_arrays(T * np.arange(400), q=q[:, :3], tau=q[:, :3]), loop)


def test_ripple_that_the_loop_knows_is_no_friction() -> None:
    """Two thirds of dry friction, over three of its periods at most: taken for friction it bends the curve."""
    loop = plant()
    waves = np.stack([np.full(loop.n, 25.0), 0.6 * loop.friction.dry, 0.3 * loop.friction.dry])[None]
    rippled = loop.changed(ripple=waves)
    same = friction_at_work(recorded(rippled), rippled).in_loop(rippled)
    moving = slice(0, loop.n - 1)
    np.testing.assert_allclose(at_speeds(same)[:, moving], at_speeds(loop)[:, moving], atol=0.03)
