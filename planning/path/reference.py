"""The reference path x_r: position and tool orientation over arc length ([L] 4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array, arc_lengths, interpolated
from ideal_robot.errors import InputError
from ideal_robot.tolerances import PATH_SPACING, ROUNDING
from planning.path.path_kernels import dot, exp, feet_of, frames_at, unit

# Points of a curve at even steps of arc length.



def _even_steps(points: Array, chord: Array, smoothing: float) -> tuple[Array, Array]:
    """Averages the points and gives them even steps of arc length: points ``(K, 3)`` and arc lengths ``(K,)``.

    The curve is averaged twice over half of ``smoothing`` [m]; ``chord (N,)`` is the length along the polygon [m].
    """
    fine = max(round(chord[-1] / 0.0005), 20)
    grid = np.linspace(0.0, chord[-1], fine + 1)
    # Sparse points are corners of a polygon, dense ones a curve.
    curve = CubicSpline(chord, points)(grid) if len(points) > 50 else interpolated(grid, chord, points)
    width = round(0.5 * smoothing / (grid[1] - grid[0]))
    curve = averaged(averaged(curve, width), width)
    for _ in range(3):
        s = arc_lengths(curve)
        spline = CubicSpline(s, curve)
        # Chords are shorter than arcs: Gauss' rule on each piece gives the arc length that the spline really has.
        node, weight = np.polynomial.legendre.leggauss(3)
        half = 0.5 * np.diff(s)
        nodes = s[:-1, None] + half[:, None] * (1.0 + node)
        s = np.concatenate([[0.0], np.cumsum(half * (np.linalg.norm(spline(nodes, 1), axis=2) @ weight))])
        count = max(round(s[-1] / PATH_SPACING), 10)
        knots = np.linspace(0.0, s[-1], count + 1)
        curve = CubicSpline(s, curve)(knots)
        if len(curve) == len(s):
            break
    return curve, np.linspace(0.0, s[-1], len(curve))


def averaged(values: Array, width: int) -> Array:
    """Moving average over ``width`` samples; beyond the ends the values go on by point reflection, so the ends stay."""
    half = width // 2
    if half < 1:
        return values
    half = min(half, len(values) - 1)
    before, after = 2 * values[:1] - values[half:0:-1], 2 * values[-1:] - values[-2 : -half - 2 : -1]
    padded = np.concatenate([before, values, after])
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(padded, axis=0)])
    window = 2 * half + 1
    return (total[window:] - total[:-window]) / window


@dataclass(frozen=True)
class PathFrames:
    """The path's own frame at some arc lengths: right-handed ``(tangent, normal, up)``, each ``(m, 3)``.

    Attributes:
        position: points of the path [m].
        tangent: unit vectors of travel.
        normal: unit vectors to the left in the surface; lateral deviations are positive along them.
        up: unit vectors out of the surface.
        curvature: in the surface, positive to the left ``(m,)`` [1/m]; 0 beyond the ends.
    """

    position: Array
    tangent: Array
    normal: Array
    up: Array
    curvature: Array


class ReferencePath:
    """A curve with continuous curvature and a tool orientation that turns smoothly along it.

    Before its start and behind its end it goes on straight, so that a camera may look past the end.
    Raises ``InputError`` for fewer than two different points, values that are not finite, or a length below 10 mm.

    Args:
        points: points of the curve in the order of travel ``(N, 3)`` [m], as dense as their shape needs; nothing
            is assumed about their spacing.
        up: the surface normal, one for all ``(3,)`` or one a point ``(N, 3)``.
        turning: share of the tangent's turning that the tool takes part in: 0 keeps the tool's orientation (on a flat
            surface), 1 keeps the tool's x axis on the tangent.
        turn_smoothing: length over which the tool's heading is averaged [m].
        smoothing: length over which the points are averaged [m]; it makes curvature continuous where straight pieces
            meet arcs, or rounds corners. A curve of radius ``r`` is cut by about ``smoothing²/(12 r)``.
        rotation: tool orientation ``(3, 3)`` where the tool's heading is the path's mean direction; by default the
            tool's z axis points into the surface and its x axis ahead.
    """

    def __init__(
        self,
        points: Array,
        *,
        up: Array | tuple[float, float, float] = (0.0, 0.0, 1.0),
        turning: float = 0.0,
        turn_smoothing: float = 0.05,
        smoothing: float = 0.01,
        rotation: Array | None = None,
    ) -> None:
        points = np.asarray(points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or not np.all(np.isfinite(points)):
            raise InputError("expected finite points of shape (N, 3)", field="path", value=points.shape)
        step = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate([[True], step > ROUNDING])
        points, chord = points[keep], np.concatenate([[0.0], np.cumsum(step[step > ROUNDING])])
        if len(points) < 2 or chord[-1] < 0.01:
            raise InputError("the path is shorter than 10 mm", field="path", value=float(chord[-1]))
        even, knots = _even_steps(points, chord, smoothing)
        self.length = float(knots[-1])
        self._knot = float(knots[1] - knots[0])
        spline = CubicSpline(knots, even)
        # One straight piece more at each end.
        zero = np.zeros(3)
        before = [zero, zero, unit(spline(0.0, 1)), even[0]]
        after = [zero, zero, unit(spline(self.length, 1)), even[-1]]
        pieces = [np.array(before)[None], spline.c.transpose(1, 0, 2), np.array(after)[None]]
        self._cubics = np.ascontiguousarray(np.concatenate(pieces))
        normals = (
            np.broadcast_to(np.asarray(up, dtype=float), (len(keep), 3)) if np.ndim(up) == 1 else np.asarray(up, float)
        )
        if normals.shape != (len(keep), 3):
            raise InputError("expected one surface normal, or one for each point", field="up", value=normals.shape)
        normals = normals[keep] / np.linalg.norm(normals[keep], axis=1, keepdims=True)
        where = np.linspace(0.0, chord[-1], len(knots))
        ups = CubicSpline(knots, interpolated(where, chord, normals))
        self._ups = np.ascontiguousarray(ups.c.transpose(1, 0, 2))
        self._start, self._turn = self._orientation(knots, turning, turn_smoothing, rotation)

    def frames(self, s: Array | float) -> PathFrames:
        """Points, tangents, lateral and surface normals and curvature at arc lengths ``s (m,)`` [m], or at one."""
        places = np.asarray(s, dtype=float)
        if places.ndim:
            return PathFrames(*frames_at(self._cubics, self._ups, self._knot, places))
        return PathFrames(*(values[0] for values in frames_at(self._cubics, self._ups, self._knot, places[None])))

    def position(self, s: Array | float) -> Array:
        """Points at arc lengths ``s (m,)`` [m], shape ``(m, 3)`` [m]; a single ``s`` gives ``(3,)``."""
        return self.frames(s).position

    def rotation(self, s: Array | float) -> Array:
        """Tool orientations at ``s``, shape ``(m, 3, 3)``; constant beyond the ends."""
        w = self._turn(np.clip(s, 0.0, self.length))
        return np.asarray(self._start @ exp(w))

    def pose(self, s: float) -> pin.SE3:
        """TCP pose of the reference at one arc length."""
        return pin.SE3(self.rotation(s), self.position(s))

    def poses(self, s: Array) -> list[pin.SE3]:
        """TCP poses of the reference at ``s (m,)``."""
        return [pin.SE3(R, p) for R, p in zip(self.rotation(s), self.position(s), strict=True)]

    def project(self, points: Array, s_near: float, span: float = 0.3) -> tuple[Array, Array, Array]:
        """Arc length, lateral deviation and height of points in the path's frame, ``(m,)`` each [m].

        Of the nearest foot within ``s_near ± span``, the last two along ``normal`` and ``up``.

        Args:
            points: ``(m, 3)`` [m].
            s_near: arc length about which to search [m]; it separates crossings of the path.
            span: largest distance from there along the path [m].
        """
        s = feet_of(self._cubics, self._knot, points, s_near - span, s_near + span)
        frames = self.frames(s)
        away = points - frames.position
        return s, dot(away, frames.normal), dot(away, frames.up)

    def _orientation(
        self, knots: Array, turning: float, turn_smoothing: float, rotation: Array | None
    ) -> tuple[Array, CubicSpline]:
        """Tool orientation at the start, and the rotation vector from there over arc length."""
        frames = self.frames(knots)
        chord = self.position(self.length) - self.position(0.0)
        closed = np.linalg.norm(chord) < 0.1 * self.length
        mean = frames.tangent[0] if closed else chord
        ahead = unit(mean - np.sum(mean * frames.up, axis=1)[:, None] * frames.up)
        left = np.cross(frames.up, ahead)
        heading = np.unwrap(np.arctan2(np.sum(frames.tangent * left, axis=1), np.sum(frames.tangent * ahead, axis=1)))
        heading = turning * averaged(heading[:, None], round(turn_smoothing / (knots[1] - knots[0])))[:, 0]
        x = np.cos(heading)[:, None] * ahead + np.sin(heading)[:, None] * left
        R = np.stack([x, np.cross(x, frames.up), -frames.up], axis=2)
        if rotation is not None:
            # The given orientation applies at the mean heading; elsewhere it turns with the surface.
            mean_frame = np.column_stack([ahead[0], np.cross(ahead[0], frames.up[0]), -frames.up[0]])
            R = R @ (mean_frame.T @ np.asarray(rotation, dtype=float))
        w = np.array([pin.log3(R[0].T @ R_i) for R_i in R])
        for i in range(1, len(w)):
            angle = np.linalg.norm(w[i])
            if angle > ROUNDING:
                # Equivalent rotation vectors differ by full turns about the same axis: stay near the last one.
                axis = w[i] / angle
                w[i] = axis * (angle + 2 * np.pi * round((float(w[i - 1] @ axis) - angle) / (2 * np.pi)))
        return R[0], CubicSpline(knots, w)
