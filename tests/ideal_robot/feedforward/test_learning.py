"""Learning: it converges where its model is fair, stops where it is not, and never ends worse than it began."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.learning import LearningLaw, Playback, learn, learn_on_model
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.simulation import simulate
from tests.ideal_robot.feedforward.plant import ROBOT, T, commands, motion, plant, rms


def player(loop, q_d):
    return lambda q_c: q_d - simulate(loop, q_c).q_a[:-1]


@pytest.mark.parametrize("inverse", ["least_squares", "butterworth"])
def test_four_iterations_leave_little(inverse):
    loop, q_d = plant(), motion()
    law = LearningLaw(LinearLoop.of(plant(inertia=1.1, friction=0.8), ROBOT.home), len(q_d), inverse=inverse)
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
    start = commands(IdealRobot(loop), q_d)
    done = learn_on_model(loop, q_d, start)
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


def check_trials(seeds) -> None:
    results = np.array([poor_trial(seed) for seed in seeds])
    # 1e-6 rad: two plays that differ by less than the noise's own effect on the criterion count as equal.
    assert np.all(results[:, 1] <= results[:, 0] + 1e-6)
    assert np.median(results[:, 1] / results[:, 0]) < 0.5


def test_poor_models_never_end_worse_in_twelve_trials():
    check_trials(range(12))


@pytest.mark.slow
def test_poor_models_never_end_worse_in_a_hundred_trials():
    check_trials(range(100))


def test_divergence_is_noticed_and_stops():
    loop, q_d = plant(), motion()
    good = LinearLoop.of(loop, ROBOT.home)
    wrong_way = LearningLaw(LinearLoop(-good.g, T), len(q_d))
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
    done = learn(player(loop, q_d), q_d, law, limits=(low, high), step_max=step)
    for q_c in done.kept:
        assert np.all((q_c >= low) & (q_c <= high))
        assert np.all(np.abs(np.diff(q_c, axis=0)) <= step * (1 + 1e-9))


def test_law_and_path_must_fit():
    law = LearningLaw(LinearLoop.of(plant(), ROBOT.home), 100)
    with pytest.raises(InputError, match="100 cycles"):
        learn(lambda q_c: q_c, motion(), law)
    with pytest.raises(InputError, match="least_squares or butterworth"):
        LearningLaw(LinearLoop.of(plant(), ROBOT.home), 100, inverse="chebyshev")


def test_playback_plays_and_holds():
    q_c = motion()
    playback = Playback(q_c, T)
    assert playback.t_ipo == T
    played = commands(playback, np.zeros((len(q_c) + 5, 6)))
    np.testing.assert_array_equal(played[: len(q_c)], q_c)
    np.testing.assert_array_equal(played[-1], q_c[-1])
