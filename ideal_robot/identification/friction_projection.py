"""Fit of one joint's friction together with everything else, of which only what concerns that joint is kept.

Candidates for a joint's friction change few columns in the rows of that joint alone. All other parameters are
eliminated once by Cholesky's decomposition, those that the joint's rows do not hold first; of the normal equations of a
candidate then only its own few are left (Schur complement).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from ideal_robot.arrays import Array

_RIDGE = 1e-9


@dataclass(frozen=True)
class FoldEquations:
    """Normal equations of one stretch of time, weighted, without the friction of the joint that is looked at.

    Attributes:
        gram: ``WᵀW`` ``(P, P)``.
        side: ``Wᵀy`` ``(P,)``.
        square: ``yᵀy``.
    """

    gram: Array
    side: Array
    square: float


@dataclass(frozen=True)
class _Moments:
    """Products of a candidate's columns F over some rows: with those of the joint, with each other, with the torque."""

    own: Array
    gram: Array
    side: Array

    def less(self, other: _Moments) -> _Moments:
        return _Moments(self.own - other.own, self.gram - other.gram, self.side - other.side)


@dataclass(frozen=True)
class _Eliminated:
    """What is left when all but a candidate's coefficients are eliminated.

    Attributes:
        root: Cholesky's factor of the joint's own parameters, all others eliminated before ``(b, b)``.
        side: right-hand side of these, divided by the factor ``(b,)``.
        rest: sum of squares that is left without the candidate.
    """

    root: Array
    side: Array
    rest: float

    @classmethod
    def of(cls, gram: Array, side: Array, square: float, own: int) -> _Eliminated:
        """Eliminates all parameters; the joint's ``own`` come last."""
        gram = gram.copy()
        gram.flat[:: len(gram) + 1] += _RIDGE * np.maximum(np.diag(gram), 1e-9)
        root = linalg.cholesky(gram, lower=True)
        z = linalg.solve_triangular(root, side, lower=True)
        first = len(side) - own
        return cls(np.asfortranarray(root[first:, first:]), z[first:], square - float(z @ z))

    def solved(self, moments: _Moments, bounded: np.ndarray) -> tuple[Array, Array, float]:
        """A candidate's coefficients ``(m,)``, the joint's own parameters ``(b,)`` and the sum of squares left.

        Bounded coefficients that want to be negative are zero, worst first.
        """
        passed, _ = linalg.lapack.dtrtrs(self.root, moments.own, lower=1)
        gram = moments.gram - passed.T @ passed
        gram.flat[:: len(gram) + 1] += _RIDGE * np.maximum(np.diag(moments.gram), 1e-9)
        side = moments.side - passed.T @ self.side
        free = np.ones(len(side), dtype=bool)
        p = np.linalg.solve(gram, side)
        while np.any(p[bounded] < 0.0):
            free[np.argmin(np.where(bounded, p, 0.0))] = False
            p = np.zeros(len(side))
            p[free] = np.linalg.solve(gram[np.ix_(free, free)], side[free])
        own, _ = linalg.lapack.dtrtrs(self.root, self.side - passed @ p, lower=1, trans=1)
        return p, own, self.rest - float(side @ p)


class FrictionProjection:
    """Everything but one joint's friction, as normal equations fold by fold, and that joint's own rows.

    Args:
        folds: normal equations of each stretch; in the parameters' order of ``own``.
        rows: of each stretch.
        known: what is known of the parameters beforehand, as an inverse covariance ``(P, P)``.
        own: the joint's rows of the rigid parameters, which are the first of all ``(M, b)``.
        y: the joint's torque ``(M,)``.
    """

    def __init__(self, folds: Sequence[FoldEquations], rows: Sequence[slice], known: Array, own: Array,
                 y: Array) -> None:
        felt = own.any(axis=0)
        self._own, self._y, self._rows = np.ascontiguousarray(own[:, felt].T), np.ascontiguousarray(y), rows
        here = np.flatnonzero(felt)
        order = np.concatenate([np.setdiff1d(np.arange(len(known)), here), here])
        self._folds = [FoldEquations(fold.gram[np.ix_(order, order)], fold.side[order], fold.square) for fold in folds]
        self._known = known[np.ix_(order, order)]

    def _eliminated(self, folds: Sequence[FoldEquations]) -> _Eliminated:
        return _Eliminated.of(self._known + np.sum([fold.gram for fold in folds], axis=0),
                              np.sum([fold.side for fold in folds], axis=0), sum(fold.square for fold in folds),
                              len(self._own))

    @cached_property
    def _all(self) -> _Eliminated:
        return self._eliminated(self._folds)

    @cached_property
    def _without(self) -> list[_Eliminated]:
        """With each of the folds left out."""
        return [self._eliminated([*self._folds[:k], *self._folds[k + 1 :]]) for k in range(len(self._folds))]

    def _moments(self, F: Array, rows: slice) -> _Moments:
        F = F[rows]
        return _Moments(self._own[:, rows] @ F, F.T @ F, F.T @ self._y[rows])

    def error(self, F: Array, bounded: np.ndarray) -> float:
        """Sum of squares of the full fit with this friction regressor ``(M, m)``; ``bounded (m,)`` not negative."""
        F, _ = _scaled(F)
        return self._all.solved(self._moments(F, slice(None)), bounded)[2]

    def coefficients(self, F: Array, bounded: np.ndarray) -> Array:
        """Those of this joint's law ``(m,)`` in the full fit."""
        F, size = _scaled(F)
        return self._all.solved(self._moments(F, slice(None)), bounded)[0] / size

    def held_out(self, F: Array, bounded: np.ndarray) -> float:
        """Standard deviation of the joint's residual on folds that the fit has not seen."""
        F, _ = _scaled(F)
        every, total = self._moments(F, slice(None)), 0.0
        for rows, others in zip(self._rows, self._without, strict=True):
            p, own, _ = others.solved(every.less(self._moments(F, rows)), bounded)
            left = self._y[rows] - own @ self._own[:, rows] - F[rows] @ p
            total += float(left @ left)
        return float(np.sqrt(total / len(self._y)))


def _scaled(F: Array) -> tuple[Array, Array]:
    """Columns of unit length, and what they were."""
    size = np.maximum(np.sqrt(np.einsum("km,km->m", F, F)), 1e-12)
    return F / size, size
