"""Geometry of a dense polyline: points by arc length, nearest points, signed lateral distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError


@dataclass(frozen=True)
class Nearest:
    """Nearest points on the line.

    Attributes:
        distance: distance ``(m,)`` [m], in space.
        s: arc length of the foot ``(m,)`` [m].
        lateral: signed distance in the plane, positive to the left of the line ``(m,)`` [m].
        foot: nearest points on the line ``(m, 3)`` [m].
    """

    distance: Array
    s: Array
    lateral: Array
    foot: Array


class Polyline:
    """Points joined by straight segments, in space.

    Args:
        points: at least two, neighbours apart ``(N, 3)`` [m].

    Raises:
        InputError: too few points, or two neighbours coincide.
    """

    def __init__(self, points: Array) -> None:
        self.points = np.asarray(points, dtype=float)
        if self.points.ndim != 2 or self.points.shape[1] != 3 or len(self.points) < 2:
            raise InputError("expected at least two points, shape (N, 3)", field="line.points",
                             value=self.points.shape)
        step = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        if np.any(step <= 0.0):
            raise InputError("two neighbouring points of the line coincide", field="line.points",
                             value=int(np.argmin(step)))
        self.s: Array = np.concatenate([[0.0], np.cumsum(step)])
        self._step = step
        self._direction = np.diff(self.points, axis=0) / step[:, None]
        self._tree = cKDTree(self.points)

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(self.s[-1])

    def at(self, s: Array) -> tuple[Array, Array]:
        """Points ``(m, 3)`` [m] and unit tangents ``(m, 3)`` at arc lengths ``(m,)`` [m], clipped to the ends."""
        s = np.clip(np.asarray(s, dtype=float), 0.0, self.s[-1])
        i = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2)
        tangent = self._direction[i]
        return self.points[i] + (s - self.s[i])[:, None] * tangent, tangent

    def nearest(self, points: Array, up: Array) -> Nearest:
        """Exact nearest points to ``(m, 3)`` [m]; ``up (3,)`` is the surface normal that says where left is.

        The nearest vertex is found first; the foot lies on one of the two segments at it, which holds for every
        polyline whose segments are shorter than its distance from other parts of itself.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        vertex = self._tree.query(points)[1]
        best = np.full(len(points), np.inf)
        s = np.empty(len(points))
        foot, tangent = np.empty_like(points), np.empty_like(points)
        for segment in (np.maximum(vertex - 1, 0), np.minimum(vertex, len(self._step) - 1)):
            a, direction = self.points[segment], self._direction[segment]
            along = np.clip(np.einsum("ij,ij->i", points - a, direction), 0.0, self._step[segment])
            candidate = a + along[:, None] * direction
            distance = np.linalg.norm(points - candidate, axis=1)
            closer = distance < best
            best[closer] = distance[closer]
            s[closer] = (self.s[segment] + along)[closer]
            foot[closer], tangent[closer] = candidate[closer], direction[closer]
        left = np.cross(up, tangent)
        return Nearest(best, s, np.einsum("ij,ij->i", points - foot, left), foot)
