"""Coming to rest on the planned path when it cannot go on: the path stays, only its time slows down."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array


def stopping_rows(planned: Array, T: float, speed: float, deceleration: float) -> Iterator[Array]:
    r"""Horizons ``(n_d, n)`` for the coming cycles that brake to rest on the path planned so far, without end.

    Time along the path runs at the rate :math:`\dot\sigma`, which falls from 1 to 0 on a smooth cubic within
    :math:`1.5\, v / a`, the time in which the largest deceleration is ``a``; shorter if the plan ends before.

    Args:
        planned: desired joint positions of the coming cycles ``(m, n)`` [rad], first the one due now.
        T: interpolation cycle [s].
        speed: path speed now [m/s].
        deceleration: largest one on the path while braking [m/s²].
    """
    m = len(planned)
    path = CubicSpline(np.arange(m), planned)
    # The rate's mean over the braking time is 1/2.
    length = min(max(1.5 * speed / deceleration / T, 1.0), 2.0 * (m - 1))

    def travelled(cycles: Array) -> Array:
        u = np.clip(cycles / length, 0.0, 1.0)
        # Integral of 1 - 3u² + 2u³.
        return length * (u - u**3 + 0.5 * u**4)

    k = 0
    while True:
        yield np.asarray(path(travelled(k + np.arange(m, dtype=float))))
        k += 1
