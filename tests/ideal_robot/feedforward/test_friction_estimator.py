"""One estimate: what comes row by row says what the batch says, and what is long ago is as it was at first."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.feedforward.friction_estimator import (
    FAR,
    SHAPE,
    SPEEDS,
    WARMING,
    aged,
    counted,
    friction_terms,
    likeness,
    noise_variance,
    remembered,
    solved,
    wandered,
)

P = 7


def rows(rng, count=40):
    """Columns and measurements ``(count, P)``, ``(count,)``."""
    columns, true = rng.normal(size=(count, P)), rng.normal(size=P)
    return columns, columns @ true + 0.3 * rng.normal(size=count)


def counted_all(columns, left, wait=0.0):
    """Parameters and covariance, with a time before each row [s]."""
    x, covariance = np.zeros(P), np.eye(P)
    for h, y in zip(columns, left, strict=True):
        aged(x, covariance, wandered(wait))
        assert counted(x, covariance, h, y, 0.09)
    return x, covariance


def test_row_by_row_it_is_the_batch():
    columns, left = rows(np.random.default_rng(1))
    x, covariance = counted_all(columns, left)
    batch = solved(columns / 0.3, left / 0.3)
    np.testing.assert_allclose(x, batch.x, rtol=1e-9)
    np.testing.assert_allclose(covariance, batch.covariance, atol=1e-12)


def test_on_the_way_parameters_wander_as_said():
    """The batch of a walk: rows far apart in time are of parameters that correlate by what is left."""
    columns, left = rows(np.random.default_rng(2), count=12)
    wait = 60.0
    steps = np.abs(np.subtract.outer(np.arange(12), np.arange(12)))
    prior = wandered(wait) ** steps
    signal = prior * (columns @ columns.T)
    x = columns.T @ (prior[-1] * np.linalg.solve(signal + 0.09 * np.eye(12), left))
    np.testing.assert_allclose(counted_all(columns, left, wait)[0], x, rtol=1e-9)


def test_what_was_learned_long_ago_is_as_uncertain_as_at_first():
    x, covariance = counted_all(*rows(np.random.default_rng(3)))
    aged(x, covariance, wandered(20.0 * WARMING))
    np.testing.assert_allclose(x, 0.0, atol=1e-7)
    np.testing.assert_allclose(covariance, np.eye(P), atol=1e-7)


def test_what_is_too_far_changes_nothing():
    x, covariance, h = np.zeros(P), np.eye(P), np.ones(P)
    edge = FAR * np.sqrt(0.09 + P)
    for y in (1.01 * edge, -1.01 * edge, np.inf, np.nan):
        assert not counted(x, covariance, h, y, 0.09)
    assert not x.any()
    np.testing.assert_array_equal(covariance, np.eye(P))
    assert counted(x, covariance, h, 0.99 * edge, 0.09)


def test_parameters_stay_within_their_bounds():
    x, covariance, h = np.zeros(P), np.eye(P), np.zeros(P)
    for _ in range(1000):
        h[0] = 1.0
        counted(x, covariance, h, 4.1, 0.09)
    assert x[0] == FAR


def test_what_is_remembered_of_some_parameters_is_their_marginal():
    """Mean and covariance of those that are kept, as if the others had never been asked for."""
    x, covariance = counted_all(*rows(np.random.default_rng(3)))
    places, others = np.array([1, 4, 5]), np.array([0, 2, 3, 6])
    kept, uncertain = remembered(x[None], covariance[None], places)
    np.testing.assert_array_equal(kept[0, places], x[places])
    np.testing.assert_array_equal(uncertain[0][np.ix_(places, places)], covariance[np.ix_(places, places)])
    assert not kept[0, others].any()
    np.testing.assert_array_equal(uncertain[0][np.ix_(others, others)], np.eye(4))
    assert not uncertain[0][np.ix_(others, places)].any()


def test_the_curve_is_as_uncertain_as_said():
    """Of its components' variance hardly any is left out, between the nodes as at them."""
    at_nodes = friction_terms(SPEEDS)[:, 2:]
    np.testing.assert_allclose(at_nodes @ at_nodes.T, SHAPE**2 * likeness(), atol=0.004 * SHAPE**2)
    between = friction_terms(np.array([0.5 * (SPEEDS[3] + SPEEDS[4]), 1.3]))
    np.testing.assert_allclose(between[0, 2:], 0.5 * (at_nodes[3] + at_nodes[4]))
    np.testing.assert_allclose(between[1, 2:], at_nodes[-1])
    np.testing.assert_allclose(friction_terms(SPEEDS)[:, :2], np.column_stack([np.ones(len(SPEEDS)), np.sqrt(SPEEDS)]))


@pytest.mark.parametrize("spacing", [0.004, 0.012, 0.048])
def test_samples_that_are_nearer_say_no_more(spacing):
    dry = np.array([100.0, 4.0])
    variance = noise_variance(dry, spacing, np.array([0.0, 3.0]))
    np.testing.assert_allclose(spacing * variance, 0.05 * np.array([15.0, 3.0]) ** 2)
