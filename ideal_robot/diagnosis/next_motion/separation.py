"""Predicts how well a motion distinguishes two causes: T-optimality (Atkinson & Fedorov 1975).

If cause a is the true one it adds ``y = C_a(theta_a) c_a`` to the channels. The part of it that neither the model's
parameters nor the rival can imitate, whatever the rival's numbers, distinguishes the two:

    d² = min over theta_b of  y' (I - A (A'A + P)⁺ A') y ,    A = [W, C_b(theta_b)] ,

rows weighted with 1/σ of their channel; ``P`` is the prior precision of the parameters. The difference of the two fits'
squares is then ``d²`` with a standard deviation of ``2 d`` (times the factor for coloured noise): Box & Hill (1967).

All of it follows from cross-products of columns, and those of two motions, one after the other, add up.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import add

import numpy as np
from scipy import linalg

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.best_set import CLASS_ERROR
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.effects import MOTOR_TORQUE, Domain
from ideal_robot.estimate.score import TOLD
from ideal_robot.tolerances import PRODUCTS

NEARLY = 0.95
"""Share of a cause from which on what imitates it stays its rival: the class errs by as much in any direction."""
VISIBLE_SHARE = (4.0 * CLASS_ERROR) ** 2
"""Share of a channel's squares from which on a cause is named: four times what the class may err by, in amplitude."""


@dataclass(frozen=True)
class Cause:
    """A cause with its fitted numbers.

    Attributes:
        candidate: effect, joint and theta.
        coefficients: ``(m,)``.
        thetas: values of theta that it may take as a rival.
    """

    candidate: Candidate
    coefficients: Array
    thetas: tuple[tuple[float, ...], ...]

    @property
    def label(self) -> str:
        """Name and place in words."""
        joint = self.candidate.joint
        return f"{self.candidate.effect.name} in joint {joint}" if joint else self.candidate.effect.name


@dataclass(frozen=True)
class Separation:
    """How well a motion distinguishes a pair, in the less favourable of the two cases.

    Attributes:
        sigma: expected distance of the two in standard deviations of the noise.
        own_share: share of the cause that its rival cannot imitate; a rival that imitates more than ``NEARLY`` is never
            excluded.
        seen_share: share of the residual's squares that the cause makes up.
    """

    sigma: float
    own_share: float
    seen_share: float

    @property
    def told_apart(self) -> bool:
        """Whether a recording should distinguish them; the difference of squares has the deviation ``2 sigma``."""
        return 0.5 * self.sigma >= TOLD and self.own_share >= 1.0 - NEARLY

    @property
    def margin(self) -> float:
        """The criterion by which a motion is chosen: 1 where a diagnosis would just find and distinguish the cause."""
        return min(0.5 * self.sigma / TOLD, self.own_share / (1.0 - NEARLY), self.seen_share / VISIBLE_SHARE)


@dataclass(frozen=True)
class Products:
    """Cross-products of a pair's columns over a motion, which add up over motions.

    Attributes:
        sides: for each of the two cases: ``y'y`` per channel ``(c,)``, the matrix of ``[W, others, y]``, and for each
            theta of the rival that of ``[A, y]``.
        samples: samples of each channel ``(c,)``.
    """

    sides: tuple[tuple[Array, ...], ...]
    samples: Array

    def __add__(self, other: Products) -> Products:
        sides = tuple(tuple(map(add, a, b)) for a, b in zip(self.sides, other.sides, strict=True))
        return Products(sides, self.samples + other.samples)


@dataclass(frozen=True)
class Pair:
    """A cause and its rival that a motion shall distinguish; without a rival, a cause and no cause.

    Attributes:
        cause, rival: the two.
        others: further causes, whose numbers are free.
        weights: 1/σ² of each channel ``(c,)``.
        colour: number of samples worth one independent sample, as the noise is coloured.
        root: matrix ``R (p, k)``, the covariance of the model's parameters being ``R R'``, or None.
        domain: the domain in which the two differ.
    """

    cause: Cause
    rival: Cause | None
    others: tuple[Candidate, ...]
    weights: Array
    colour: float
    root: Array | None
    domain: Domain = MOTOR_TORQUE

    def products(self, made: Regression) -> Products:
        """Products of the pair's columns over the motion of a regression, without its measured values."""
        scale = np.sqrt(self.weights) * made.use

        def rows(candidate: Candidate, theta: tuple[float, ...]) -> Array:
            return np.asarray(made.columns_of(candidate.effect, candidate.joint, theta) * scale[:, :, None])

        def gram(*columns: Array) -> Array:
            flat = np.concatenate(columns, axis=2)
            flat = flat.reshape(-1, flat.shape[2])
            return np.asarray(flat.T @ flat)

        W = made.W if self.root is None else made.W @ self.root
        known = [W * scale[:, :, None], *(rows(candidate, candidate.theta) for candidate in self.others)]
        sides = []
        causes = [self.cause] if self.rival is None else [self.cause, self.rival]
        for true in causes:
            y = rows(true.candidate, true.candidate.theta) @ true.coefficients
            beside = [gram(*known, rows(rival.candidate, theta), y[:, :, None])
                      for rival in causes if rival is not true for theta in rival.thetas]
            sides.append(((y**2).sum(axis=0), gram(*known, y[:, :, None]), *beside))
        return Products(tuple(sides), made.use.sum(axis=0).astype(float))

    def separation(self, products: Products) -> Separation:
        """How well the motions of the products distinguish the two."""
        results, known = [], 0 if self.root is None else self.root.shape[1]
        for energy, *matrices in products.sides:
            rest, *beside = (max(_left(matrix, known), 0.0) for matrix in matrices)
            whole, strongest = max(float(energy.sum()), 1e-300), int(np.argmax(energy))
            count = max(float(products.samples[strongest]), 1.0)
            if self.rival is None:
                # With the amplitude of the noise, whatever its unit.
                results.append((float(np.sqrt(rest / whole * count / self.colour)), 1.0, 1.0))
                continue
            # The channel with the largest contribution, relative to noise of one.
            own, part = min(beside), rest * float(energy[strongest]) / whole
            results.append((float(np.sqrt(own / self.colour)), own / max(rest, 1e-300), part / (part + count)))
        return Separation(*map(min, zip(*results, strict=True)))


def _left(matrix: Array, known: int) -> float:
    """Squares of the last column that the others leave; ``known`` first ones are in units of what is known of them.

    Args:
        matrix: products of all ``(m, m)``.
        known: how many.
    """
    A, across, square = matrix[:-1, :-1].copy(), matrix[:-1, -1], float(matrix[-1, -1])
    A[np.arange(known), np.arange(known)] += 1.0
    diagonal = np.diag(A)
    used = diagonal > 0.0
    scale = 1.0 / np.sqrt(diagonal[used])
    inner = A[np.ix_(used, used)] * np.outer(scale, scale) + PRODUCTS * np.eye(int(used.sum()))
    right = scale * across[used]
    return square - float(right @ linalg.solve(inner, right, assume_a="pos"))
