"""What an arm does when: at rest, at constant velocity, near a reversal, and which joint moves alone."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.signals.preprocess import FilteredSignals


@dataclass(frozen=True)
class Segment:
    """A stretch of samples ``start … stop - 1`` of one joint.

    Attributes:
        joint: joint, counted from 0.
        kind: ``rest``, ``constant`` (velocity), ``reversal`` or ``other``.
        start, stop: sample range.
        velocity: mean velocity in it [rad/s].
    """

    joint: int
    kind: str
    start: int
    stop: int
    velocity: float


def moving(s: FilteredSignals, share: float = 0.01, least: float = 2e-3) -> np.ndarray:
    """Mask ``(N, n)`` of joints in motion: faster than a share of the joint's own largest speed, and than ``least``.

    Args:
        s: filtered signals of ``N`` samples.
        share: of the joint's largest speed, 0 … 1.
        least: speed [rad/s].
    """
    fastest = np.max(np.abs(s.qd), axis=0)
    return np.asarray(np.abs(s.qd) > np.maximum(share * fastest, least))


def segments(s: FilteredSignals, *, shortest: float = 0.08, flat: float = 0.05) -> list[Segment]:
    """Cuts every joint's motion into segments.

    Args:
        s: filtered signals.
        shortest: of a segment at rest or at constant velocity [s].
        flat: constant means that the acceleration is below this share of the joint's largest.
    """
    result = []
    moves = moving(s)
    for j in range(s.q.shape[1]):
        steady = np.abs(s.qdd[:, j]) < flat * max(float(np.max(np.abs(s.qdd[:, j]))), 1e-9)
        near = _near_reversal(s.qd[:, j], moves[:, j], round(shortest / s.dt))
        label = np.where(near, 2, np.where(~moves[:, j], 0, np.where(steady, 1, 3)))
        for start, stop in runs(label):
            kind = ("rest", "constant", "reversal", "other")[label[start]]
            if kind in ("rest", "constant") and (stop - start) * s.dt < shortest:
                kind = "other"
            result.append(Segment(j, kind, start, stop, float(np.mean(s.qd[start:stop, j]))))
    return result


def runs(label: np.ndarray) -> list[tuple[int, int]]:
    """Ranges ``(start, stop)`` of equal neighbouring values."""
    edges = np.flatnonzero(np.diff(label)) + 1
    return list(zip([0, *edges.tolist()], [*edges.tolist(), len(label)], strict=True))


def alone(s: FilteredSignals, joint: int) -> list[tuple[int, int]]:
    """Ranges in which only this joint moves, from its first to its last motion between those of other joints."""
    moves = moving(s)
    others = np.any(np.delete(moves, joint, axis=1), axis=1) if moves.shape[1] > 1 else np.zeros(len(s.t), dtype=bool)
    found = []
    for start, stop in runs(others.astype(int)):
        if others[start]:
            continue
        own = np.flatnonzero(moves[start:stop, joint])
        if len(own):
            found.append((start + int(own[0]), start + int(own[-1]) + 1))
    return found


def _near_reversal(qd: Array, moves: np.ndarray, width: int) -> np.ndarray:
    """Samples within ``width`` of a change of direction, standstills between two directions included."""
    sign = np.where(moves, np.sign(qd), 0.0)
    known = np.flatnonzero(sign)
    near = np.zeros(len(qd), dtype=bool)
    for a, b in itertools.pairwise(known.tolist()):
        if sign[a] != sign[b] and b - a <= 4 * width:
            near[max(0, a - width): b + width] = True
    return near
