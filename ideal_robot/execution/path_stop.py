"""Brings the arm to rest on the planned path: the path is kept, only its time slows down."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array, eased


def stopping_rows(planned: Array, T: float, speed: float, deceleration: float) -> Iterator[Array]:
    r"""Yields horizons ``(n_d, n)`` for the coming cycles that brake to rest on the last plan, without end.

    Time along the path runs at the rate :math:`\dot\sigma`, which falls from 1 to 0 on a smooth cubic within
    :math:`1.5\, v / a`, the time in which the largest deceleration is ``a``; shorter if the plan ends before.

    Args:
        planned: desired joint positions of the coming cycles ``(m, n)`` [rad], first the one due now.
        T: interpolation cycle [s].
        speed, deceleration: path speed now [m/s], and the largest deceleration while braking [m/s²].
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


_STEEPEST = 10.0 / math.sqrt(3.0)
"""Largest acceleration of a quintic from rest to rest, over a way of one in a time of one."""
_SHARE = 0.25
"""Of the joints' accelerations that moving away takes. On the simulated KR 6 the commands of ``contour``, whose
feedforward knows the gears, then have up to 0.8 of the limits."""


def moved_away(horizons: Iterator[Array], way: Array, a_max: Array, T: float) -> Iterator[Array]:
    """Adds to horizons ``(n_d, n)`` a smooth displacement of every joint, complete at the end.

    It begins without a step of the acceleration and uses ``_SHARE`` of the joints' acceleration limits: the rest is for
    braking and for the feedforward.

    Args:
        horizons: of the coming cycles, without end [rad].
        way, a_max: displacement of each joint ``(n,)`` [rad], and its acceleration limit ``(n,)`` [rad/s²].
        T: interpolation cycle [s].
    """
    lasts = max(float(np.sqrt(np.max(_STEEPEST * np.abs(way) / (_SHARE * a_max)))), T)
    for k, rows in enumerate(horizons):
        u = np.minimum((k + 1 + np.arange(len(rows)))[:, None] * T / lasts, 1.0)
        yield rows + eased(u) * way
