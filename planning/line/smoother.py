"""Smooths the deviation at passed places by all later measurements (Rauch, Tung, Striebel)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter

from ideal_robot.arrays import Array
from planning.line.deviation_model import DeviationModel, Stand

LOOKED_BACK = 200
"""Travel steps that are kept for the smoother: 5 m of a line."""


class Passed(NamedTuple):
    """The state before a travel step, its position, and the step."""

    stand: Stand
    x: Array
    P: Array
    F: Array
    Q: Array


def smoothed(model: DeviationModel, passed: Sequence[Passed], kf: KalmanFilter, stand: Stand, s: Array
             ) -> tuple[Array, Array]:
    """The smoothed deviation ``(m, directions)`` [m] and its variance [m²]; NaN before the first step.

    Args:
        model: prior and dynamics of the deviation.
        passed: the travel steps so far, the oldest first.
        kf: the state now.
        stand: position of the present state.
        s: arc lengths ``(m,)`` [m].
    """
    stands = [step.stand for step in passed] + [stand]
    xs, Ps, *_ = kf.rts_smoother(
        np.array([step.x for step in passed] + [kf.x]), np.array([step.P for step in passed] + [kf.P]),
        # Transition matrices and noise of the steps that end in each state.
        [kf.F] + [step.F for step in passed], [kf.Q] + [step.Q for step in passed],
        inv=_inverse)
    mean, variance = np.full((2, len(s), model.directions), np.nan)
    which = np.searchsorted([one.begin for one in stands], s, side="right") - 1
    for k in np.unique(which[which >= 0]):
        H = model.basis(s[which == k], stands[k])
        mean[which == k] = H @ xs[k][: model.size]
        P = Ps[k][: model.size, : model.size]
        variance[which == k] = np.einsum("mdi,ij,mdj->md", H, P, H)
    return mean, variance


def _inverse(P: Array) -> Array:
    """Inverse of a covariance; the pseudo-inverse where a state is known exactly, as an error that no sensor has."""
    try:
        return np.asarray(np.linalg.inv(P))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(P, hermitian=True))
