"""Postures all over an arm's range, the same ones every time."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from ideal_robot.arrays import Array


def spread_postures(q_min: Array, q_max: Array, count: int = 128) -> Array:
    """Halton points ``(count, n)`` between the limits; of joints that turn further, half a turn to either side.

    Args:
        q_min: lower position limits ``(n,)`` [rad or m].
        q_max: upper position limits ``(n,)`` [rad or m].
        count: how many.
    """
    low, high = np.clip(q_min, -np.pi, np.pi), np.clip(q_max, -np.pi, np.pi)
    return np.asarray(low + qmc.Halton(len(low), scramble=False).random(count) * (high - low))
