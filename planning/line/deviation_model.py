"""Models of the deviation Δx_r between the reference path and the sensed path ([L] 4.3).

A model defines the state of the deviation, how the deviation at an arc length follows linearly from it, the prior, and
how the state changes while the arm travels.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from ideal_robot.arrays import Array
from planning.path.path_kernels import Rigid, Splines, deviation_basis
from planning.path.reference import ReferencePath


class Stand(NamedTuple):
    """Position of a state's window: arc length of its first place, and of the tool [m]."""

    begin: float = -np.inf
    s: float = 0.0


class DeviationModel(ABC):
    """Interface of the deviation models.

    Attributes:
        directions: number of sensed directions: 1 lateral (along the path's ``normal``), 2 also height (``up``).
        size: number of states.
        drifts: whether the state changes with the tool's way, so that the order of measurements matters.
    """

    directions: int
    size: int
    drifts: bool = False

    @abstractmethod
    def prior(self) -> tuple[Array, Array]:
        """State ``(size,)`` and covariance ``(size, size)`` before anything was measured."""

    @property
    def begin(self) -> float:
        """Arc length at which the state's window begins [m]."""
        return -np.inf

    @abstractmethod
    def basis(self, s: Array, stand: Stand | None = None) -> Array:
        """Deviation per state ``(m, directions, size)`` at ``s (m,)`` [m]; ``stand``: the present window if None."""

    def travel(self, s: float) -> tuple[Array, Array] | None:
        """Transition ``(F, Q)`` of the state when the arm has come to arc length ``s``; None if there is none (yet)."""
        return None

    def carry(self, way: float, out: tuple[Array, Array] | None = None) -> tuple[Array, Array] | None:
        """Transition ``(F, Q)`` of the state when the tool advances by ``way`` [m]; None if there is none.

        ``out`` are matrices of an earlier call that are overwritten with the result; new ones if None.
        """
        return None

    def told(self, s: Array, stand: Stand) -> bool:
        """Whether earlier measurements bear on the deviation at ``s (m,)`` [m] through the state alone.

        If so, a late measurement there may be fused as if it were on time.
        """
        return not self.drifts

    def spread(self, s: Array, stand: Stand) -> Array | None:
        """Variance at ``s (m,)`` of shapes that the state cannot represent ``(m, directions)`` [m²]; None for none."""
        return None


SHAPES = (0.003, 0.1), (0.006, 0.1), (0.02, 0.15)
"""How far a line's shape leaves its reference's [m], standard deviation, and over which distance that becomes another
[m]: drawn again by hand, drawn otherwise, another line."""
COPIED = 0.001, 0.1
"""The same of a line that was drawn as its reference is, which a camera mounted by hand cannot tell."""
_FIELD = 5
"""Points of a field ([L] 5)."""


class Expected(NamedTuple):
    """Prior of a deviation in one direction: standard deviations, and the distance over which it changes.

    Attributes:
        displacement, rotation: of the whole line [m, rad].
        shape, length: change of shape, and distance over which it becomes another [m].
    """

    displacement: float = 0.02
    rotation: float = 0.05
    shape: float = SHAPES[0][0]
    length: float = SHAPES[0][1]


class PathDeviation(DeviationModel):
    r"""A displacement and rotation of the whole line, plus a smooth change of its shape along the path.

    .. math::
        \Delta x_r(s) = g(s)^T \left(\tau + \varphi \times (p(s) - p_0)\right) + \sum_j B_j(s)\, c_j

    with the direction ``g`` sensed, a rigid motion ``(τ, φ)`` common to all places, and cubic B-splines on even knots.
    The coefficients ``c`` are a stationary random process (Matérn 7/2) with a standard deviation and a length: places
    with measurements follow them; places ahead of all measurements tend to the rigid motion, with a growing variance.
    Only the coefficients around the arm are states: when it has passed a knot, the oldest one is dropped and a new one
    is predicted ahead from its neighbours. This window is the only mutable part, so each filter needs its own object.

    Args:
        reference: the path.
        across: prior across the path.
        up: prior along the surface normal, with its rotation about the surface's axes; None where only the lateral
            deviation is sensed.
        ahead, behind: how far in front of the arm the deviation is needed, and how far behind it is kept [m].
        knot: spacing of the knots [m].
    """

    def __init__(self, reference: ReferencePath, *, across: Expected | None = None, up: Expected | None = None,
                 ahead: float = 0.4, behind: float = 0.05, knot: float = 0.025) -> None:
        across = across or Expected()
        self.directions, self.reference = 1 if up is None else 2, reference
        self._knot, self._behind = knot, behind
        self._count = int(np.ceil((ahead + behind) / knot)) + 4
        self._start = -behind
        self.rigid = 3 if up is None else 6
        self.size = self.rigid + self.directions * self._count
        centre = reference.position(np.linspace(0.0, reference.length, 50)).mean(axis=0)
        distance = knot * np.abs(np.subtract.outer(np.arange(self._count), np.arange(self._count)))
        self._prior = np.zeros((self.size, self.size))
        moved = [across.displacement] * 2 + ([] if up is None else [up.displacement] + [up.rotation] * 2)
        self._prior[: self.rigid, : self.rigid] = np.diag(np.square([*moved, across.rotation]))
        self._F, self._Q = np.eye(self.size), np.zeros((self.size, self.size))
        for block, expected in zip(self._blocks(), (across, up or across), strict=False):
            sigma, process = expected.shape, expected.shape**2 * matern(distance, expected.length)
            self._prior[block, block] = process
            # The new coefficient given its predecessors, of the same process.
            old, new = process[:-1, :-1], process[-1, :-1]
            gain = np.linalg.solve(old + 1e-10 * sigma**2 * np.eye(self._count - 1), new)
            shift = np.eye(self._count, k=1)
            shift[-1, 1:] = gain
            self._F[block, block] = shift
            last = block.stop - 1
            self._Q[last, last] = max(process[-1, -1] - float(new @ gain), 1e-12 * sigma**2)
        # Axes of the surface at the path's start span the rigid motion.
        start = reference.frames(0.0)
        self._turning = Rigid(centre, np.stack([start.tangent, start.normal, start.up]), self.rigid)

    def prior(self) -> tuple[Array, Array]:
        """Mean and covariance of the state before any measurement; of a stationary process the same in any window."""
        return np.zeros(self.size), self._prior.copy()

    @property
    def begin(self) -> float:
        """Arc length at which the window begins [m]."""
        return self._start

    def basis(self, s: Array, stand: Stand | None = None) -> Array:
        """Rigid part and B-splines; outside the window the splines stay at its edge."""
        s = np.asarray(s, dtype=float)
        frames = self.reference.frames(s)
        splines = Splines(self._start if stand is None else stand.begin, self._knot, self._count)
        return np.asarray(deviation_basis(frames.position, (frames.normal, frames.up), self.directions, self._turning,
                                          s, splines))

    def travel(self, s: float) -> tuple[Array, Array] | None:
        """Transition ``(F, Q)`` that shifts the window by one knot; None until the arm has passed that knot."""
        if s - self._behind < self._start + self._knot:
            return None
        self._start += self._knot
        return self._F, self._Q

    def _blocks(self) -> list[slice]:
        return [
            slice(self.rigid + i * self._count, self.rigid + (i + 1) * self._count) for i in range(self.directions)
        ]


def shape_likelihoods(reference: ReferencePath, s: Array, deviation: Array, covariance: Array) -> Array:
    """Log likelihoods of a sensed line for each of ``SHAPES``, whatever its position and rotation.

    Args:
        reference: the path.
        s: arc lengths along it ``(m,)`` [m].
        deviation: deviation that was seen there ``(m,)`` [m].
        covariance: of that ``(m, m)`` [m²].
    """
    moved, distance = _moved(reference, s) + covariance, np.abs(np.subtract.outer(s, s))
    return np.array([_log_density(deviation, moved + shape**2 * matern(distance, length)) for shape, length in SHAPES])


def _log_density(values: Array, covariance: Array) -> float:
    """Logarithm of the Gaussian density of values ``(m,)`` about zero; of no value it is 0."""
    triangle = np.linalg.cholesky(covariance)
    white = solve_triangular(triangle, values, lower=True)
    return float(-0.5 * white @ white - np.log(np.diag(triangle)).sum() - 0.5 * len(values) * np.log(2.0 * np.pi))


def fitting_shape(reference: ReferencePath, s: Array, deviation: Array, sigma: float,
                  likeliest: tuple[float, float]) -> tuple[float, float]:
    """The first shape, from the likeliest on, by whose prior no field of the line is an outlier; else the likeliest.

    The likeliest shape of the whole line may smooth over one narrow bend. A field of five points is no outlier where,
    given all points before it, it is within the shape's 99 % region. ``COPIED`` comes before the first of ``SHAPES``.

    Args:
        reference: the path.
        s: arc lengths along it ``(m,)``, ascending [m].
        deviation: deviation that was seen there ``(m,)`` [m].
        sigma: standard deviation of that [m].
        likeliest: one of ``SHAPES``.
    """
    moved, distance = _moved(reference, s) + sigma**2 * np.eye(len(s)), np.abs(np.subtract.outer(s, s))
    first = SHAPES.index(likeliest)
    for shape, length in ((COPIED, *SHAPES) if first == 0 else SHAPES[first:]):
        triangle = np.linalg.cholesky(moved + shape**2 * matern(distance, length))
        news = solve_triangular(triangle, deviation, lower=True) ** 2
        if np.convolve(news, np.ones(_FIELD)).max() < chdtri(_FIELD, 0.01):
            return shape, length
    return likeliest


def _moved(reference: ReferencePath, s: Array) -> Array:
    """Covariance of a line's deviations at ``s`` ``(m, m)`` [m²] by where the whole lies and how it is turned."""
    model = PathDeviation(reference)
    rigid = model.basis(s)[:, 0, : model.rigid]
    return np.asarray(rigid @ model.prior()[1][: model.rigid, : model.rigid] @ rigid.T)


def matern(distance: Array, length: float) -> Array:
    """Correlation of the Matérn process with ν = 7/2 at a distance."""
    r = np.sqrt(7.0) * distance / length
    return np.asarray((1.0 + r + 0.4 * r**2 + r**3 / 15.0) * np.exp(-r))
