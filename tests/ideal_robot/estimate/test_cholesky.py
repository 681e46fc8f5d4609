"""The compiled solution of small systems is SciPy's, and says where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from ideal_robot.estimate.cholesky import factor, inverse, solve


@pytest.mark.parametrize("n", [1, 2, 5, 7])
@pytest.mark.parametrize("seed", range(4))
def test_systems_are_solved_as_by_scipy(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    root, scale = rng.standard_normal((n, n)), 10.0 ** rng.uniform(-2.0, 2.0, n)
    A, b = scale[:, None] * (root @ root.T + 0.1 * np.eye(n)) * scale, rng.standard_normal(n)
    # The upper half is not read.
    L, x, whole = np.tril(A) + np.triu(np.full((n, n), np.nan), 1), b.copy(), np.empty((n, n))
    assert factor(L)
    np.testing.assert_allclose(np.tril(L) / scale[:, None], linalg.cholesky(A, lower=True) / scale[:, None], atol=1e-12)
    solve(L, x)
    inverse(L, whole)
    expected = linalg.solve(A, b, assume_a="pos")
    np.testing.assert_allclose(x * scale, expected * scale, atol=1e-9 * np.max(np.abs(expected * scale)))
    np.testing.assert_allclose(scale[:, None] * whole * scale, np.linalg.inv(A / scale / scale[:, None]), atol=1e-9)


def test_what_is_not_positive_definite_is_said() -> None:
    assert not factor(np.array([[1.0, 2.0], [2.0, 1.0]]))
    assert not factor(np.zeros((3, 3)))
