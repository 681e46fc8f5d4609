"""Tests on which signals a residual depends: splines, with a null distribution from the residual itself.

Under the null hypothesis the sign of the residual in a block of time is independent of the signal. Random sign changes
of whole blocks preserve all correlation within blocks; mean and variance of the squares that are explained follow from
the blocks; also where the motion repeats itself, where shifting in time would fail.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import linalg, optimize, special

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import Blocks
from ideal_robot.diagnosis.channels.motor_torque import direction_of
from ideal_robot.diagnosis.channels.regression import RESTING
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.system import System
from ideal_robot.effects import MOTOR_TORQUE, Domain, Signals
from ideal_robot.effects.fitted import Unknown, signal_of, spline_basis
from ideal_robot.estimate.score import TOLD
from ideal_robot.friction import FrictionModel
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places

_SLOW = (6, 14)
"""Intervals of a curve over time: so few that each is many blocks long, and a block can be told from its neighbours."""


@dataclass(frozen=True)
class Dependence:
    """Dependence of one channel's residual on one curve.

    Attributes:
        term: the spline over the signals it was tried on.
        share: share of the residual's squares that the curve explains.
        expected: share it explains by chance, from blocks whose signs are flipped.
        p_value: of ``share`` under the null hypothesis.
    """

    term: Unknown
    share: float
    expected: float
    p_value: float


def terms(signals: Signals, channel: int, pairs: bool, domain: Domain = MOTOR_TORQUE) -> list[Unknown]:
    """Curves to try on a channel: of single signals, and times the direction of motion.

    Args:
        signals: at the rows of the residual.
        channel: index of the channel.
        pairs: whether products of two signals are tried too.
        domain: of the channel.
    """
    own = min(channel, signals.n - 1) + 1
    names = ["t", *(f"{kind}_{i + 1}" for kind in ("q", "qd", "qdd") for i in range(signals.n)), f"load_{own}",
             *([] if signals.temperature is None else [f"temp_{own}"]), *signals.extra]
    names = [name for name in names if _varies(signals, name)]
    result = [Unknown((name,), False, (_knots(signals, name, intervals),), domain=domain)
              for name in names for intervals in (_SLOW if name == "t" else (9,))]
    directed = [name for name in names if name.startswith(("q_", "load_", "temp_")) or name == "t"]
    if domain == MOTOR_TORQUE:
        result += [Unknown((name,), True, (_knots(signals, name, 9),)) for name in directed]
    if pairs:
        ours = {f"q_{channel + 1}", f"qd_{channel + 1}"}
        smooth = sorted(name for name in names if name.startswith(("q_", "qd_")))
        result += [Unknown(pair, False, tuple(_knots(signals, name, 2) for name in pair), domain=domain)
                   for pair in itertools.combinations(smooth, 2)
                   if ours & {*pair} or len({name.split("_")[0] for name in pair}) == 1]
    return result


class DependenceTest:
    """Tests many curves on residuals at the same samples, with shared precomputation.

    Args:
        signals, blocks: at the samples, and of time.
        use: samples of each channel that are used ``(N, c)``.
    """

    def __init__(self, signals: Signals, use: np.ndarray, blocks: Blocks) -> None:
        self.signals, self.use, self.blocks = signals, use, blocks
        self._white: dict[tuple[Unknown, int], tuple[Array, Array]] = {}
        self._known: dict[tuple[str, tuple[float, ...]], Array] = {}
        self._counts = [self._both_ways(mask.astype(float), j) for j, mask in enumerate(use.T)]

    def tests(self, residual: Array, channel: int, of: Sequence[Unknown]) -> list[Dependence]:
        """Tests curves on one channel's residual.

        Args:
            residual: of the channel ``(N,)``, in its unit.
            channel, of: its index, and the curves.
        """
        use = self.use[:, channel]
        # Relative to the mean, as every model has a constant; also the columns, as a residual with flipped blocks has a
        # mean.
        r = np.where(use, residual - (residual[use].mean() if use.any() else 0.0), 0.0)
        weights = self._both_ways(r, channel)
        return [self._test(weights, channel, term) for term in of]

    def _both_ways(self, r: Array, channel: int) -> tuple[Array, Array, Array]:
        """Values ``(N,)`` block by block ``(B, 1, L)``, times its joint's direction, and sums ``(B, 1)``."""
        directed = r * self.signals.sliding_direction(channel + 1) if channel < self.signals.n else r
        by_block = self.blocks.cut(r)
        return by_block[:, None], self.blocks.cut(directed)[:, None], by_block.sum(axis=1)[:, None]

    def _test(self, weights: tuple[Array, Array, Array], channel: int, term: Unknown) -> Dependence:
        """Tests one curve on a channel's residual, given block by block, times its direction, and summed."""
        centre, T = self._whitened(term, channel)
        if not T.size:
            return Dependence(term, 0.0, 0.0, 1.0)
        parts = (self._sums(weights[term.directed], term) - weights[2] * centre) @ T
        total = max(float(np.vdot(weights[0], weights[0])), 1e-300)
        observed = float(np.sum(parts.sum(axis=0) ** 2))
        # With signs s_b of the blocks it would be |sum_b s_b p_b|²; a gamma distribution of the same mean and variance
        # approximates its tail.
        alone = (parts**2).sum(axis=1)
        mean = float(alone.sum())
        variance = max(2.0 * float(np.sum((parts.T @ parts) ** 2) - np.sum(alone**2)), 1e-9 * mean**2 + 1e-300)
        p = float(special.gammaincc(mean**2 / variance, observed * mean / variance))
        return Dependence(term, observed / total, mean / total, p)

    def _whitened(self, term: Unknown, channel: int) -> tuple[Array, Array]:
        """Means of a curve's columns over the samples that count, and what makes them orthonormal about these."""
        if (term, channel) not in self._white:
            use = self._counts[channel]
            sums, count = self._sums(use[term.directed], term).sum(axis=0), max(float(use[0].sum()), 1.0)
            first, *other = self._curves(term)
            basis = (first[..., None] * other[0][..., None, :] if other else first).reshape(-1, len(sums))
            counts = (use[1] ** 2 if term.directed else use[0]).reshape(-1, 1)
            s, U = np.linalg.eigh(basis.T @ (basis * counts) - np.outer(sums, sums) / count)
            keep = s > 1e-6 * max(s[-1], 1e-300)
            self._white[term, channel] = sums / count, U[:, keep] / np.sqrt(s[keep])
        return self._white[term, channel]

    def _sums(self, weights: Array, term: Unknown) -> Array:
        """Sums of a curve's columns times weights ``(B, 1, L)`` over each block ``(B, m)``."""
        first, *other = self._curves(term)
        if not other:
            return np.asarray((weights @ first)[:, 0])
        return np.asarray(((np.swapaxes(first, 1, 2) * weights) @ other[0]).reshape(len(first), -1))

    def _curves(self, term: Unknown) -> list[Array]:
        """Its columns block by block ``(B, L, m)``, or those of which they are the products; curves are kept."""
        if term.frequency:
            return [self.blocks.cut(term.basis(self.signals))]
        for name, knots in zip(term.depends_on, term.knots, strict=True):
            if (name, knots) not in self._known:
                self._known[name, knots] = self.blocks.cut(spline_basis(signal_of(self.signals, name), knots,
                                                                        term.margin))
        return [self._known[key] for key in zip(term.depends_on, term.knots, strict=True)]


def time_period(residual: Array, use: np.ndarray, t: Array, domain: Domain) -> Unknown | None:
    """The strongest oscillation over time of a residual as a candidate term; None for a short recording.

    Args:
        residual: of a channel ``(N,)``, in its unit.
        use: samples that are used ``(N,)``.
        t: times ``(N,)`` [s], evenly spaced.
        domain: of the channel.
    """
    r = np.where(use, residual, 0.0)
    N = len(r)
    if N < 64:
        return None
    dt = float(t[1] - t[0])
    power = np.abs(np.fft.rfft(r, 4 * N)) ** 2
    f = np.fft.rfftfreq(4 * N, dt)
    power[f < 3.0 / (N * dt)] = 0.0
    best = float(f[int(np.argmax(power))])
    return Unknown(("t",), False, ((float(t[0]), float(t[-1])),), 2.0 * np.pi * best, domain=domain)


def _varies(signals: Signals, name: str) -> bool:
    def made() -> bool:
        x = signal_of(signals, name)
        spread = float(np.percentile(x, 99) - np.percentile(x, 1))
        return bool(np.all(np.isfinite(x)) and spread > 1e-9 * (1.0 + float(np.max(np.abs(x)))))

    return bool(signals.once(("varies", name), made))


def _knots(signals: Signals, name: str, intervals: int) -> tuple[float, ...]:
    """Evenly spread knots over the range of a signal; for a curve, over what holds all but the outermost percent."""
    def made() -> tuple[float, ...]:
        x = signal_of(signals, name)
        low, high = np.percentile(x, [0.5, 99.5]) if intervals > 2 else (float(x.min()), float(x.max()))
        return tuple(np.linspace(low, high, 2 if intervals <= 2 else intervals + 1).tolist())

    knots: tuple[float, ...] = signals.once(("knots", name, intervals), made)
    return knots


# How sharply dry friction changes sign at a reversal: a nuisance parameter on which no effect may depend.
#
# Filters, sampling and bearings smooth the step of the sign; with a hard step in the model each reversal causes a spike
# of the residual that resembles Stribeck or presliding. The width is fitted for each joint, up to twice the speed at
# which it rests.


def reversal_widths(problem: Problem, model: Model) -> Array:
    """Speeds over which friction changes sign ``(n,)``: those with the best fit, or else the position noise's.

    The problem's regression is about the model whose friction changes sign.
    """
    system, signals = problem.system(), problem.regression.signals
    reversal_width = np.full(signals.n, 1e-12) if signals.v_small is None else np.array(signals.v_small)
    places = friction_places(model.base, model.friction)
    for j, (law, place) in enumerate(zip(model.friction.laws, places, strict=True)):
        widest = 2.0 * RESTING * signals.top_speed(j + 1)
        if j + 1 in problem.regression.undecided or law.presliding or not widest > reversal_width[j]:
            continue
        # Halved down to the width of the position's noise; the best one is refined.
        speeds = widest * 0.5 ** np.arange(np.ceil(np.log2(widest / reversal_width[j])))
        misfit = partial(_remaining, problem, system, law, j, place)
        remaining = [misfit(speed) for speed in speeds]
        best = int(np.argmin(remaining))
        if misfit(reversal_width[j]) - remaining[best] < TOLD**2:
            continue
        around = (max(0.5 * speeds[best], reversal_width[j]), min(2.0 * speeds[best], widest))
        optimum = optimize.minimize_scalar(lambda x, of=misfit: of(np.exp(x)), bounds=np.log(around), method="bounded",
                                           options={"xatol": 0.02, "maxiter": 8})
        reversal_width[j] = float(np.exp(optimum.x)) if optimum.fun < remaining[best] else speeds[best]
    return reversal_width


def _remaining(problem: Problem, system: System, law: FrictionModel, j: int, place: slice, speed: float) -> float:
    """Whitened squares that remain if friction of joint ``j``, whose coefficients stand at ``place``, changes sign so.

    The change over ``speed`` counts with the coefficients of the model and with what is fitted to them, never alone.
    """
    s = problem.regression.signals
    qd, load, q = (values[:, [j]] for values in (s.qd, s.load, s.q))
    change = law.regressor(qd, load, q, np.tanh(qd / speed)) - law.regressor(qd, load, q, direction_of(s, j))
    system.drop("reversal_width")
    system.add("reversal_width", problem.prepared(s.on_joint(j + 1, *change[:, 0].T)))
    G = system.gram(["W", "reversal_width"]).sum(axis=0)
    P, m = system.p, change.shape[2]
    M = np.zeros((len(G), P + 1))
    M[:P, :P] = np.eye(P)
    M[P : P + m, place] = np.eye(m)
    M[P : P + m, P] = -law.coefficients[:, 0]
    M[-1, P] = 1.0
    G = M.T @ G @ M
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G)[:P], 1e-300))
    A, b = G[:P, :P] * np.outer(scale, scale), G[:P, P] * scale
    return float(G[P, P] - b @ linalg.pinvh(A, rtol=1e-11) @ b)
