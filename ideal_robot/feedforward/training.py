"""Training: fits a feedforward to learned commands of some paths, for use on others, [G] (12), (13).

    q_c(k) = base(k) + Σ_l r(l) (q_d(k + l) - q_d(k))
                     + Σ_l s(l) (sign(q̇_d(k + l)) - sign(q̇_d(k)))
                     + Σ_l w(l) τ_d(k + l)

With the plain desired position as base the first two sums are [G] (13), the first alone (12). These are decoupled, so
couplings between links are lost on them ([G] 4.3 sees it on the edge); the third sum adds each joint's rigid-body
torque, by which couplings and the gears' deflection can be learned linearly. With another feedforward as base, such as
the ideal robot, training learns only its residual.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.dynamics.newton_euler import Chain, inverse_dynamics
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import CommandLimits, Feedforward
from ideal_robot.loop.impulse_response import Measurement, least_squares

_SIGN_SPEED = 2e-3
"""Speed at which the sign terms have turned over [rad/s]; a bare sign would chatter on the noise of a resting path."""
_NOISE = 5e-4
"""Learned commands are believed to this [rad]; small weights are preferred within it."""
REVERSAL = (0.288, 0.06)
"""How long after and before a reversal its sign counts [s]: the controller's integrator needs some 0.3 s to settle."""


@dataclass(frozen=True)
class Lags:
    """Ranges of past and future samples in the sums of the trained feedforward, [G] (12).

    Few positions and torques, as more fit the training motion no better and other paths worse. Many past signs, as the
    effect of a reversal on the controller's integrator lasts some 0.3 s.

    Attributes:
        past, ahead: desired positions of so many cycles before and after now, ``m_1 = -past`` and ``m = ahead``.
        sign_past, sign_ahead: signs of velocity likewise, over ``REVERSAL`` seconds; both 0 for [G] (12).
        torque_past, torque_ahead: rigid-body torques likewise, used only where a chain is given.
    """

    past: int = 1
    ahead: int = 2
    sign_past: int = 0
    sign_ahead: int = 0
    torque_past: int = 0
    torque_ahead: int = 2

    @classmethod
    def at(cls, t_ipo: float) -> Lags:
        """The ranges of [G] (13) at a cycle of ``t_ipo`` [s]."""
        return cls(sign_past=round(REVERSAL[0] / t_ipo), sign_ahead=round(REVERSAL[1] / t_ipo))

    @property
    def before(self) -> int:
        """Number of past desired positions that are needed: velocities are backward differences."""
        return max(self.past + 1, self.sign_past + 1, self.torque_past + 2)

    @property
    def n_d(self) -> int:
        """Length of the horizon that is needed."""
        return max(self.ahead, self.sign_ahead, self.torque_ahead + 2) + 1


class Windowed(Feedforward):
    """A feedforward that weights the desired positions of cycles before and after now, within command limits.

    Attributes:
        past: cycles before now.
        limits: of commands; None for none.
    """

    past: int
    limits: CommandLimits | None

    def init(self, q0: Array) -> Array:
        """State for an arm at rest at ``q0 (n,)`` [rad]; see ``Feedforward.init``."""
        return np.tile(np.asarray(q0, dtype=float), (self.past, 1))

    def step(self, state: Array, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, Array]:
        """The command of one interpolation cycle; see ``Feedforward.step``."""
        rows = np.concatenate([state, q_d[: self.n_d]])
        if len(q_d) < self.n_d:
            rows = held(rows, after=self.n_d - len(q_d))
        q_c = self.weighed(rows)
        if self.limits is not None:
            q_c = self.limits.within(q_c)
        return q_c, np.concatenate([state[1:], q_d[:1]])

    @abstractmethod
    def weighed(self, rows: Array) -> Array:
        """The command ``(n,)`` [rad] of a window ``(past + n_d, n)`` [rad] whose row ``past`` is now."""


class Trained(Windowed):
    """Decoupled trained feedforward controllers.

    Args:
        weights: weights of the positions r ``(past + ahead, n)``, below them those of the signs s ``(sign_past +
            sign_ahead, n)`` [rad] and of the torques w ``(torque_past + torque_ahead + 1, n)`` [rad/(N m)], or no rows.
        lags: time shifts of the rows, in ascending order of ``l``, without 0 for r and s.
        t_ipo: cycle [s].
        chain: rigid body whose torques are weighed; None for [G] (12), (13) proper.
        limits: of commands; None for none.
    """

    def __init__(self, weights: Array, lags: Lags, t_ipo: float, *, chain: Chain | None = None,
                 limits: CommandLimits | None = None) -> None:
        signs = lags.past + lags.ahead
        self.r, self.s, self.w = np.split(weights, [signs, signs + lags.sign_past + lags.sign_ahead])
        self.lags, self.t_ipo, self.chain, self.limits = lags, t_ipo, chain, limits
        self.past, self.n_d = lags.before, lags.n_d

    def weighed(self, rows: Array) -> Array:
        """The command ``(n,)`` [rad] of a window ``(past + n_d, n)`` [rad]; see ``Windowed.weighed``."""
        positions, signs, torques = _regressors(rows[None], self.lags, self.t_ipo, self.chain)
        q_c = rows[self.past] + np.sum(self.r * positions[0], axis=0) + np.sum(self.s * signs[0], axis=0)
        return np.asarray(q_c + np.sum(self.w * torques[0], axis=0))


def train(paths: Sequence[tuple[Array, Array]], t_ipo: float, *, chain: Chain | None = None,
          limits: CommandLimits | None = None) -> Trained:
    """Fits the weights of [G] (12) or (13) to learned commands, by least squares.

    Raises InputError for no path, or commands and desired positions of different shape.

    Args:
        paths: pairs of desired positions and learned commands, each ``(N, n)`` [rad], all from rest.
        t_ipo: cycle [s].
        chain: rigid body whose torques are weighed too; None for [G] (12), (13) proper.
        limits: passed on to the trained feedforward.
    """
    lags = Lags.at(t_ipo)
    if not paths or any(q_d.shape != q_c.shape for q_d, q_c in paths):
        raise InputError("expected at least one pair of desired positions and commands of the same shape",
                         field="paths", value=[(q_d.shape, q_c.shape) for q_d, q_c in paths])
    n = paths[0][0].shape[1]
    positions_count, signs_count = lags.past + lags.ahead, lags.sign_past + lags.sign_ahead
    torque_count = 0 if chain is None else lags.torque_past + lags.torque_ahead + 1
    size = positions_count + signs_count + torque_count
    columns = []
    torque_scale = np.full(n, 1e-12)
    for q_d, _ in paths:
        padded = held(q_d, before=lags.before, after=lags.n_d)
        windows = np.stack([padded[k : k + lags.before + lags.n_d] for k in range(len(q_d))])
        columns.append(np.concatenate(_regressors(windows, lags, t_ipo, chain), axis=1))
        if chain is not None:
            torque_scale = np.maximum(torque_scale, np.abs(columns[-1][:, -torque_count:]).max(axis=(0, 1)))
    whole, learned = np.concatenate(columns), np.concatenate([q_c - q_d for q_d, q_c in paths])
    weights = np.empty((size, n))
    for i in range(n):
        # Prior: position weights of order 1, contributions of friction and torque of a milliradian.
        prior = np.concatenate([np.ones(positions_count), np.full(signs_count, 1e-3),
                                np.full(torque_count, 1e-3 / torque_scale[i])])
        weights[:, i] = least_squares(Measurement(whole[:, :, i], learned[:, i], _NOISE),
                                      Measurement(np.diag(1.0 / prior), np.zeros(size), 1.0))
    return Trained(weights, lags, t_ipo, chain=chain, limits=limits)


def _regressors(windows: Array, lags: Lags, t_ipo: float, chain: Chain | None) -> tuple[Array, Array, Array]:
    """The differences of (13), and the torques, for windows ``(N, before + n_d, n)`` in which now is row ``before``."""
    now = lags.before
    ahead = [lag for lag in range(-lags.past, lags.ahead + 1) if lag != 0]
    positions = windows[:, [now + lag for lag in ahead]] - windows[:, [now]]
    speed = np.diff(windows, axis=1) / t_ipo
    sign = np.clip(speed / _SIGN_SPEED, -1.0, 1.0)
    signed = [lag for lag in range(-lags.sign_past, lags.sign_ahead + 1) if lag != 0]
    # Row j of the differences is the velocity at row j + 1.
    signs = sign[:, [now + lag - 1 for lag in signed]] - sign[:, [now - 1]]
    return positions, signs, _torques(windows, lags, t_ipo, chain)


def _torques(windows: Array, lags: Lags, t_ipo: float, chain: Chain | None) -> Array:
    """Rigid-body torques ``(N, torque_past + torque_ahead + 1, n)``; no rows without a chain.

    Differences over two cycles: paths whose acceleration jumps must not put peaks of one cycle into the command.
    """
    N, _, n = windows.shape
    if chain is None:
        return np.empty((N, 0, n))
    around = windows[:, lags.before - lags.torque_past - 2 : lags.before + lags.torque_ahead + 3]
    q = around[:, 2:-2]
    qd = (around[:, 4:] - around[:, :-4]) / (4 * t_ipo)
    qdd = (around[:, 4:] - 2 * q + around[:, :-4]) / (2 * t_ipo) ** 2
    flat = [np.ascontiguousarray(values.reshape(-1, n)) for values in (q, qd, qdd)]
    return inverse_dynamics(chain, *flat).reshape(q.shape)
