"""Training: a feedforward fitted to what learning found on some paths, for use on others, [G] (12), (13).

    q_c(k) = base(k) + Σ_l r(l) (q_d(k + l) - q_d(k))
                     + Σ_l s(l) (sign(q̇_d(k + l)) - sign(q̇_d(k)))

With the plain desired position as base this is [G] (13), without the second sum (12). With another feedforward as base
(nonlinear precorrection, or the whole ideal robot) it learns only what that one leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.information_filter import InformationFilter
from ideal_robot.feedforward.passthrough import PassThrough
from ideal_robot.interface import Array

_STILL = 2e-3
"""Speed at which the sign terms have turned over [rad/s]; a bare sign would chatter on the noise of a resting path."""


@dataclass(frozen=True)
class Lags:
    """Which neighbours in time the sums run over.

    Attributes:
        past, ahead: desired positions of so many cycles before and after now, ``m_1 = -past`` and ``m = ahead``.
        sign_past, sign_ahead: signs of velocity likewise; both 0 for [G] (12).
    """

    past: int = 10
    ahead: int = 14
    sign_past: int = 10
    sign_ahead: int = 6

    @property
    def before(self) -> int:
        """Desired positions of the past that are needed: velocities are backward differences."""
        return max(self.past, self.sign_past) + 1

    @property
    def n_d(self) -> int:
        """Length of the horizon that is needed."""
        return max(self.ahead, self.sign_ahead) + 1


class Trained(Feedforward):
    """Decoupled trained feedforward controllers.

    Args:
        r: weights of the positions ``(past + ahead, n)``.
        s: weights of the signs ``(sign_past + sign_ahead, n)`` [rad].
        lags: what the rows belong to, in ascending order of ``l`` without 0.
        t_ipo: cycle [s].
        base: what the sums are added to.
        limits: lowest and highest command ``(n,)`` each [rad].
    """

    def __init__(self, r: Array, s: Array, lags: Lags, t_ipo: float, *, base: Feedforward | None = None,
                 limits: tuple[Array, Array] | None = None) -> None:
        self.base = PassThrough(t_ipo) if base is None else base
        self.r, self.s, self.lags, self.t_ipo = r, s, lags, t_ipo
        self.n_d = max(lags.n_d, self.base.n_d)
        self._limits = limits

    def init(self, q0: Array) -> tuple[Array, Any]:
        return np.tile(np.asarray(q0, dtype=float), (self.lags.before, 1)), self.base.init(q0)

    def step(self, state: tuple[Array, Any], q_d: Array, tau_ext_d: Array | None = None
             ) -> tuple[Array, tuple[Array, Any]]:
        past, inner = state
        q_c, inner = self.base.step(inner, q_d, tau_ext_d)
        rows = np.concatenate([past, q_d[: self.lags.n_d]])
        if len(q_d) < self.lags.n_d:
            rows = np.concatenate([rows, np.tile(q_d[-1], (self.lags.n_d - len(q_d), 1))])
        positions, signs = _regressors(rows[None], self.lags, self.t_ipo)
        q_c = q_c + np.sum(self.r * positions[0], axis=0) + np.sum(self.s * signs[0], axis=0)
        if self._limits is not None:
            q_c = np.clip(q_c, *self._limits)
        return q_c, (np.concatenate([past[1:], q_d[:1]]), inner)


def train(paths: Sequence[tuple[Array, Array]], t_ipo: float, *, lags: Lags | None = None,
          base: Feedforward | None = None, noise: float = 2e-5, limits: tuple[Array, Array] | None = None) -> Trained:
    """Fits the weights of [G] (12) or (13) to learned commands, by least squares in information form.

    Args:
        paths: pairs of desired positions and learned commands, each ``(N, n)`` [rad], all from rest.
        t_ipo: cycle [s].
        lags: structure; default is [G] (13).
        base: feedforward that gave the commands learning started from; the desired positions if None.
        noise: learned commands are believed to this [rad]; small weights are preferred within it.
        limits: passed on to the trained feedforward.

    Raises:
        InputError: no path, or commands and desired positions of different shape.
    """
    lags = Lags() if lags is None else lags
    if not paths or any(q_d.shape != q_c.shape for q_d, q_c in paths):
        raise InputError("expected at least one pair of desired positions and commands of the same shape",
                         field="paths", value=[(q_d.shape, q_c.shape) for q_d, q_c in paths])
    n = paths[0][0].shape[1]
    count, signs_count = lags.past + lags.ahead, lags.sign_past + lags.sign_ahead
    filters = [InformationFilter(count + signs_count) for _ in range(n)]
    for q_d, q_c in paths:
        padded = np.concatenate([np.tile(q_d[0], (lags.before, 1)), q_d, np.tile(q_d[-1], (lags.n_d, 1))])
        windows = np.stack([padded[k : k + lags.before + lags.n_d] for k in range(len(q_d))])
        positions, signs = _regressors(windows, lags, t_ipo)
        left = q_c - _played(base, q_d) if base is not None else q_c - q_d
        for i in range(n):
            filters[i].update(np.hstack([positions[:, :, i], signs[:, :, i]]), left[:, i], noise)
    weights = np.empty((count + signs_count, n))
    for i in range(n):
        # Prior: position weights of order 1, friction's share of the command of order a milliradian.
        filters[i].update(np.eye(count + signs_count)[:count], np.zeros(count), 1.0)
        filters[i].update(np.eye(count + signs_count)[count:], np.zeros(signs_count), 1e-3)
        weights[:, i] = filters[i].solve()
    return Trained(weights[:count], weights[count:], lags, t_ipo, base=base, limits=limits)


def _regressors(windows: Array, lags: Lags, t_ipo: float) -> tuple[Array, Array]:
    """The differences of (13) for windows ``(N, before + n_d, n)`` in which now is row ``before``."""
    now = lags.before
    ahead = [lag for lag in range(-lags.past, lags.ahead + 1) if lag != 0]
    positions = windows[:, [now + lag for lag in ahead]] - windows[:, [now]]
    speed = np.diff(windows, axis=1) / t_ipo
    sign = np.clip(speed / _STILL, -1.0, 1.0)
    signed = [lag for lag in range(-lags.sign_past, lags.sign_ahead + 1) if lag != 0]
    # Row j of the differences is the velocity at row j + 1.
    signs = sign[:, [now + lag - 1 for lag in signed]] - sign[:, [now - 1]]
    return positions, signs


def _played(base: Feedforward, q_d: Array) -> Array:
    state, commands = base.init(q_d[0]), np.empty_like(q_d)
    padded = np.concatenate([q_d, np.tile(q_d[-1], (base.n_d, 1))])
    for k in range(len(q_d)):
        commands[k], state = base.step(state, padded[k : k + base.n_d])
    return commands
