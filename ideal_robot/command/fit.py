"""Fits the command's law to recordings: kind, terms, reset time, delay and smoothing per joint, by one score.

The rows are ``F q_c(t - late) - q`` against the terms of the measured motion, low-passed and decimated alike. Kinds,
sets of terms and shapes are compared by the log density with which the recording is predicted block after block
(``ideal_robot.estimate.score``); the noise is an autoregression of the residual of a law with all terms.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import optimize, special
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array
from ideal_robot.command.controllers import CONTROLLERS, Controller
from ideal_robot.command.filters import from_rest
from ideal_robot.command.law import PARTS, Column, CommandLaw, JointLaw, Rival, Shape, error_parts
from ideal_robot.command.motion import Motion
from ideal_robot.command.servo import SERVO, Servo
from ideal_robot.command.smoothing import SMOOTHINGS
from ideal_robot.command.terms import TERMS
from ideal_robot.estimate.gaussian import Posterior, posterior
from ideal_robot.estimate.noise import ColouredNoise
from ideal_robot.estimate.score import BLOCKS, evidence_of, leaves_less

RESET_TIMES = (0.015, 0.04, 0.1, 0.3)
"""Reset times that are tried first [s]: what controllers of machines and of research arms have."""
LATE = (0.0, 0.006, 0.015, 0.03, 0.08, 0.16)
"""Latenesses that are tried first [s]."""
REQUIRED = 8.0
"""Log density that a term has to add [nats]; by chance one term of forty adds 4."""
_RESOLVED = 2e-3
"""Share of ``q_c - q`` above which residuals of two laws differ: a smaller difference is negligible for a path."""
_FLOOR = 5e-4
"""Share of ``q_c - q`` that is added to the noise as white noise, as no law describes a controller exactly."""
_PRIOR = 10.0
"""Standard deviation of a term's contribution before anything is measured, over that of ``q_c - q``."""
_REFINED = 2
"""Kinds without a smoothing that are refined, the best of them by their core."""
_FOLDS = 4
"""Quarters of the recordings, of which every other one is predicted from the rest."""
_WINDOW = 12
"""Rows of a window in which squared residuals are averaged: a tenth to a half of a second."""
_TIMES = ("late", "reset", "time", "a_1", "a_2", "a_i")
"""Attributes of a shape that the search varies."""
_SPREAD = 3.0
"""Prior standard deviation of a time's logarithm, and of the lateness in units of ``_LATER``."""
_LATER = 0.02
"""Lateness that is equivalent to a change of a time's logarithm by one [s]."""
_REACH = 1.5
"""Range of a search to either side of its start, in logarithms of a time: it reaches beyond the next start."""
_LEAST = 1e-9
"""Distance of a bound from a start on it."""
_FAR = 1e3
"""Residual of each whitened row for an impossible shape."""
_FED_FORWARD = 0.01
"""Start value of the time of velocity feedforward [s]."""
_RATE = Column("velocity")
"""Its coefficient is not negative behind a smoothing or with velocity feedforward: a loop does not lead."""
_POWERS = (1, 2)
"""Of a joint's position about its middle, which gains may follow."""


_SIDELOBE = 1e-3
"""Power of the Hann window's largest sidelobe, over that of the line."""


@dataclass(frozen=True)
class Stretch:
    """An interval of a recording at even instants, low-passed.

    Attributes:
        motion: measured, with the torques that the law is fitted with.
        used: the same with the identified model's torques, which are those that commands are made with.
        unseen: ``used`` for each of the two folds, with the torques of a model identified without that fold.
        command: as it was handed over ``(N, n)`` [rad].
        measured: positions without the low-pass ``(N, n)`` [rad].
        noise: standard deviation of one of them ``(n,)`` [rad].
        rows: instants at which the law is evaluated ``(M,)``.
    """

    motion: Motion
    used: Motion
    unseen: tuple[Motion, Motion]
    command: Array
    measured: Array
    noise: Array
    rows: np.ndarray


@dataclass(frozen=True)
class _Found:
    """A law of the search."""

    score: float
    kind: Controller
    shape: Shape
    columns: tuple[Column, ...]


class JointRows:
    """One joint's rows of the regression, with a cache for the search.

    Args:
        stretches, j: of the recordings, and the joint, from 0.
        law: says how postures are measured.
    """

    def __init__(self, stretches: Sequence[Stretch], j: int, law: CommandLaw) -> None:
        self.stretches, self.j, self.law = stretches, j, law
        motion = stretches[0].motion
        self.names = tuple(name for name, term in TERMS.items()
                           if (not term.torque or motion.torque is not None)
                           and (not term.bodies or motion.bodies is not None))
        self.q = [s.motion.q[:, j] for s in stretches]
        self.t = [s.motion.dt * np.arange(float(len(q))) for s, q in zip(stretches, self.q, strict=True)]
        # An empty row between intervals, so that the noise restarts.
        self.use = np.concatenate([np.append(np.ones(len(s.rows), dtype=bool), False) for s in stretches])
        self.blocks = blocks_of([len(s.rows) for s in stretches])
        self.longest = max(float(t[-1]) for t in self.t)
        self.noise = ColouredNoise(np.zeros((1, 0)), np.ones(1))
        self.size = 1.0
        self._columns: dict[tuple[tuple[float, ...], Column], Array] = {}
        self._white: dict[tuple[tuple[float, ...], Column], tuple[Array, float]] = {}
        self._values: dict[Column, list[Array]] = {}
        self._seen: dict[tuple[str, float], list[CubicSpline]] = {}
        self._right: dict[tuple[str, float, float], Array] = {}

    def rows(self, values: Sequence[Array]) -> Array:
        """Values of each interval taken at its rows ``(M,)``, with a zero after each interval."""
        return np.concatenate([np.append(x[s.rows], 0.0) for x, s in zip(values, self.stretches, strict=True)])

    def key(self, shape: Shape, column: Column) -> tuple[tuple[float, ...], Column]:
        """Cache key of a term: the parts of the shape on which its rows depend."""
        poles = (shape.a_1, shape.a_2, shape.a_i)
        return ((shape.reset or 0.0, *poles) if column.of.integrated or any(poles) else (), column)

    def column(self, shape: Shape, column: Column) -> Array:
        """Column of the regression for one term of the law, at the rows ``(M,)``; cached by shape."""
        key = self.key(shape, column)
        if key not in self._columns:
            if column not in self._values:
                self._values[column] = [self.law.values(s.motion, column, self.j) for s in self.stretches]
            parts = []
            for s, x in zip(self.stretches, self._values[column], strict=True):
                if key[0]:
                    num, den = shape.discrete(s.motion.dt)
                    x = from_rest(num[int(column.of.integrated)], den, x)
                parts.append(x)
            self._columns[key] = self.rows(parts)
        return self._columns[key]

    def errors(self, shape: Shape) -> list[Array]:
        """Differences ``e (N,)`` of command and position in each interval, at all of its instants."""
        key = shape.smoothing, shape.time
        if key not in self._seen:
            self._seen[key] = [CubicSpline(t, seen(s, self.j, shape)) for s, t in
                               zip(self.stretches, self.t, strict=True)]
        return [spline(np.maximum(spline.x - shape.late, 0.0)) - q
                for spline, q in zip(self._seen[key], self.q, strict=True)]

    def right(self, shape: Shape) -> Array:
        """Right side of the regression, ``errors`` at the rows ``(M,)``; independent of reset times and poles."""
        key = shape.smoothing, shape.time, shape.late
        if key not in self._right:
            self._right[key] = self.rows(self.errors(shape))
        return self._right[key]

    def raw(self, shape: Shape, columns: Sequence[Column]) -> tuple[Array, Array]:
        """Columns ``(M, m)`` and right side ``(M,)``."""
        return np.column_stack([self.column(shape, c) for c in columns]), self.right(shape)

    def listen(self, shape: Shape, columns: Sequence[Column]) -> None:
        """Sets the noise from the residual of these columns."""
        X, y = self.raw(shape, columns)
        size = np.sqrt(np.mean(X**2, axis=0)) + 1e-300
        self.size = max(float(np.std(y[self.use])), 1e-12)
        left = y - X / size @ np.linalg.lstsq(X / size, y, rcond=1e-9)[0]
        noise = ColouredNoise.fit(left, self.use)
        covariance = noise.autocovariance(noise.order)
        covariance[0] += (_FLOOR * self.size) ** 2
        self.noise = ColouredNoise.of_autocovariance(covariance)
        self._white.clear()

    def has(self, shape: Shape) -> bool:
        """Whether a controller can have the shape: its poles decay, and no time is longer than the recordings."""
        return shape.longest < self.longest and shape.stable

    def products(self, shape: Shape, columns: Sequence[Column]) -> Products:
        """Products of whitened columns in each block."""
        keys = [self.key(shape, column) for column in columns]
        new = {key: self.column(shape, column) for key, column in zip(keys, columns, strict=True)
               if key not in self._white}
        *white, right = self.noise.whiten(np.column_stack([*new.values(), self.right(shape)]), self.use).T
        self._white |= {key: (w, float(np.sqrt(np.mean(x**2)))) for (key, x), w in zip(new.items(), white, strict=True)}
        prior = [_PRIOR * self.size / max(self._white[key][1], 1e-30) for key in keys]
        follows = shape.time or shape.a_1
        positive = np.array([not column.posture and (column.of.yields or bool(follows and column == _RATE))
                             for column in columns])
        return Products(np.column_stack([*(self._white[key][0] for key in keys), right]), self.blocks, np.array(prior),
                        positive)

    def forget(self) -> None:
        """Clears the cache of a finished search."""
        for kept in (self._columns, self._white):
            for key in [key for key in kept if key[0]]:
                del kept[key]
        self._seen.clear()
        self._right.clear()


class Products:
    """Products of the columns in each block of rows, which give the score of any set of columns.

    Args:
        rows: whitened columns and right side ``(M, m + 1)``.
        blocks: of each row, rising ``(M,)``.
        prior: prior standard deviations of the coefficients ``(m,)``.
        positive: whether the coefficient of a column cannot be negative ``(m,)``.
    """

    def __init__(self, rows: Array, blocks: Array, prior: Array, positive: np.ndarray) -> None:
        self.rows = rows
        edges = np.searchsorted(blocks, np.arange(BLOCKS + 1))
        parts = [rows[a:b] for a, b in pairwise(edges)]
        self.G = np.stack([part.T @ part for part in parts])
        self.whole = self.G.sum(axis=0)
        self.precision = np.diag(1.0 / prior**2)
        self.positive = positive

    def _of(self, columns: Sequence[int] | None) -> tuple[np.ndarray, Array, Array]:
        """Indices of some columns ``(k,)``, all if None, their products ``(k + 1, k + 1)`` and prior precision."""
        m = len(self.precision)
        own = np.arange(m) if columns is None else np.asarray(columns, dtype=int)
        whole = np.append(own, m)
        return own, self.whole[np.ix_(whole, whole)], self.precision[np.ix_(own, own)]

    def score(self, columns: Sequence[int] | None = None) -> float:
        """Log density of all rows, block after block predicted from those before."""
        own, products, precision = self._of(columns)
        given = posterior(products, precision)
        score = evidence_of(given, products, precision)
        where = self.positive[own]
        if np.any(where):
            # The prior is the positive half of a normal distribution.
            score += float(np.sum(special.log_ndtr(given.mean[where] / given.std[where]) + np.log(2.0)))
        return score

    def without(self, blocks: np.ndarray) -> Posterior:
        """Coefficients given all but these blocks."""
        return posterior(np.delete(self.G, blocks, axis=0).sum(axis=0), self.precision)

    def left(self) -> Array:
        """Residuals of a least-squares problem at its solution: the rows', then coefficients over prior deviations.

        Their squares add up to what the best coefficients minimise, ``(M + m,)``; coefficients that would be negative
        and cannot be are zero.
        """
        mean = self.solution().mean
        below = self.positive & (mean < 0.0)
        if np.any(below):
            mean = np.zeros(len(mean))
            mean[~below] = self.solution(list(np.flatnonzero(~below))).mean
        return np.append(self.rows[:, -1] - self.rows[:, :-1] @ mean, mean * np.sqrt(np.diag(self.precision)))

    def likelihood(self) -> float:
        """Log density of all rows with the best-fitting coefficients: faster than the score, for start values."""
        return -0.5 * self.solution().squares

    def solution(self, columns: Sequence[int] | None = None) -> Posterior:
        """Coefficients given all blocks."""
        _, products, precision = self._of(columns)
        return posterior(products, precision)


def blocks_of(counts: Sequence[int]) -> Array:
    """Block number, from 0 to ``BLOCKS``, of each row of intervals with the given counts plus one ``(M,)``."""
    ends = np.cumsum([0, *counts])
    return np.asarray(np.concatenate([np.append(np.arange(a, b), b) for a, b in pairwise(ends)])
                      * BLOCKS // (ends[-1] + 1))


def folds(blocks: Array) -> Array:
    """Fold, 0 or 1, of each row's block ``(M,)``: the folds alternate over a few long intervals of time."""
    return blocks * _FOLDS // BLOCKS % 2


def seen(stretch: Stretch, j: int, shape: Shape) -> Array:
    """The commands of a joint at its controller, smoothed but without delay ``(N,)`` [rad].

    Args:
        stretch, j: with the commands, and the joint, from 0.
        shape: with the smoothing.
    """
    own = stretch.command[:, [j]]
    return (shape.filter.seen(own, stretch.motion.dt, shape.time) if shape.time else own)[:, 0]


@dataclass(frozen=True)
class FittedJoint:
    """A joint's fitted law with its residuals, before the error of its coefficients is known.

    Attributes:
        law: of the joint.
        left: its residual of held-out commands, at each interval's rows ``(M,)`` each [rad].
    """

    law: JointLaw
    left: tuple[Array, ...]


def fit_joint(stretches: Sequence[Stretch], j: int, law: CommandLaw) -> FittedJoint:
    """The law of one joint that predicts its commands best.

    Args:
        stretches, j: of the recordings, and the joint, from 0.
        law: says how postures are measured.
    """
    joint = JointRows(stretches, j, law)
    numbers = 2 * tones([stretch.motion for stretch in stretches], j)
    # With known torques the terms of bodies and directions are not needed. But commands are made with the model's
    # torque, and the motion itself may predict friction better than that.
    kinds = [kind for kind in CONTROLLERS if set(kind.core) <= set(joint.names)]
    by_torque = [kind for kind in kinds if any(TERMS[name].torque for name in kind.core)]
    alone, *others = (_judged(joint, found) for found in
                      _searched(joint, [kind for kind in kinds if kind not in by_torque]))
    if not by_torque:
        return beside(alone, others, numbers)
    found, *less = _searched(joint, by_torque)
    usual, servo = _judged(joint, found), _servo(joint, found)
    others += [_judged(joint, one) for one in less]
    # The difference has to exceed chance, and be large enough to change a user's path.
    better = (alone.law.residual + _RESOLVED * alone.law.deviation < usual.law.residual
              and leaves_less(np.concatenate(alone.left), np.concatenate(usual.left)))
    fitted, other = (alone, usual) if better else (usual, alone)
    fitted = beside(fitted, [other, *others], numbers)
    return dataclasses.replace(fitted, law=dataclasses.replace(fitted.law, servo=servo))


def beside(fitted: FittedJoint, others: Sequence[FittedJoint], numbers: int) -> FittedJoint:
    """The law with laws of other kinds that the recording does not exclude.

    Laws that predict a recording nearly equally well differ at other frequencies (see ``probabilities``).

    Args:
        fitted, others: the law, and laws of other kinds of controllers.
        numbers: number of values of a joint's response in a recording: amplitude and phase of each tone.
    """
    among = probabilities([one.law.residual for one in (fitted, *others)], numbers)
    rivals = tuple(Rival(other.law.shape, other.law.columns, other.law.coefficients, float(p))
                   for other, p in zip(others, among[1:], strict=True))
    return dataclasses.replace(fitted, law=dataclasses.replace(fitted.law, rivals=rivals))


def probabilities(left: Sequence[float], numbers: int) -> Array:
    """Probabilities of several descriptions of a joint's response ``(K,)``, from their residuals on one recording.

    Held-out blocks have the same frequencies as the others, and no description is exact: the recording has only as many
    independent numbers as its tones determine. So the odds of two are those of that many Gaussian residuals of unknown
    variance: ``(r_0 / r_k)`` to the power of the numbers.

    Args:
        left: root mean square residual of each on held-out motion [rad].
        numbers: number of values in the recording: amplitude and phase of each tone.
    """
    size = np.maximum(np.asarray(left, dtype=float), 1e-12)
    odds = (size.min() / size) ** numbers
    return np.asarray(odds / odds.sum())


def tones(motions: Sequence[Motion], j: int) -> int:
    """Number of tones in a joint's velocity, at least one: spectral lines above any window's sidelobes.

    Args:
        motions, j: of the recordings, and the joint, from 0.
    """
    longest = max(motions, key=lambda motion: len(motion.qd)).qd[:, j]
    power = np.abs(np.fft.rfft(np.hanning(len(longest)) * (longest - np.mean(longest)))) ** 2
    lines = (power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:]) & (power[1:-1] > _SIDELOBE * power.max())
    return max(int(np.count_nonzero(lines)), 1)


def _servo(joint: JointRows, found: _Found) -> Servo | None:
    """The joint as PD control, by the measured torque; None where that leaves more than the best law by torques does.

    Residuals are compared on rows that neither was fitted to; a difference too small to change a path is ignored.
    """
    if joint.stretches[0].motion.bodies is None:
        return None
    columns = tuple(Column(name) for name in SERVO)
    left = _held_out(joint, (joint, joint), found.shape, found.columns)[0]
    tried = {late: _held_out(joint, (joint, joint), Shape(late=late), columns) for late in (0.0, found.shape.late)}
    late = min(tried, key=lambda late: tried[late][0])
    own, _, solution = tried[late]
    if own > left + _RESOLVED * joint.size:
        return None
    return Servo.of(dict(zip(SERVO, solution.mean, strict=True)), solution.covariance, late)


def _searched(joint: JointRows, kinds: Sequence[Controller]) -> list[_Found]:
    """Laws of some kinds of controllers, the one first that predicts a joint's commands best."""
    whole = {name for kind in kinds for name in (*kind.core, *kind.more) if name in joint.names}
    joint.listen(Shape(0.06), [Column(name) for name in sorted(whole)])
    starts: list[_Found] = []
    for kind in kinds:
        core = tuple(Column(name) for name in ("offset", *kind.core))
        for name, smoothing in SMOOTHINGS.items():
            shapes = (Shape(reset, late, name, time, *poles) for time, late, reset, poles in itertools.product(
                smoothing.times or (0.0,), LATE if name == "none" else LATE[::2],
                RESET_TIMES if kind.integrator else (None,), kind.poles or ((0.0, 0.0, 0.0),)))
            starts.append(max((_Found(joint.products(shape, core).likelihood(), kind, shape, core)
                               for shape in shapes), key=lambda found: found.score))
    plain = _best([start for start in starts if not start.shape.time])
    # The grid of times is coarse, so each smoothing is tuned before the best are chosen.
    smoothed = _best([_tuned(joint, start) for start in starts if start.shape.time])
    smoothed += [other for found in smoothed if (other := _exchanged(joint, found))]
    refined = [_refined(joint, start) for start in (*plain, *smoothed)]
    joint.forget()
    return sorted(refined, key=_earned, reverse=True)


def _best(laws: Sequence[_Found]) -> list[_Found]:
    """The laws to refine."""
    return sorted(laws, key=_earned, reverse=True)[:_REFINED]


def _earned(found: _Found) -> float:
    """Score that compares kinds and shapes: integrator, smoothing and each pole have to add ``REQUIRED``, as a term."""
    return found.score - REQUIRED * found.shape.members


def _exchanged(joint: JointRows, found: _Found) -> _Found | None:
    """The law whose smoothing has the lag of its position loop, as a new start; None without a position loop.

    In slow motion a lag and a position loop differ by little else than the response to torques.
    """
    if _RATE not in found.columns:
        return None
    slow = float(joint.products(found.shape, found.columns).solution().mean[found.columns.index(_RATE)])
    if slow <= 0.0:
        return None
    return dataclasses.replace(found, shape=dataclasses.replace(found.shape, time=slow / found.shape.filter.delay))


def _judged(joint: JointRows, found: _Found) -> FittedJoint:
    """The law with its coefficients, and its residual on motion that they were not fitted to.

    Coefficients come from rows with the measured torque or with the model's, whichever leaves less.
    """
    used, *unseen = ([dataclasses.replace(s, motion=motion) for s, motion in zip(joint.stretches, motions, strict=True)]
                     for motions in zip(*((s.used, *s.unseen) for s in joint.stretches), strict=True))
    sources = (joint, JointRows(used, joint.j, joint.law)) if any(column.of.torque for column in found.columns
                                                                  ) else (joint,)
    predicted = [JointRows(each, joint.j, joint.law) for each in unseen]
    error, left, solution = min((_held_out(source, predicted, found.shape, found.columns) for source in sources),
                                key=lambda judged: judged[0])
    deviation = np.concatenate([(s.command[:, joint.j] - q)[s.rows]
                                for s, q in zip(joint.stretches, joint.q, strict=True)])
    own = JointLaw(found.shape, found.columns, solution.mean, solution.covariance, np.zeros(PARTS),
                   float(np.std(deviation)), float(error), found.kind.name)
    return FittedJoint(own, tuple(np.split(left[joint.use], np.cumsum([len(s.rows) for s in joint.stretches])[:-1])))


def _held_out(source: JointRows, predicted: Sequence[JointRows], shape: Shape, columns: Sequence[Column]
              ) -> tuple[float, Array, Posterior]:
    """Residual of a law on rows that its coefficients were not fitted to.

    Args:
        source, predicted: rows that coefficients come from, and those that they predict in each fold.
        shape, columns: of the law.

    Returns:
        Root mean square [rad], residuals ``(M,)`` [rad], and the coefficients given all rows of the source.
    """
    y, fold = source.right(shape), folds(source.blocks)
    source.listen(shape, columns)
    products = source.products(shape, columns)
    left = np.empty_like(y)
    for held_out, other in enumerate(predicted):
        rows, X = fold == held_out, other.raw(shape, columns)[0]
        left[rows] = (y - X @ products.without(np.unique(source.blocks[rows])).mean)[rows]
    return float(np.sqrt(np.mean(left[source.use] ** 2))), left, products.solution()


def with_error(fitted: FittedJoint, stretches: Sequence[Stretch], j: int, response: Array) -> JointLaw:
    """The law with the standard deviation of the position error of its commands.

    Args:
        fitted, stretches, j: law, the recordings it is from, and the joint, from 0.
        response: of its position to its command ``(N // 2 + 1,)``, over ``N`` instants at the motion's spacing.
    """
    missed = []
    for left, stretch in zip(fitted.left, stretches, strict=True):
        step = int(np.diff(stretch.rows).min()) if len(stretch.rows) > 1 else 1
        row = (stretch.rows - stretch.rows[0]) // step
        even = np.zeros(2 * (row[-1] + 1))
        even[row] = left
        frequency = np.fft.rfftfreq(len(even), step)
        own = np.interp(frequency, np.linspace(0.0, 0.5, len(response)), response)
        missed.append(np.fft.irfft(np.fft.rfft(even) * own, len(even))[row])
    noise = float(np.sqrt(np.mean([s.noise[j] ** 2 for s in stretches])))
    return dataclasses.replace(fitted.law, error=variances(missed, stretches, j), noise=noise)


def variances(missed: Sequence[Array], stretches: Sequence[Stretch], j: int) -> Array:
    """Coefficients ``(PARTS,)`` of a position's error variance [rad²] in the regressors of ``error_parts``.

    A non-negative fit of the mean squared error in short windows by the parts' means in them.

    Args:
        missed: the error at each stretch's rows ``(M,)`` each [rad].
        stretches, j: of the recordings, and the joint, from 0.
    """
    left = np.concatenate(missed)
    parts = np.concatenate([error_parts(s.motion)[s.rows, :, j] for s in stretches])
    count = max(len(left) // _WINDOW, 4)
    windows = np.array_split(np.arange(len(left)), count)
    squares = np.array([np.mean(left[w] ** 2) for w in windows])
    X = np.array([np.mean(parts[w], axis=0) for w in windows])
    # A joint that stays on one encoder increment is predicted without any error.
    if not np.any(squares > 0.0):
        return np.zeros(X.shape[1])
    size = np.maximum(np.mean(X, axis=0), 1e-300)
    # Squares scatter in proportion to their size, so each window is weighted by its mean.
    weight = 1.0 / (squares + np.mean(squares))
    found, _ = optimize.nnls(weight[:, None] * X / size, weight * squares)
    total = float(np.mean(X / size @ found))
    return np.asarray(found / size * (np.mean(squares) / total if total > 0.0 else 1.0))


def _refined(joint: JointRows, found: _Found) -> _Found:
    """Times and terms by the score, in turns."""
    found = _tuned(joint, found)
    for _ in range(2):
        before = found
        found = _tuned(joint, _selected(joint, _fed_forward(joint, found)))
        if found.columns == before.columns and found.shape.members == before.shape.members:
            break
    return found


def _fed_forward(joint: JointRows, found: _Found) -> _Found:
    """The law with velocity feedforward, if that raises the score as required."""
    if found.shape.a_1:
        return found
    more = _tuned(joint, dataclasses.replace(found, shape=dataclasses.replace(found.shape, a_1=_FED_FORWARD)))
    return max(found, more, key=_earned)


def _selected(joint: JointRows, found: _Found) -> _Found:
    """Terms added one by one while the score rises as required, then those taken out that it does not miss."""
    shape = found.shape
    present = [c for c in found.columns]
    pool = [*present, *(Column(name) for name in found.kind.more if name in joint.names and Column(name) not in present
                        and not (shape.reset is None and TERMS[name].same))]
    n = joint.law.middle.size
    pool += [column for name in ("velocity", "torque") if name in joint.names
             for i in range(1, n + 1) for power in _POWERS
             if (column := Column(name, i, power)) not in pool and Column(name) in pool]
    products = joint.products(shape, pool)
    own = list(range(len(present)))
    score = products.score(own)
    while (added := _best_addition(products, shape, pool, own, score)) is not None:
        score, i = added
        own.append(i)
    core = 1 + len(found.kind.core)
    removed = True
    while removed:
        removed = False
        for i in own[core:]:
            rest = [k for k in own if k != i]
            if any(pool[k].posture and pool[k].term == pool[i].term for k in rest) and not pool[i].posture:
                continue
            less = products.score(rest)
            if less > score - REQUIRED:
                own, score, removed = rest, less, True
                break
    return _Found(score, found.kind, shape, tuple(pool[k] for k in own))


def _best_addition(products: Products, shape: Shape, pool: Sequence[Column], own: Sequence[int], score: float
                   ) -> tuple[float, int] | None:
    """The term that raises the score most, and to what; None where none raises it as required."""
    scored = sorted(((products.score([*own, i]), i) for i in range(len(pool)) if i not in own and (
        not pool[i].posture or pool.index(Column(pool[i].term)) in own)), reverse=True)
    return next(((better, i) for better, i in scored
                 if better >= score + REQUIRED), None)


def _tuned(joint: JointRows, found: _Found) -> _Found:
    """The law with the times of its shape that fit best, near those given, and with its score.

    A lag, a lateness and a reset time have similar effects, so all are varied at once: nonlinear least squares of the
    whitened rows, with the best coefficients for each shape (variable projection). Only the lateness may start at zero.
    The score includes the cost of the times, their Gaussian prior against their precision (Laplace).
    """
    names = [name for name in _TIMES if getattr(found.shape, name) or name == "late"]
    start = np.array([getattr(found.shape, name) for name in names])
    late = np.array(names) == "late"

    def shape(x: Array) -> Shape:
        own = np.where(late, np.maximum(start + _LATER * (x - 1.0), 0.0), start * np.exp(x - 1.0))
        times: dict[str, Any] = {name: float(time) for name, time in zip(names, own, strict=True)}
        return dataclasses.replace(found.shape, **times)

    def left(x: Array) -> Array:
        tried = shape(x)
        if not joint.has(tried):
            return np.full(len(joint.use) + len(found.columns), _FAR)
        return joint.products(tried, found.columns).left()

    # Variables start at one, as difference steps are relative.
    low, high = np.where(late, 1.0 - start / _LATER - _LEAST, 1.0 - _REACH), np.full(len(names), 1.0 + _REACH)
    best = optimize.least_squares(left, np.ones(len(names)), bounds=(low, high), diff_step=1e-4, max_nfev=20, ftol=1e-4,
                                  xtol=1e-5)
    known = np.linalg.slogdet(np.eye(len(names)) + _SPREAD**2 * best.jac.T @ best.jac)[1]
    tuned = shape(best.x)
    return dataclasses.replace(found, shape=tuned, score=joint.products(tuned, found.columns).score() - 0.5 * known)
