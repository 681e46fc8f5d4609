"""Linear closed loops: identified, predicted, inverted, also where the inverse would be unstable."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.feedforward.linear_inverse import LinearInverse
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.information_filter import InformationFilter
from ideal_robot.loop.simulation import simulate
from tests.ideal_robot.feedforward.plant import ROBOT, T, commands, motion, plant, rms


def first_order(pole: float, delay: int, n: int = 1, length: int = 40) -> LinearLoop:
    g = np.zeros((length + 1, n))
    g[delay:] = ((1 - pole) * pole ** np.arange(length + 1 - delay))[:, None]
    return LinearLoop(g / g.sum(axis=0), T)


def test_identification_finds_a_known_response():
    true = first_order(0.6, 2)
    rng = np.random.default_rng(1)
    t = np.arange(800) * T
    q_c = (0.3 * np.sin(2 * np.pi * 0.5 * t) + 0.05 * np.sin(2 * np.pi * 4 * t**1.2))[:, None]
    q = true.predict(q_c) + rng.normal(scale=1e-5, size=q_c.shape)
    found = LinearLoop.identify(q_c, q, T, delay=2, prior=1e-4)
    t_new = np.arange(300) * T
    other = (0.2 * np.sin(2 * np.pi * 1.1 * t_new))[:, None]
    assert rms(found.predict(other) - true.predict(other)) < 5e-4


def test_identification_refuses_a_joint_at_rest_and_short_motions():
    with pytest.raises(InputError, match="hardly moves"):
        LinearLoop.identify(np.zeros((100, 1)), np.zeros((100, 1)), T)
    with pytest.raises(InputError, match="more than"):
        LinearLoop.identify(np.zeros((10, 1)), np.zeros((10, 1)), T)


def test_linearised_loop_predicts_the_loop_without_friction():
    loop = plant(friction=0.0)
    q_d = motion(amplitude=0.01)
    linear = LinearLoop.of(loop, q_d[len(q_d) // 2])
    done = simulate(loop, q_d).q_a[:-1]
    moved = done - done[0]
    predicted = linear.predict(q_d) - q_d[0]
    assert rms(predicted - moved) < 0.02 * rms(moved)


def test_matrix_is_the_response_written_out():
    linear = first_order(0.5, 1)
    q_c = np.random.default_rng(0).normal(size=(30, 1))
    q_c[0] = 0.0
    np.testing.assert_allclose(linear.matrix(0, 30, 30) @ q_c[:, 0], linear.predict(q_c)[:, 0], atol=1e-12)


@pytest.mark.parametrize("zero", [0.5, 1.8])
def test_the_inverse_is_bounded_and_right_for_any_phase(zero):
    """A zero outside the unit circle (1.8) makes the causal inverse grow by 1.8 every cycle."""
    base = first_order(0.6, 1).g[:, 0]
    g = np.convolve(base, [1.0, -zero])[:41]
    linear = LinearLoop((g / g.sum())[:, None], T)
    t = np.arange(200) * T
    ramp = np.clip(t - 0.4, 0, 1.2) / 1.2
    q_d = (0.4 * ramp**3 * (10 - 15 * ramp + 6 * ramp**2))[:, None]
    q_c = commands(LinearInverse(linear, 30), q_d)
    assert np.max(np.abs(q_c)) < 1.0
    assert rms(linear.predict(q_c) - q_d) < 0.05 * rms(linear.predict(q_d) - q_d)


def test_it_takes_the_lag_off_the_arm():
    loop, q_d = plant(), motion()
    q_c = commands(LinearInverse(LinearLoop.of(loop, ROBOT.home)), q_d)
    left, before = (rms(simulate(loop, commanded).q_a[:-1] - q_d) for commanded in (q_c, q_d))
    assert left < 0.3 * before


def test_information_filter_is_least_squares_and_order_does_not_matter():
    rng = np.random.default_rng(4)
    H, x = rng.normal(size=(50, 5)), rng.normal(size=5)
    z = H @ x + rng.normal(scale=0.1, size=50)
    all_at_once, piecewise = InformationFilter(5), InformationFilter(5)
    all_at_once.update(H, z, 0.1)
    for k in rng.permutation(50):
        piecewise.update(H[k : k + 1], z[k : k + 1], 0.1)
    np.testing.assert_allclose(all_at_once.solve(), np.linalg.lstsq(H, z, rcond=None)[0], atol=1e-10)
    np.testing.assert_allclose(piecewise.solve(), all_at_once.solve(), atol=1e-10)


def test_information_filter_without_information_says_zero():
    np.testing.assert_array_equal(InformationFilter(3).solve(), np.zeros(3))
