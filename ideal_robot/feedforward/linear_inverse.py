"""Feedforward by the inverse of the linear closed loop: a filter over the horizon, exact for no path, close for all.

The command is a weighted sum of desired positions before and ahead of now,

    q_c(k) = q_d(k) + Σ_l r(l) (q_d(k + l) - q_d(k)) ,   l = -past … n_d - 1                       [G] (12)

with weights such that loop and filter together come as close to passing smooth paths unchanged as the regularisation
allows. The horizon makes this work for systems that are not minimum phase, whose causal inverse would grow without
bound ([G] 4.2.1).
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.information_filter import InformationFilter


class LinearInverse(Feedforward):
    """Preview filter that inverts a :class:`LinearLoop`.

    Args:
        loop: the linear closed loops.
        n_d: horizon; has to cover delay and rise of the loop.
        past: desired positions of cycles before now that are used too.
        bandwidth: desired paths have this corner frequency [Hz]; above it the inverse need not be right.
        regularisation: error of the answer, relative to the path, that is as bad as weights of size 1.
        limits: lowest and highest command ``(n,)`` each [rad]; None for none.
    """

    def __init__(self, loop: LinearLoop, n_d: int = 30, *, past: int = 8, bandwidth: float = 3.0,
                 regularisation: float = 1e-2, limits: tuple[Array, Array] | None = None) -> None:
        self.t_ipo, self.n_d, self.past, self._limits = loop.t_ipo, n_d, past, limits
        self.weights = np.column_stack([
            _preview_weights(loop.g[:, i], past, n_d, bandwidth * loop.t_ipo, regularisation) for i in range(loop.n)])

    def init(self, q0: Array) -> Array:
        """See ``Feedforward.init``."""
        return np.tile(np.asarray(q0, dtype=float), (self.past, 1))

    def step(self, state: Array, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, Array]:
        """See ``Feedforward.step``."""
        rows = np.concatenate([state, q_d[: self.n_d]])
        if len(q_d) < self.n_d:
            rows = held(rows, after=self.n_d - len(q_d))
        q_c = q_d[0] + np.sum(self.weights * (rows - q_d[0]), axis=0)
        if self._limits is not None:
            q_c = np.clip(q_c, *self._limits)
        return q_c, np.concatenate([state[1:], q_d[:1]])


def _preview_weights(g: Array, past: int, n_d: int, corner: float, regularisation: float) -> Array:
    """Weights ``r(-past … n_d - 1)`` of one joint; that of ``l = 0`` is 0, it multiplies nothing."""
    count = past + n_d
    # Loop and filter in series, written over lags: row j is the weight of q_d(k - j) in q_a(k).
    lags = np.arange(-(n_d - 1), past + len(g))
    series = np.zeros((len(lags), count))
    for column, ahead in enumerate(range(-past, n_d)):
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
    # Weights act on differences to q_d(k), so each moves weight from lag 0 of the direct path.
    smooth_direct, smooth_wanted = np.convolve(direct, shape), np.convolve(wanted, shape)
    moves = smooth - smooth_direct[:, None]
    estimate = InformationFilter(count)
    estimate.update(moves, smooth_wanted - smooth_direct, regularisation * float(np.linalg.norm(smooth_wanted)))
    # Constant velocity and constant acceleration shall pass without error: first and second moment of the whole.
    for order in (1, 2):
        moment = lags.astype(float) ** order / 10.0**order
        row, left = moment @ (series - direct[:, None]), -moment @ direct
        estimate.update(row[None], np.array([left]), 1e-3 * regularisation)
    estimate.update(np.eye(count), np.zeros(count), 1.0)
    weights = estimate.solve()
    weights[past] = 0.0
    return np.asarray(weights)
