"""Regions of a motion: samples at angles and velocities that are alike."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array

_HALVINGS = 3


def regions_of_motion(q: Array, qd: Array) -> list[np.ndarray]:
    """Rows of each of eight regions, with as many samples in each.

    Every region is halved at the median of the angle or velocity that varies most in it, over what that varies by in
    all of the motion. What a motion repeats is in one region, however often it is repeated.

    Args:
        q: angles ``(M, n)`` [rad, m].
        qd: velocities ``(M, n)`` [rad/s, m/s].
    """
    state = np.hstack([q, qd])
    state = state / np.maximum(np.std(state, axis=0), 1e-12)
    regions = [np.arange(len(state))]
    for _ in range(_HALVINGS):
        halves = []
        for rows in regions:
            widest = int(np.argmax(np.std(state[rows], axis=0))) if len(rows) else 0
            order = rows[np.argsort(state[rows, widest], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        regions = halves
    return regions
