"""One set of equations: what comes row by row says what the batch says, and what is forgotten is as it was at first."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.feedforward.friction_estimator import (
    FAR,
    SHAPE,
    SPEEDS,
    counted,
    estimate,
    friction_terms,
    likeness,
    noise_variance,
    remembered,
    solved,
)

P, SHARED = 7, 3
"""Parameters of a joint, and how many of them all joints share."""


def rows(rng, count=40):
    """Columns and measurements of two joints ``(count, P)``, ``(count,)`` each."""
    true = rng.normal(size=P)
    columns = [rng.normal(size=(count, P)) for _ in range(2)]
    return columns, [h @ true + 0.3 * rng.normal(size=count) for h in columns]


def counted_all(columns, left, kept=1.0):
    sums = np.zeros((2, P, P + 1))
    for i in range(2):
        for h, y in zip(columns[i], left[i], strict=True):
            assert counted(sums[i], h, y, 0.09, kept)
    return sums


def test_row_by_row_it_is_the_batch():
    """Two joints with parameters of their own and some that they share, as one set of equations."""
    columns, left = rows(np.random.default_rng(1))
    x = estimate(counted_all(columns, left), SHARED)
    own, whole = P - SHARED, np.zeros((80, 2 * (P - SHARED) + SHARED))
    whole[:40, :own], whole[40:, own : 2 * own] = columns[0][:, :own], columns[1][:, :own]
    whole[:, 2 * own :] = np.vstack(columns)[:, own:]
    batch = solved(whole / 0.3, np.concatenate(left) / 0.3).x
    np.testing.assert_allclose(x[0], np.concatenate([batch[:own], batch[2 * own :]]), rtol=1e-9)
    np.testing.assert_allclose(x[1], batch[own:], rtol=1e-9)


def test_forgetting_is_the_batch_of_rows_that_count_less():
    columns, left = rows(np.random.default_rng(2))
    kept = 0.9
    weight = kept ** (0.5 * np.arange(40)[::-1])
    x = estimate(counted_all(columns, left, kept), 0)
    for i in range(2):
        batch = solved(weight[:, None] * columns[i] / 0.3, weight * left[i] / 0.3).x
        np.testing.assert_allclose(x[i], batch, rtol=1e-9)


def test_what_is_too_far_changes_nothing():
    sums, h = np.zeros((P, P + 1)), np.ones(P)
    edge = FAR * np.sqrt(0.09 + P)
    for y in (1.01 * edge, -1.01 * edge, np.inf, np.nan):
        assert not counted(sums, h, y, 0.09, 1.0)
    assert not sums.any()
    assert counted(sums, h, 0.99 * edge, 0.09, 1.0)


def test_parameters_stay_within_their_bounds():
    sums = np.zeros((1, P, P + 1))
    sums[0, :, :P], sums[0, :, P] = 1e6 * np.eye(P), 1e9
    np.testing.assert_array_equal(estimate(sums, 0), FAR)


def test_what_is_remembered_of_some_parameters_is_their_marginal():
    """Mean and covariance of those that are kept, as if the others had never been asked for."""
    columns, left = rows(np.random.default_rng(3))
    sums, places = counted_all(columns, left), np.array([1, 4, 5])
    kept = remembered(sums, places)
    covariance, after = (np.linalg.inv(np.eye(P) + one[:, :, :P]) for one in (sums, kept))
    np.testing.assert_allclose(after[:, places[:, None], places], covariance[:, places[:, None], places], rtol=1e-9)
    np.testing.assert_allclose(estimate(kept, 0)[:, places], estimate(sums, 0)[:, places], rtol=1e-9)
    others = np.delete(np.arange(P), places)
    assert not estimate(kept, 0)[:, others].any()


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
