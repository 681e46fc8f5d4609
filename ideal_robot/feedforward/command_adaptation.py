r"""Adaptation of the command's law: delay, gains and offset follow the arm during the run.

With ``r`` the command at the controller's input, and :math:`e_v`, :math:`e_f` the identified law's predictions from the
measured motion and from torques, each moving joint satisfies

.. math:: r(t; \Delta) - q - e_v - e_f = \Delta\, \dot r + o + g_v e_v + g_f e_f + \varepsilon

with Δ the change of the delay, o an offset, and :math:`g_v`, :math:`g_f` relative changes of the gains. Both sides pass
the same low-passes first. The parameters are estimated by the recursion of ``estimate.recursive``. In joints in which
the law's residual of the last seconds is not below that of the uncorrected command, the path is commanded uncorrected,
so that adaptation is never worse than no correction.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array, eased
from ideal_robot.command.motion import Motion
from ideal_robot.estimate.recursive import GATE, correlation, predict, update
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.command_inverse import Changed, CommandInverse, InverseState
from ideal_robot.robots.interface import RobotState

_LATE, _GAIN = 0.05, 0.3
"""Prior standard deviations: of a change of the delay [s], of gains over their size and of an offset over that of
``q_c - q``. A controller's lag was seen to go from 84 to 180 ms with duty."""
_RESOLVED = 1e-2
"""Of ``q_c - q``, what a measurement is wrong by at least, by smoothing and lines between commands; a smaller change
changes no path that a user would see."""
_LATER = GATE * _LATE
"""Delay beyond the identified one for which desired positions are looked at [s]: what is learned stays below."""
_DRIFTS = 60.0
"""Time constant of the changes [s]: a lag drifts within minutes, gains are changed from one job to the next."""
_ALIKE = 0.1
"""Time over which what a law leaves is alike [s]: a reversal's. More measurements in it say no more."""
_CUTOFF = 30.0
"""Of each lag at most [rad/s]: what an encoder's steps make of accelerations stays below what a law resolves."""
_LAGS = 2
"""Through which all that is compared passes."""
_ROWS, _SMOOTHED, _DEGREE = 7, 0.02, 4
"""Rows of a measured motion that derivatives are taken from, and what smooths them: a polynomial over so much time on
either side of the middle [s], and its degree."""
_JUDGED = 2.0
"""Time over which law and plain command are compared [s]."""
_BELIEVED = 0.1
"""Time of measurements that what was identified counts as [s]."""
_ASIDE = 20.0
"""Time for which a law that left more is put aside [s], twice as long the next time: what it explains of the plain
path it need not make true."""
_BETTER = 0.5
"""Share of the plain command's squares that the law's have to be below before it is taken up again."""
_TAKEN_UP = 1.0
"""Time in which the plain path is left, and returned to [s]."""
_STARTS = 0.5
"""Time from the start in which nothing is learned [s]: the lags fill."""


@dataclass(frozen=True)
class Past:
    """Past commands and measurements of the adaptation.

    Attributes:
        given: commands of the last cycles ``(W, n)`` [rad], the newest last.
        measured: angles of the last cycles ``(L, n)`` [rad], the newest last.
        wanted: desired motor positions of the last cycles ``(L, n)`` [rad].
        lags: outputs ``(2, 7, n)`` [rad, rad/s] of the two equal low-passes in series. Each filters seven quantities:
            ``r + Δ ṙ - q``, ``ṙ``, ``e_v``, ``e_f`` of the module's equation, ``wanted - q``, ``q_c - q``, and one
            where a joint moves, else zero.
        filters: each joint's states ``(2, 2, k)`` of the filters in its law: first for the terms of motion, then for
            those of torque; of either first the direct terms, then the integrated ones.
        cycle: measurements so far.
        led: whether this feedforward made the last command; cycles commanded by others are not used.
    """

    given: Array
    measured: Array
    wanted: Array
    lags: Array
    filters: tuple[Array, ...]
    cycle: int = 0
    led: bool = False


@dataclass(frozen=True)
class Judgement:
    """Per joint whether the law or the uncorrected path is commanded, from their recent residuals.

    Attributes:
        squares: mean squared residuals of law and uncorrected command ``(2, n)`` [rad²].
        count: number of measurements behind each ``(n,)``.
        law: whether each joint is commanded by the law ``(n,)``.
        aside: for how long it is put aside still, and for how long the next time ``(2, n)`` [s].
    """

    squares: Array
    count: Array
    law: np.ndarray
    aside: Array


@dataclass(frozen=True)
class AdaptedState:
    """State of the adaptation from cycle to cycle.

    Attributes:
        inner: of the inverse.
        mean, covariance: of the parameters ``(n, 4)``, ``(n, 4, 4)``, in units of their prior standard deviations.
        past: commands and measurements.
        judgement: of law and plain path.
        share: progress of the change from the uncorrected command to the law, 0 to 1 ``(n,)``.
    """

    inner: InverseState
    mean: Array
    covariance: Array
    past: Past
    judgement: Judgement
    share: Array


class AdaptedCommand(Feedforward):
    """The inverse by the command's law, with delay, gains and offset adapted to the controller.

    Args:
        inverse: by the law as it was identified.
    """

    extends = True

    def __init__(self, inverse: CommandInverse) -> None:
        self.inverse, self.t_ipo = inverse, inverse.t_ipo
        law, dt = inverse.law, inverse.t_ipo
        self.n_d = inverse.n_d + int(np.ceil(_LATER / dt))
        self.n = law.n
        self.deviation = np.maximum(np.nan_to_num(law.deviation), 1e-6)
        self.residual = np.maximum(np.nan_to_num(law.residual), _RESOLVED * self.deviation)
        self.sigma = np.stack([np.full(self.n, _LATE), _GAIN * self.deviation, np.full(self.n, _GAIN),
                               np.full(self.n, _GAIN)], axis=1)
        moves = [np.array([column.of.moves for column in own.columns], dtype=float) for own in law.joints]
        level = [np.array([column.term == "offset" for column in own.columns], dtype=float) for own in law.joints]
        self.masks = [np.stack([m, 1.0 - m - o]) for m, o in zip(moves, level, strict=True)]
        self.constant = np.array([float(own.coefficients @ o) for own, o in zip(law.joints, level, strict=True)])
        self.correlation = correlation(dt, _DRIFTS)
        self.variance = self.residual**2 * max(1.0, _ALIKE / dt)
        self.pass_share = 1.0 - np.exp(-min(_CUTOFF * dt, 0.2))
        memory = max((own.shape.ahead + 5.0 * own.shape.time for own in law.joints), default=0.0)
        half = max(_ROWS // 2, round(_SMOOTHED / dt))
        self.behind = half * dt
        self.window = int(np.ceil((memory + _LATER) / dt)) + half + 3
        powers = np.vander(np.arange(-half, half + 1.0) / half, _DEGREE + 1)
        self.smooth = powers[half - _ROWS // 2 : half + _ROWS // 2 + 1] @ np.linalg.pinv(powers)
        self.late = np.array([own.shape.late for own in law.joints]) + inverse.shift

    def init(self, q0: Array) -> AdaptedState:
        """State for an arm at rest at ``q0 (n,)`` [rad]; see ``Feedforward.init``."""
        n = self.n
        inner = self.inverse.init(q0)
        eye = np.tile(np.eye(self.sigma.shape[1]), (n, 1, 1))
        filters = tuple(np.zeros((2, 2, max(len(den) - 1, 0))) for _, den in self.inverse.discrete)
        rows = self.smooth.shape[1]
        past = Past(np.tile(q0, (self.window, 1)), np.full((rows, n), np.nan), np.tile(q0, (rows, 1)),
                    np.zeros((_LAGS, 7, n)), filters)
        judgement = Judgement(np.stack([self.residual**2, self.deviation**2]), np.full(n, _BELIEVED / self.t_ipo),
                              np.ones(n, dtype=bool), np.stack([np.zeros(n), np.full(n, _ASIDE)]))
        return AdaptedState(inner, np.zeros(self.sigma.shape), eye, past, judgement, np.ones(n))

    def changed(self, state: AdaptedState) -> Changed:
        """The learned changes in the law's units."""
        x = state.mean * self.sigma
        late = np.minimum(x[:, 0], _LATER)
        return Changed(late, x[:, 1], tuple(1.0 + x[j, 2] * mask[0] + x[j, 3] * mask[1]
                                            for j, mask in enumerate(self.masks)))

    def step(self, state: AdaptedState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, AdaptedState]:
        """The command of one interpolation cycle; see ``Feedforward.step``."""
        by_law, inner = self.inverse.changed_step(state.inner, q_d, tau_ext_d, self.changed(state), rows=self.n_d)
        q_c = q_d[0] + eased(state.share) * (by_law - q_d[0])
        share = np.clip(state.share + np.where(state.judgement.law, 1.0, -1.0) * self.t_ipo / _TAKEN_UP, 0.0, 1.0)
        past = state.past
        given, wanted = np.vstack([past.given[1:], q_c]), np.vstack([past.wanted[1:], inner.motors])
        if not np.isfinite(past.measured).any():
            # Earlier commands by others are unknown, and the arm was at rest.
            given, wanted = np.tile(q_c, (len(given), 1)), np.tile(inner.motors, (len(wanted), 1))
        past = dataclasses.replace(past, given=given, wanted=wanted, led=True)
        return q_c, dataclasses.replace(state, inner=inner, past=past, share=share)

    def observe(self, state: AdaptedState, measured: RobotState) -> AdaptedState:
        """The next state, from the angles of some cycles ago and their commands; see ``Feedforward.observe``."""
        q = np.asarray(measured.q, dtype=float)
        if not np.isfinite(q).all():
            return state
        past = state.past
        before = past.measured
        if not past.led:
            # Another part commands the arm (a calibration, an approach), with commands that this feedforward does not
            # know.
            unknown = dataclasses.replace(past, measured=np.full_like(before, np.nan), cycle=0)
            return dataclasses.replace(state, past=unknown)
        # Commands were sent a cycle before the state that is reported with them.
        past = dataclasses.replace(past, led=False, measured=np.concatenate([before[1:], q[None]]))
        if not np.isfinite(before).all():
            return dataclasses.replace(state, past=past)
        inverse = self.inverse
        smoothed = Motion.of(self.smooth @ before, self.t_ipo, inverse.law.still, inverse.bodies)
        motion = inverse.with_model_torque(smoothed)
        filters, e = self._explained(past, motion)
        middle = _ROWS // 2
        late = np.minimum(state.mean[:, 0] * self.sigma[:, 0], _LATER)
        r, rate = self._seen(past.given, self.late + late + self.behind)
        moves = np.abs(motion.qd[middle]) > inverse.law.still
        into = np.stack([r + late * rate - motion.q[middle], rate, *e,
                         past.wanted[len(before) // 2] - motion.q[middle],
                         past.given[-1 - len(before) // 2] - motion.q[middle], moves])
        lags = past.lags.copy()
        for k in range(_LAGS):
            into = lags[k] + self.pass_share * (into - lags[k]) if past.cycle else into
            lags[k] = into
        past = dataclasses.replace(past, lags=lags, filters=filters, cycle=past.cycle + 1)
        state = dataclasses.replace(state, past=past)
        if past.cycle * self.t_ipo < _STARTS:
            return state
        return self._learned(state, moves)

    def _seen(self, given: Array, late: Array) -> tuple[Array, Array]:
        """What the controllers saw of the commands, so late [s] before the last of them, and its rate ``(n,)`` each."""
        seen, rate, dt = np.empty(self.n), np.empty(self.n), self.t_ipo
        for j, own in enumerate(self.inverse.law.joints):
            shape, commands = own.shape, given[:, [j]]
            if shape.time:
                commands = shape.filter.seen(commands, dt, shape.time)
            at = np.clip(len(commands) - 1 - late[j] / dt, 1.0, len(commands) - 2.0)
            k = min(int(at), len(commands) - 3)
            a, b, c, d = commands[k - 1 : k + 3, 0]
            seen[j], rate[j] = b + (at - k) * (c - b), 0.5 * ((1.0 - at + k) * (c - a) + (at - k) * (d - b)) / dt
        return seen, rate

    def _explained(self, past: Past, motion: Motion) -> tuple[tuple[Array, ...], Array]:
        """States of the poles, and what motion and torques make of the law in the middle row ``(2, n)`` [rad]."""
        from scipy import signal

        e, filters, middle = np.empty((2, self.n)), [], _ROWS // 2
        for j, (num, den) in enumerate(self.inverse.discrete):
            after = np.empty_like(past.filters[j])
            for group, mask in enumerate(self.masks[j]):
                total = 0.0
                for i, x in enumerate(self.inverse.law.sums(motion, j, mask)[:, middle]):
                    if len(den) == 1:
                        total += float(num[i, 0] / den[0] * x)
                        continue
                    zi = past.filters[j][group, i] if past.cycle else signal.lfilter_zi(num[i], den) * x
                    out, after[group, i] = signal.lfilter(num[i], den, [x], zi=zi)
                    total += float(out[0])
                e[group, j] = total
            filters.append(after)
        return tuple(filters), e

    def _learned(self, state: AdaptedState, moves: np.ndarray) -> AdaptedState:
        """The state after one measurement.

        Args:
            state: with what is compared.
            moves: joints that move ``(n,)``. Of the others nobody knows the friction; what the lags hold of rest says
                of ``q_c - q`` no more than its size.
        """
        apart, rate, e_v, e_f, missed, plain, moved = state.past.lags[-1]
        variance = self.variance * (1.0 + ((1.0 - moved) * self.deviation / self.residual) ** 2)
        left = apart - e_v - e_f - self.constant
        mean, covariance, before = state.mean.copy(), state.covariance.copy(), state.judgement
        squares, count = before.squares.copy(), np.minimum(before.count + moves, _JUDGED / self.t_ipo)
        for j in np.flatnonzero(moves):
            h = self.sigma[j] * np.array([rate[j], 1.0, e_v[j], e_f[j]])
            y = float(left[j])
            # A joint commanded by the law is also judged by its following error.
            by_law = max(abs(y - h @ mean[j]), abs(missed[j]) if state.share[j] == 1.0 else 0.0)
            now = np.array([by_law, plain[j]])
            squares[:, j] += (now**2 - squares[:, j]) / count[j]
            predict(mean[j], covariance[j], self.correlation)
            update(mean[j], covariance[j], h, y, float(variance[j]))
        wait, pause = before.aside
        again = (squares[0] < _BETTER * squares[1]) & (wait <= 0.0)
        law = np.where(before.law, squares[0] < squares[1], again)
        fell = before.law & ~law
        aside = np.stack([np.where(fell, pause, np.maximum(wait - self.t_ipo, 0.0)),
                          np.where(fell, 2.0 * pause, pause)])
        return dataclasses.replace(state, mean=mean, covariance=covariance,
                                   judgement=Judgement(squares, count, law, aside))
