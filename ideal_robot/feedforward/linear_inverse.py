"""Feedforward by the inverse of the linear closed loop: a filter over the horizon, approximate for every path.

The command is a weighted sum of desired positions before and ahead of now,

    q_c(k) = q_d(k) + Σ_l r(l) (q_d(k + l) - q_d(k)) ,   l = -past … n_d - 1                       [G] (12)

with weights such that loop and filter together come as close to passing smooth paths unchanged as the regularisation
allows. The horizon makes this work for systems that are not minimum phase, whose causal inverse would grow without
bound ([G] 4.2.1).
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import CommandLimits
from ideal_robot.feedforward.training import Windowed
from ideal_robot.loop.impulse_response import LinearLoop, Measurement, least_squares

_PAST, _BANDWIDTH = 8, 3.0
"""Cycles before now that are used too, and corner frequency of desired paths [Hz]: above, the inverse need not be
right."""
_REGULARISATION = 1e-2
"""Error of the answer, relative to the path, that is as bad as weights of size 1."""


class LinearInverse(Windowed):
    """Preview filter that inverts a :class:`LinearLoop`.

    Args:
        loop, n_d: the linear closed loops, and the horizon; it has to cover their delay and rise.
        limits: of commands; None for none.
    """

    def __init__(self, loop: LinearLoop, n_d: int = 30, *, limits: CommandLimits | None = None) -> None:
        self.t_ipo, self.n_d, self.past, self.limits = loop.t_ipo, n_d, _PAST, limits
        self.weights = np.column_stack([_preview_weights(g, n_d, _BANDWIDTH * loop.t_ipo) for g in loop.g.T])

    def weighed(self, rows: Array) -> Array:
        """The command ``(n,)`` [rad] of a window ``(past + n_d, n)`` [rad]; see ``Windowed.weighed``."""
        now = rows[self.past]
        return np.asarray(now + np.sum(self.weights * (rows - now), axis=0))


def _preview_weights(g: Array, n_d: int, corner: float) -> Array:
    """Weights ``r(-_PAST … n_d - 1)`` of one joint; that of ``l = 0`` is 0, it multiplies nothing."""
    count = _PAST + n_d
    # Loop and filter in series, written over lags: row j is the weight of q_d(k - j) in q_a(k).
    lags = np.arange(-(n_d - 1), _PAST + len(g))
    series = np.zeros((len(lags), count))
    for column, ahead in enumerate(range(-_PAST, n_d)):
        start = -ahead - lags[0]
        series[start : start + len(g), column] = g
    direct = np.zeros(len(lags))
    direct[-lags[0] : -lags[0] + len(g)] = g
    wanted = (lags == 0).astype(float)
    # A path of that corner frequency as shaping filter: what smooth paths do not contain costs nothing.
    t = np.arange(-60, 61)
    shape = np.sinc(2 * corner * t) * np.exp(-0.5 * (t * corner * 2.5) ** 2)
    shape /= shape.sum()
    smooth = np.array([np.convolve(column, shape) for column in series.T]).T
    # Weights act on differences to q_d(k), so each one takes its weight from lag 0.
    smooth_direct, smooth_wanted = np.convolve(direct, shape), np.convolve(wanted, shape)
    moves = smooth - smooth_direct[:, None]
    measured = [Measurement(moves, smooth_wanted - smooth_direct,
                            _REGULARISATION * float(np.linalg.norm(smooth_wanted)))]
    # Constant velocity and constant acceleration shall pass without error: first and second moment of the whole.
    for order in (1, 2):
        moment = lags.astype(float) ** order / 10.0**order
        row, target = moment @ (series - direct[:, None]), -moment @ direct
        measured.append(Measurement(row[None], np.array([target]), 1e-3 * _REGULARISATION))
    weights = least_squares(*measured, Measurement(np.eye(count), np.zeros(count), 1.0))
    weights[_PAST] = 0.0
    return np.asarray(weights)
