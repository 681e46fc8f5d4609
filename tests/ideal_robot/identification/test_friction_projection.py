"""One joint's friction with everything else eliminated: the same as fitting everything at once."""

import numpy as np
from scipy import optimize

from ideal_robot.arrays import Array
from ideal_robot.identification.friction_projection import FoldEquations, FrictionProjection

RNG = np.random.default_rng(3)
ROWS = [slice(0, 40), slice(40, 90), slice(90, 120)]
OWN = RNG.standard_normal((120, 5))
OWN[:, 1] = 0.0
"""Rows of the joint: of the five rigid parameters it does not feel the second."""
OTHER = RNG.standard_normal((120, 8))
"""Rows of another joint: the rigid parameters and three of its friction."""
Y, OTHER_Y = RNG.standard_normal(120), RNG.standard_normal(120)
KNOWN = np.diag([0.5, 2.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
F = RNG.standard_normal((120, 3))
FREE = np.zeros(3, dtype=bool)


def projection() -> FrictionProjection:
    folds = []
    for rows in ROWS:
        W = np.vstack([np.column_stack([OWN[rows], np.zeros((len(OWN[rows]), 3))]), OTHER[rows]])
        y = np.concatenate([Y[rows], OTHER_Y[rows]])
        folds.append(FoldEquations(W.T @ W, W.T @ y, float(y @ y)))
    return FrictionProjection(folds, ROWS, KNOWN, OWN, Y)


def stacked(keep: np.ndarray) -> tuple[Array, Array]:
    """All rows with all parameters, and what is known beforehand as rows of its own."""
    W = np.vstack([np.column_stack([OWN, np.zeros((120, 3)), F])[keep],
                   np.column_stack([OTHER, np.zeros((120, 3))])[keep],
                   np.column_stack([np.sqrt(KNOWN), np.zeros((8, 3))])])
    return W, np.concatenate([Y[keep], OTHER_Y[keep], np.zeros(8)])


def test_as_all_at_once() -> None:
    W, y = stacked(np.ones(120, dtype=bool))
    p = np.linalg.lstsq(W, y, rcond=None)[0]
    np.testing.assert_allclose(projection().coefficients(F, FREE), p[8:], rtol=1e-6)
    np.testing.assert_allclose(projection().error(F, FREE), np.sum((y - W @ p) ** 2), rtol=1e-6)


def test_held_out_stretches_are_not_seen() -> None:
    total = 0.0
    for rows in ROWS:
        keep = np.ones(120, dtype=bool)
        keep[rows] = False
        p = np.linalg.lstsq(*stacked(keep), rcond=None)[0]
        total += float(np.sum((Y[rows] - OWN[rows] @ p[:5] - F[rows] @ p[8:]) ** 2))
    np.testing.assert_allclose(projection().held_out(F, FREE), np.sqrt(total / 120), rtol=1e-6)


def test_a_coefficient_that_may_not_be_negative() -> None:
    W, y = stacked(np.ones(120, dtype=bool))
    p = projection().coefficients(F, FREE)
    bounded = p == p.min()
    assert p.min() < 0.0
    lower = np.concatenate([np.full(8, -np.inf), np.where(bounded, 0.0, -np.inf)])
    wanted = optimize.lsq_linear(W, y, (lower, np.full(11, np.inf)), tol=1e-14).x
    np.testing.assert_allclose(projection().coefficients(F, bounded), wanted[8:], rtol=1e-5, atol=1e-7)
