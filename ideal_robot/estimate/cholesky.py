"""Solves small symmetric positive definite systems in compiled code: A = L Lᵀ, in place.

Systems in a control cycle are small (joints, a pose, a window's fit), for which a call of LAPACK costs more than its
arithmetic. Elsewhere SciPy is used.
"""

from __future__ import annotations

import math

from ideal_robot.arrays import Array
from ideal_robot.jit import jit


@jit()
def factor(A: Array) -> bool:
    """Writes L into the lower half of ``A (n, n)``; False, with ``A`` overwritten, where it is not positive definite.

    Only the lower half of ``A`` is read. With NaN in ``A`` it returns False.
    """
    for i in range(len(A)):
        for j in range(i + 1):
            left = A[i, j]
            for k in range(j):
                left -= A[i, k] * A[j, k]
            if j < i:
                A[i, j] = left / A[j, j]
            elif left <= 0.0:
                return False
            else:
                A[i, i] = math.sqrt(left)
    return True


@jit()
def solve(L: Array, b: Array) -> None:
    """Writes A⁻¹ b into ``b (n,)``, with L in the lower half of ``L (n, n)`` from ``factor``."""
    n = len(b)
    for i in range(n):
        for j in range(i):
            b[i] -= L[i, j] * b[j]
        b[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            b[i] -= L[j, i] * b[j]
        b[i] /= L[i, i]


@jit()
def inverse(L: Array, out: Array) -> None:
    """Writes A⁻¹ into ``out (n, n)``, with L in the lower half of ``L (n, n)`` from ``factor``."""
    for i in range(len(L)):
        for j in range(len(L)):
            out[i, j] = 1.0 if i == j else 0.0
        # Symmetric: a row is a column.
        solve(L, out[i])
