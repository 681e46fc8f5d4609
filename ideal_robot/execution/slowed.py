"""Slows a joint path along itself where its commands leave a limit of the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline
from scipy.ndimage import minimum_filter1d

from ideal_robot.arrays import Array
from ideal_robot.errors import LimitError
from ideal_robot.execution.command_limits import check_limits
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import SLOWED_BESIDES, SLOWINGS

_REACH = 0.25
"""Time on either side of a command that leaves a limit in which the path is slowed [s]: commands are given as much
earlier than the motion that they are for, and the speed changes over that time."""
_SLOWEST = 0.05
"""Share of the path's speed below which it is not slowed: there the limit is not one of speed."""


@dataclass(frozen=True)
class SlowedPath:
    """A path slowed into the limits.

    Attributes:
        q_d, q_c: desired and commanded positions at the cycles ``(M, n)`` [rad].
        row: where on the given path each cycle is ``(M,)``, in its rows.
        slowest: smallest share of the given speed.
    """

    q_d: Array
    q_c: Array
    row: Array
    slowest: float


def slowed(q_d: Array, correct: Callable[[Array], Array], robot: Robot, *, everywhere: bool = False) -> SlowedPath:
    """The path, slowed where it or its commands leave a limit of speed or acceleration.

    Args:
        q_d: desired positions at the cycles, from rest to rest ``(N, n)`` [rad].
        correct: commands ``(M, n)`` [rad] of desired positions ``(M, n)`` [rad].
        robot: limits and cycle.
        everywhere: slow the whole path alike.

    Raises:
        LimitError: no speed is slow enough.
    """
    rows = np.arange(float(len(q_d)))
    spline = make_interp_spline(rows, q_d, k=min(5, len(q_d) - 1))
    reach = max(1, round(_REACH / robot.t_ipo))
    share = np.ones(len(q_d))
    for _ in range(SLOWINGS):
        at = _cycles(_smooth(share, reach))
        path = np.asarray(spline(at))
        q_c = correct(path)
        over = np.maximum(_beyond(path, robot), _beyond(q_c, robot))
        if not np.any(over > 1.0):
            return SlowedPath(path, q_c, at, float(_smooth(share, reach).min()))
        less = np.interp(rows, at, 1.0 / np.where(over > 1.0, SLOWED_BESIDES * over, 1.0))
        # The largest demand between two cycles is kept, so that a single sample is not lost.
        np.minimum.at(less, np.clip(np.round(at).astype(int), 0, len(rows) - 1), 1.0 / np.maximum(over, 1.0))
        share = share * (less.min() if everywhere else minimum_filter1d(less, 2 * reach + 1))
        if share.min() < _SLOWEST:
            break
    check_limits(path, robot, robot.t_ipo)
    check_limits(q_c, robot, robot.t_ipo)
    raise LimitError(0, "share of its speed at which the path would keep the limits", float(share.min()), _SLOWEST,
                     "plan another path")


def _smooth(share: Array, reach: int) -> Array:
    """Shares ``(N,)`` that change over twice ``reach`` rows and are nowhere above those given."""
    window = np.hanning(2 * reach + 3)[1:-1]
    most = 1.0 - minimum_filter1d(share, 2 * reach + 1)
    # Computed on the difference to 1, so that a share of 1 stays exactly 1 despite rounding.
    return np.asarray(1.0 - np.convolve(np.pad(most, reach, mode="edge"), window / window.sum(), mode="valid"))


def _cycles(share: Array) -> Array:
    """Row of the given path at each cycle ``(M,)`` where it is played at a share ``(N,)`` of its speed."""
    if np.all(share == 1.0):
        return np.arange(float(len(share)))
    time = np.concatenate([[0.0], np.cumsum(2.0 / (share[1:] + share[:-1]))])
    # The path's end is reached within the last cycle.
    at = PchipInterpolator(time, np.arange(float(len(share))))(np.arange(np.ceil(time[-1])))
    return np.append(np.clip(at, 0.0, len(share) - 1.0), len(share) - 1.0)


def _beyond(q: Array, robot: Robot) -> Array:
    """Factor by which the speed of each row exceeds what the limits of ``check_limits`` allow ``(N,)``, at least 1."""
    speed = np.diff(q, axis=0) / robot.t_ipo
    bend = np.diff(speed, axis=0) / robot.t_ipo
    over = np.ones(len(q))
    over[1:] = np.maximum(over[1:], np.max(np.abs(speed) / robot.v_max, axis=1))
    over[2:] = np.maximum(over[2:], np.max(np.sqrt(np.abs(bend) / (2.0 * robot.a_max)), axis=1))
    outside = np.any((q < robot.q_min) | (q > robot.q_max), axis=1)
    # A position beyond a limit is caused by the correction, which decreases with speed.
    over[outside] = np.maximum(over[outside], 1.1)
    return over
