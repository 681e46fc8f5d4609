"""Weighted least squares with the statistics of [J] 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import optimize, stats

from ideal_robot.arrays import Array, G
from ideal_robot.dynamics import BaseParameters, link_parameters, torques
from ideal_robot.dynamics.consistent_inertias import parameter_scales
from ideal_robot.estimate.gaussian import measured
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import not_zero
from ideal_robot.signals.preprocess import FilteredSignals

_ITERATIONS = 4
"""Re-estimations of the weights."""
_RANK = 1e-8
"""Directions of the scaled regressor weaker than this share of the strongest count as not excited."""

_BLOCKS = 10
"""Stretches of time that the jackknife leaves out one by one."""
_TINY = 1e-10
"""Least eigenvalue of a correlation matrix over the largest."""
_OWN = 0.25
"""Least share of a channel's residual variance that is its own noise, whatever errors its samples are known to have."""


@dataclass(frozen=True)
class Solution:
    """Result of a weighted least-squares fit of ``n`` channels with ``P`` common parameters.

    Attributes:
        value: estimate ``(P,)``.
        covariance: ``(P, P)``; its standard deviations are never below ``std_white``.
        std_white: standard deviations by [J] (15), (16), which take residuals as white ``(P,)``.
        noise_std: standard deviation of each channel's residual ``(n,)``.
        condition_number: of the weighted observation matrix.
        condition_number_scaled: of the same with columns scaled to unit length.
        unexcited: mask ``(P,)`` of parameters that the data say nothing about; they keep their starting value.
        residual: ``(M, n)``.
        at_bound: mask ``(P,)`` of parameters that the data want negative and that may not be: they are zero, a limit
            without a standard deviation.
    """

    value: Array
    covariance: Array
    std_white: Array
    noise_std: Array
    condition_number: float
    condition_number_scaled: float
    unexcited: np.ndarray
    residual: Array
    at_bound: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))


def weighted_least_squares(W: Array, y: Array, start: Array, information: Array, *, segments: Array | None = None,
                           nonnegative: np.ndarray | None = None, variance: Array | None = None,
                           regions: Sequence[np.ndarray] = ()) -> Solution:
    """Solves ``y = W p + e`` with one noise level per channel, estimated from the residual (IDIM-WLS).

    Args:
        W: ``(M, n, P)`` observation matrix per sample.
        y: ``(M, n)`` measurements; a channel that is NaN throughout takes no part.
        start: values ``(P,)`` that directions without excitation keep.
        information: prior of the parameters about ``start``, as an inverse covariance ``(P, P)``.
        segments: ``(M,)`` number of the recording each sample comes from: the correlation of its residuals from sample
            to sample enlarges the covariance. Residuals are assumed white if None.
        nonnegative: ``(P,)`` parameters that may not be negative.
        variance: ``(M, n)`` known variance of each sample in addition to its channel's noise level, in the
            square of y's unit.
        regions: rows of similar motion: model errors there do not average out over time, and disagreement of the
            regions enlarges the covariance.
    """
    live = np.asarray(~np.isnan(y).all(axis=0))
    y = np.where(live, y, 0.0)
    W = W * live[:, None]
    count, n, size = W.shape
    noise = scale_y = np.maximum(np.std(y, axis=0), 1e-12)
    bounded = np.zeros(size, dtype=bool) if nonnegative is None else nonnegative
    at_bound = np.zeros(size, dtype=bool)
    extra = np.zeros_like(y) if variance is None else variance
    channels = _Channels(W, y - W @ start, alike=variance is None)
    root = _root(information)
    for _ in range(_ITERATIONS):
        std = np.sqrt(noise**2 + extra)
        value, inverse, conditions, unexcited = _solve(channels.weighted(std), root)
        value, inverse, at_bound = _bounded(value, inverse, start, bounded, unexcited)
        value = value + start
        residual = y - W @ value
        # [J] (15) channel by channel; each channel has its share of the parameters subtracted.
        freedom = max(1.0, count - (size - unexcited.sum()) / n)
        level = np.sum(residual**2, axis=0) / freedom
        # The known variance of samples is a bound rather than a measurement: it explains at most three quarters.
        noise = np.maximum(np.sqrt(np.maximum(level - np.mean(extra, axis=0), _OWN * level)), 1e-9 * scale_y)
    std_white = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    covariance = inverse
    if segments is not None:
        std = np.sqrt(noise**2 + extra)
        covariance = _widened(inverse, W / std[:, :, None], residual / std, segments, regions)
    return Solution(value, covariance, std_white, np.where(live, np.sqrt(level), 0.0), *conditions, unexcited,
                    np.where(live, residual, np.nan), at_bound)


def _widened(inverse: Array, W: Array, residual: Array, segments: Array, regions: Sequence[np.ndarray]) -> Array:
    """The covariance for residuals that are correlated in time and differ between regions; all weighted."""
    inflation = _correlation_inflation(W, residual, inverse, segments)
    covariance = inverse * np.outer(inflation, inflation)
    if regions:
        covariance = covariance + _between_regions(W, residual, inverse, covariance, regions)
    return covariance


def _bounded(value: Array, inverse: Array, start: Array, bounded: np.ndarray, unexcited: np.ndarray,
             ) -> tuple[Array, Array, np.ndarray]:
    """The solution nearest in its own metric in which bounded parameters are not negative.

    With the free solution and its covariance C known, the bounded one is a small problem: the multipliers of the active
    bounds ``λ ≥ 0`` minimise ``½ λᵀ C_bb λ + λᵀ (start + value)_b``, and the parameters move by ``C λ``.
    """
    places = np.flatnonzero(bounded & ~unexcited & (np.diag(inverse) > 0))
    none = np.zeros(len(value), dtype=bool)
    if not len(places) or np.all(value[places] + start[places] >= 0.0):
        return value, inverse, none
    C = inverse[np.ix_(places, places)]
    scale = 1.0 / np.sqrt(np.diag(C))
    correlation = C * np.outer(scale, scale) + 1e-12 * np.eye(len(places))
    root = np.linalg.cholesky(correlation).T
    z = (value + start)[places] * scale
    multipliers = optimize.nnls(root, np.linalg.solve(root.T, -z))[0]
    value = value + inverse[:, places] @ (multipliers * scale)
    active = places[multipliers > 0]
    value[active] = -start[active]
    # Parameters at a bound have no variance, and contribute none to the others.
    gain = inverse[:, active] @ np.linalg.pinv(inverse[np.ix_(active, active)], hermitian=True)
    reduced = inverse - gain @ inverse[active]
    reduced[active] = 0.0
    reduced[:, active] = 0.0
    none[active] = True
    return value, 0.5 * (reduced + reduced.T), none


class _Channels:
    """Rows of each channel with the columns that they hold: bodies before a joint do not load it.

    R of the QR decomposition of all rows is that of the channels' own R one under the other.

    Args:
        W: ``(M, n, P)`` observation matrix per sample.
        y: ``(M, n)`` measurements.
        alike: whether all samples of a channel weigh alike: then its R is found once, whatever its weight.
    """

    def __init__(self, W: Array, y: Array, *, alike: bool) -> None:
        self._alike, self._width = alike, W.shape[2] + 1
        self._parts: list[tuple[np.ndarray, Array]] = []
        for j in range(W.shape[1]):
            held = np.flatnonzero(not_zero(W[:, j].T))
            rows = np.column_stack([W[:, j, held], y[:, j]])
            self._parts.append((np.append(held, W.shape[2]), _triangular(rows) if alike else rows))

    def weighted(self, std: Array) -> Array:
        """Triangular rows ``(K, P + 1)``, the measurements last, of samples with standard deviations ``(M, n)``."""
        parts = []
        for j, (held, rows) in enumerate(self._parts):
            R = rows / std[0, j] if self._alike else _triangular(rows / std[:, [j]])
            parts.append(np.zeros((len(R), self._width)))
            parts[-1][:, held] = R
        return np.concatenate(parts)


def _solve(rows: Array, root: Array) -> tuple[Array, Array, tuple[float, float], np.ndarray]:
    """Minimum-norm solution over scaled columns, ``(WᵀW)⁻¹`` on what is excited, condition numbers, what is unexcited.

    The rows ``(K, P + 1)`` are those of W with the measurements last, or what has the same R; of the parameters ``root
    (P, P)`` is known beforehand.
    """
    W, y = rows[:, :-1], rows[:, -1:]
    P = W.shape[1]
    size = np.linalg.norm(W, axis=0)
    excited = size > 1e-10 * size.max()
    # R of the QR decomposition has the singular values of W with only P rows.
    joined = _triangular(np.hstack([W[:, excited] / size[excited], y]))
    R, rhs = joined[: excited.sum(), :-1], joined[: excited.sum(), -1]
    raw = np.linalg.svd(R * size[excited], compute_uv=False)
    _, data, directions = np.linalg.svd(R)
    u, s, vt = np.linalg.svd(np.vstack([R, root[:, excited] / size[excited]]), full_matrices=False)
    strong = s > _RANK * s[0]
    inverse_s = np.where(strong, 1.0 / np.where(strong, s, 1.0), 0.0)
    value = np.zeros(P)
    value[excited] = (vt.T @ (inverse_s * (u.T @ np.concatenate([rhs, np.zeros(len(root))])))) / size[excited]
    inverse = np.zeros((P, P))
    scaled = (vt.T * inverse_s**2) @ vt / np.outer(size[excited], size[excited])
    inverse[np.ix_(excited, excited)] = scaled
    # A parameter with a clear component in an undetermined direction is undetermined.
    unexcited = ~excited
    unexcited[np.flatnonzero(excited)[np.sum(directions[data <= _RANK * data[0]] ** 2, axis=0) > 1e-3]] = True
    return value, inverse, (float(raw[0] / max(raw[-1], 1e-300)), float(data[0] / max(data[-1], 1e-300))), unexcited


def _root(information: Array) -> Array:
    """A matrix whose rows, as pseudo-measurements of zero with unit noise, carry the information."""
    value, vector = np.linalg.eigh(information)
    return np.asarray(np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T)


def _triangular(rows: Array) -> Array:
    """R of the QR decomposition."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _correlation_inflation(W: Array, residual: Array, inverse: Array, segments: Array) -> Array:
    """Factor ``(P,)`` ≥ 1 by which correlated residuals widen the standard deviations (Newey and West 1987).

    Unmodelled friction and elasticity leave residuals that stay alike over many samples; [J] (16) would count each of
    them as news.
    """
    count = len(W)
    scores = np.einsum("knp,kn->kp", W, residual) @ inverse
    blocks = [scores[segments == s] for s in np.unique(segments)]
    lags = min(max(4, round(4.0 * (count / 100.0) ** (2.0 / 9.0)) * 3), count // 10)
    variance = np.zeros(scores.shape[1])
    for block in blocks:
        variance += np.sum(block**2, axis=0)
        for lag in range(1, min(lags, len(block) - 1) + 1):
            variance += 2.0 * (1.0 - lag / (lags + 1.0)) * np.sum(block[lag:] * block[:-lag], axis=0)
    white = np.diag(inverse)
    times = np.array_split(np.arange(count), _BLOCKS)
    variance = np.maximum(variance * count / max(1, count - scores.shape[1]),
                          np.diag(_jackknife(W, residual, inverse, times)))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.sqrt(np.maximum(variance, 0.0) / white)
    # Degrees of freedom of Bartlett's window (Priestley 1981).
    student = _student(max(3.0 * count / max(lags, 1), 3.0))
    return student * np.maximum(1.0, np.nan_to_num(ratio, nan=1.0, posinf=1.0))


def _between_regions(W: Array, residual: Array, inverse: Array, covariance: Array,
                     regions: Sequence[np.ndarray]) -> Array:
    """What regions of the motion disagree about beyond ``covariance (P, P)``, as a covariance ``(P, P)``.

    Of K regions, P parameters of a model that is right differ in some direction as if they were up to
    ``(1 + √(P / (K - 1)))²`` times as uncertain as they are (Marchenko and Pastur 1967); what is beyond that counts.
    """
    held = np.flatnonzero((np.diag(covariance) > 0.0) & np.isfinite(np.diag(covariance)))
    disagreement = _jackknife(W[:, :, held], residual, inverse[np.ix_(held, held)], regions)
    std = np.sqrt(np.diag(covariance)[held])
    value, vector = np.linalg.eigh(covariance[np.ix_(held, held)] / np.outer(std, std))
    root = vector * np.sqrt(np.maximum(value, _TINY * np.max(value, initial=0.0)))
    whitened = np.linalg.pinv(root * std[:, None])
    ratio, direction = np.linalg.eigh(whitened @ disagreement @ whitened.T)
    chance = (1.0 + np.sqrt(len(held) / (len(regions) - 1))) ** 2
    beyond = (std[:, None] * root @ direction) * (_student(len(regions) - 1) * np.sqrt(np.maximum(ratio - chance, 0.0)))
    widening = np.zeros_like(covariance)
    widening[np.ix_(held, held)] = beyond @ beyond.T
    return widening


def _student(freedom: float) -> float:
    """Factor on a standard deviation that is known from ``freedom`` independent stretches.

    Of few it is itself uncertain: three of the widened ones hold the truth as often as three exact ones would.
    """
    return float(stats.t.isf(stats.norm.sf(3.0), freedom) / 3.0)


def _jackknife(W: Array, residual: Array, inverse: Array, blocks: Sequence[np.ndarray]) -> Array:
    """Covariance ``(P, P)`` from leaving out one of the blocks, of rows each, after the other.

    A model that is not quite right fits different stretches with different parameters, however long its residual stays
    alike; what the blocks disagree about, the whole cannot know either.
    """
    information = np.linalg.pinv(inverse, hermitian=True)
    steps = []
    for rows in blocks:
        A = W[rows].reshape(-1, W.shape[2])
        # Without these rows the normal equations lose AᵀA and Aᵀe: the estimate moves by minus what they had added.
        remaining = information - A.T @ A
        steps.append(-np.linalg.pinv(remaining, rcond=1e-12, hermitian=True) @ (A.T @ residual[rows].reshape(-1)))
    deviation = np.array(steps) - np.mean(steps, axis=0)
    return np.asarray((len(blocks) - 1) / len(blocks) * deviation.T @ deviation)


# Prior of an arm's parameters: those of each link are nominal within their own size.
#
# It hardly changes parameters that a motion excites. Undetermined ones stay near values of a body of that size, instead
# of being fitted to noise.

_ROTOR = 0.3
"""Standard deviation of a rotor's inertia that drive data give, relative to it: what they leave out is coupling, brake
and the gear's input side."""
_CONTRADICTS = 3.0
"""Standard deviations by which an identified rotor is off the drive data's where these are no longer believed."""
_OFFSET = 0.2
"""Standard deviation of a torque offset, relative to that of the torque."""


@dataclass(frozen=True)
class Prior:
    """Full nominal parameters and their prior uncertainty.

    Attributes:
        nominal: links, rotor inertias, offsets ``(p,)``, in units of the recorded torque.
        start: base parameters ``(b,)``.
        information: inverse covariance of the base parameters about ``start`` ``(b, b)``.
        rotors: standard deviations of the rotor inertias from the nominal ones ``(n,)``: those of drive data by the
            size of a link, others by the inertia that would take all of the torque.
    """

    nominal: Array
    start: Array
    information: Array
    rotors: Array

    def padded(self, size: int) -> Array:
        """The information matrix extended to ``size`` parameters without a prior for the added ones."""
        padded = np.zeros((size, size))
        padded[: len(self.start), : len(self.start)] = self.information
        return padded


def prior_of(robot: Robot, base: BaseParameters, signals: Sequence[FilteredSignals], *, amperes: bool) -> Prior:
    """Prior of a robot's parameters before its recordings are used, except for the size of its torque.

    Rotor inertias behind gears are independent of the links' size: their standard deviation is the inertia that would
    need all of the torque. Offsets have a fifth of the torque; those of prismatic joints, whose gravity is constant and
    often balanced, the weight.

    Args:
        robot, base: nominal inertias, and grouping of its parameters.
        signals: one per recording.
        amperes: torques are currents with unknown gains: the nominal parameters are brought to their size.
    """
    n = robot.n
    y, acceleration = (np.concatenate([s.decimate(getattr(s, name)) for s in signals]) for name in ("tau", "qdd"))
    torque = np.maximum(np.nan_to_num(np.std(y, axis=0)), 1e-9)
    nominal = np.concatenate([link_parameters(robot.pinocchio), robot.rotor_inertia, np.zeros(n)])
    unit = _gain(robot, signals) if amperes else 1.0
    layout = base.layout
    scale, rotors = unit * parameter_scales(nominal, layout), layout.rotors
    as_links = scale[rotors].copy()
    scale[rotors] = np.maximum(scale[rotors], torque / np.maximum(np.std(acceleration, axis=0), 1e-6))
    weight = unit * G * np.cumsum(nominal[layout.links][::10][::-1])[::-1][list(layout.own)]
    scale[layout.offsets] = np.where(robot.prismatic, np.maximum(weight, torque), _OFFSET * torque)
    covariance = (base.grouping * scale**2) @ base.grouping.T
    size = np.sqrt(np.diag(covariance))
    inverse = np.linalg.pinv(covariance / np.outer(size, size), hermitian=True) / np.outer(size, size)
    return Prior(unit * nominal, base.of(unit * nominal), np.asarray(inverse),
                 np.where(robot.rotor_inertia > 0.0, as_links, scale[rotors]))


def rotors_of(solution: Solution, base: BaseParameters, prior: Prior) -> tuple[np.ndarray, Array, Array]:
    """Rotor inertias with the drive data's prior: indices, values ``(k,)``, and the covariance of all parameters.

    They are combined with the drive data's values, where there are any. Plain least squares treat model errors as noise
    of single samples and would overrule the drive data by a residual that resembles acceleration. With the covariance
    that contains correlation and disagreement of the regions, the recordings decide only where they determine a rotor.
    Rotors that only appear in a sum with links are not returned.

    Args:
        solution: its first parameters are the base parameters.
        base, prior: grouping of the parameters, and their prior.
    """
    n = len(prior.nominal) // 12
    alone = np.flatnonzero(np.count_nonzero(base.grouping, axis=1) == 1)
    held = np.argmax(base.grouping[alone] != 0.0, axis=1)
    rotors = base.grouping[alone, held] * prior.nominal[held]
    variance, own = (_ROTOR * rotors) ** 2, solution.covariance[alone, alone]
    # Data that contradict the drive data by more than both uncertainties indicate a wrong table: a rotor without its
    # gear ratio.
    agree = (solution.value[alone] - rotors) ** 2 < _CONTRADICTS**2 * (variance + own)
    known = (held // n == 10) & (rotors > 0.0) & (own > 0.0) & agree
    places = alone[known]
    value, covariance = measured(solution.value, solution.covariance, places, rotors[known], variance[known])
    return places, value[places], covariance


def _gain(robot: Robot, signals: Sequence[FilteredSignals]) -> float:
    """Recorded torque per newton metre of the nominal arm: the median over joints that gravity or inertia load."""
    parts = [tuple(s.decimate(values) for values in (torques(robot.pinocchio, s.q, s.qd, s.qdd), s.tau, s.qd,
                                                     np.sign(s.qd))) for s in signals]
    gains = []
    for j in range(robot.n):
        W = np.concatenate([np.column_stack([m[:, j], np.ones(len(m)), v[:, j], d[:, j]]) for m, _, v, d in parts])
        y = np.concatenate([t[:, j] for _, t, _, _ in parts])
        if np.isnan(y).any():
            continue
        gain = float(np.linalg.lstsq(W, y, rcond=None)[0][0])
        if gain > 0.0 and np.std(gain * W[:, 0]) > 0.2 * np.std(y):
            gains.append(gain)
    return float(np.median(gains)) if gains else 1.0
