"""The regression of a camera that sees a line: all its points must lie on one smooth curve in the base frame.

Each place of the line is seen in several fields, from other poses and at other places of the image. The curve is
unknown: its lateral deviation from the path of the tool is a spline, whose coefficients are eliminated from residual
and columns. The curve is not part of a model, so it is fitted to all fields; a held-out test would test hardly anything
but the extrapolation of the curve.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage

from ideal_robot.arrays import Array, arc_lengths, interpolated
from ideal_robot.diagnosis.channels.arm import arm_angles, tool_motion
from ideal_robot.diagnosis.channels.regression import FEWEST, KNOTS, OWN, POSITION_BAND, Regression
from ideal_robot.effects import SENSOR, Signals, library
from ideal_robot.effects.camera import CameraEffect, PointError, StampError, from_axis
from ideal_robot.effects.fitted import spline_basis
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

FIELDS = 300
"""Fields looked at, at most."""
_OUTLIER = 8.0
"""Standard deviations from the smooth line beyond which a point is none of it: of Gaussian noise none is so far."""


@dataclass(frozen=True)
class _SeenPoints:
    """Points of the line ``(N,)``, and what moves them across it.

    Attributes:
        t: time stamps since the recording's begin ``(N,)`` [s].
        out: from the optical axis in the tool frame ``(N, 3)`` [m].
        rotation: of the tool ``(N, 3, 3)``.
        normal: what of a motion in the base frame changes the lateral deviation ``(N, 3)``.
        speed: change of the lateral deviation per second by which the picture was taken later ``(N,)`` [m/s].
        curves: orthonormal, of all curves that the line may be ``(N, p)``.
    """

    t: Array
    out: Array
    rotation: Array
    normal: Array
    speed: Array
    curves: Array

    def beside(self, values: Array) -> Array:
        """What no curve explains of values ``(N,)``."""
        return np.asarray(values - self.curves @ (self.curves.T @ values))

    def off(self, moved: Array) -> Array:
        """How far points that are moved in the tool frame ``(N, 3)`` go across the line ``(N,)``."""
        return np.einsum("ki,kij,kj->k", self.normal, self.rotation, moved)

    def signals(self) -> dict[str, Array]:
        """What a unit of each error of a camera does that no other line would do ``(N,)``."""
        result = {}
        for error in (error for effect in library() if isinstance(effect, CameraEffect) for error in effect.errors):
            if isinstance(error, PointError):
                whole = self.off(error.moved(self.out))
            elif isinstance(error, StampError):
                whole = error.late(self.t) * self.speed
            remainder = self.beside(whole)
            # As for other effects: if another line explains an error nearly as well, it is not attributed to the
            # camera.
            if not error.optional or float(np.sum(remainder**2)) > OWN * float(np.sum(whole**2)):
                result[error.signal] = remainder
        return result


def line_regression(recording: Recording, robot: Robot, torque: Regression,
                    stiffness: Array | None) -> Regression | None:
    """The regression of a camera's ``cam_t`` and ``line_x_i line_y_i line_z_i``; None for too few points.

    See ``position_regressions``.
    """
    fields = _seen(recording)
    if fields is None:
        return None
    stamps, number, points = fields
    begin, grid = float(recording.t[0]), torque.filtered.t
    angles = arm_angles(recording, torque, stiffness)
    rotation, place, twist = tool_motion(robot, *_smooth(grid, angles, stamps))
    lever = np.einsum("kij,kj->ki", rotation[number], points)
    x = lever + place[number]
    up = -rotation[:, :, 2].mean(axis=0)
    up /= np.linalg.norm(up)
    moments = np.arange(stamps[0], min(stamps[-1] + 0.5, float(recording.t[-1])), 0.004)
    path, s_path = _in_surface(tool_motion(robot, *_smooth(grid, angles, moments))[1], up)
    if s_path[-1] < 4.0 * KNOTS:
        return None
    s, d, tangent, inside = _against(path, s_path, x, place[number], up)
    rows = np.flatnonzero(inside)
    W, slope, inliers = _curve(s[rows], d[rows])
    rows = rows[inliers]
    s, d, tangent, field = s[rows], d[rows], tangent[rows], number[rows]
    if len(np.unique(field)) < FEWEST:
        return None
    # A point displaced along its line is compared with the line's deviation at another place.
    normal = np.cross(up, tangent) - slope[:, None] * tangent
    moved = twist[field, :3] + np.cross(twist[field, 3:], lever[rows])
    times = stamps[field] - begin
    basis, sizes, _ = np.linalg.svd(W, full_matrices=False)
    seen_points = _SeenPoints(times, from_axis(points[rows], _axis(recording, points)), rotation[field], normal,
                              -np.sum(normal * moved, axis=1), basis[:, sizes > 1e-6 * sizes[0]])
    residual = seen_points.beside(d)
    at_points: dict[str, Any] = {name: interpolated(times, grid - begin, getattr(torque.signals, name))
                                 for name in ("q", "qd", "qdd", "load", "torque", "friction")}
    signals = Signals(times, **at_points, extra=seen_points.signals())
    noise_floor = np.array([_finding_noise(residual, field)])
    # The surface's inclination along the line is unknown, too: it changes the distances of the points.
    inclined = seen_points.beside((s - s.mean()) * seen_points.off(seen_points.out))
    y, W = residual[:, None], np.column_stack([np.ones(len(residual)), inclined])[:, None, :]
    use = np.ones(y.shape, dtype=bool)
    # Rows are points in order of time, and need no filter.
    filtered = replace(torque.filtered, factor=1, keep=use[:, 0])
    return Regression(times, ("line",), ("m",), y, y, W, use, signals, filtered, {}, noise_floor, torque.prismatic,
                      SENSOR)


def _finding_noise(residual: Array, number: np.ndarray) -> float:
    """Noise of finding points [m]: what differs between those next to each other in one field."""
    jumps = np.diff(residual, 2)[number[2:] == number[:-2]]
    return float(np.median(np.abs(jumps)) / 0.6745 / np.sqrt(6.0)) if len(jumps) else 0.0


def _seen(recording: Recording) -> tuple[Array, np.ndarray, Array] | None:
    """Time stamps of the fields ``(F,)``, and for each point its field ``(M,)`` and place in the tool ``(M, 3)``."""
    triples = ([f"line_{axis}_{i}" for axis in "xyz"] for i in itertools.count(1))
    names = list(itertools.takewhile(lambda three: recording.columns.keys() >= set(three), triples))
    if "cam_t" not in recording.columns or not names:
        return None
    points = np.stack([np.column_stack([recording.columns[name] for name in three]) for three in names], axis=1)
    stamps = recording.columns["cam_t"]
    good = np.isfinite(points).all(axis=2) & np.isfinite(stamps)[:, None]
    good &= ((stamps >= recording.t[0]) & (stamps <= recording.t[-1]))[:, None]
    fields = np.flatnonzero(good.any(axis=1))
    fields = fields[np.argsort(stamps[fields], kind="stable")][:FIELDS]
    if len(fields) < FEWEST:
        return None
    number, which = np.nonzero(good[fields])
    return stamps[fields], number, points[fields][number, which]


def _smooth(t: Array, values: Array, at: Array) -> tuple[Array, Array]:
    """Smoothed values and their rates at some times ``(F, k)``: a parabola is fitted half a period to each side."""
    fits = np.empty((2, len(at), values.shape[1]))
    half = max(0.5 / POSITION_BAND, 2.5 * float(np.median(np.diff(t))))
    for k, moment in enumerate(at):
        a, b = np.searchsorted(t, [moment - half, moment + half])
        a = max(min(a, len(t) - 4), 0)
        b = max(b, a + 4)
        powers = np.vander(t[a:b] - moment, 3, increasing=True)
        fits[:, k] = np.linalg.lstsq(powers, values[a:b], rcond=None)[0][:2]
    return fits[0], fits[1]


def _in_surface(place: Array, up: Array) -> tuple[Array, Array]:
    """A tool's path ``(N, 3)`` across ``up``, at equal steps, smoothed, straight on at its end; and its arc lengths."""
    flat = place - np.outer((place - place[0]) @ up, up)
    lengths = arc_lengths(flat)
    keep = np.concatenate([[True], np.diff(lengths) > 1e-6])
    # Ten samples a knot, smoothed over half of one.
    s = np.arange(0.0, lengths[-1], KNOTS / 10.0)
    if len(s) < 40:
        return flat[:1], np.zeros(1)
    path = interpolated(s, lengths[keep], flat[keep])
    path = ndimage.gaussian_filter1d(path, 5.0, axis=0, mode="nearest")[10:-10]
    end = (path[-1] - path[-11]) / 10.0
    path = np.vstack([path, path[-1] + np.arange(1, 100)[:, None] * end])
    return path, arc_lengths(path)


def _against(path: Array, s_path: Array, x: Array, tool: Array, up: Array) -> tuple[Array, Array, Array, np.ndarray]:
    """Arc length, lateral deviation, and tangent at each point's foot on the path; and whether it has one."""
    tangents = np.gradient(path, s_path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    s, d, tangent = np.empty(len(x)), np.empty(len(x)), np.empty((len(x), 3))
    inside = np.ones(len(x), dtype=bool)
    last = 0
    for k, point in enumerate(x):
        # Searched from the last place of the tool on, so that a line that crosses itself is not mixed up.
        part = slice(max(last - 50, 0), last + 300)
        last = part.start + int(np.argmin(np.sum((path[part] - tool[k]) ** 2, axis=1)))
        near = slice(max(last - 50, 0), last + 250)
        i = near.start + int(np.argmin(np.sum((path[near] - point) ** 2, axis=1)))
        inside[k] = 0 < i < len(path) - 1
        s[k] = s_path[i]
        for _ in range(3):
            (foot,), (direction,) = (interpolated(s[k : k + 1], s_path, rows) for rows in (path, tangents))
            direction = direction / np.linalg.norm(direction)
            s[k] += float(direction @ (point - foot))
        tangent[k], d[k] = direction, float(np.cross(up, direction) @ (point - foot))
    return s, d, tangent, inside


def _curve(s: Array, d: Array) -> tuple[Array, Array, np.ndarray]:
    """Columns of a smooth curve ``(m, p)``, its slope at the points ``(m,)``, and which points are no outliers."""
    inliers = np.arange(len(s))
    for last in (False, True):
        low, high = float(s[inliers].min()), float(s[inliers].max())
        grid = np.linspace(low, high, max(int((high - low) / KNOTS), 2) + 1)
        # No knots where no points were seen.
        filled = np.histogram(s[inliers], grid)[0] >= 3
        knots = tuple(float(v) for v in np.concatenate([[low], grid[1:-1][filled[:-1] & filled[1:]], [high]]))
        W = spline_basis(s[inliers], knots, 0.1)
        W = W[:, np.any(np.abs(W) > 1e-6, axis=0)]
        c = np.linalg.lstsq(W, d[inliers], rcond=None)[0]
        residual = d[inliers] - W @ c
        limit = _OUTLIER * max(float(np.median(np.abs(residual))), 1e-7) / 0.6745
        if not last:
            inliers = inliers[np.abs(residual) < limit]
    order = np.linspace(low, high, 4 * len(knots) + 1)
    values = np.interp(order, np.sort(s[inliers]), (W @ c)[np.argsort(s[inliers])])
    return W, np.interp(s[inliers], order, np.gradient(values, order)), inliers


def _axis(recording: Recording, points: Array) -> Array:
    """Where the optical axis meets the surface in the tool frame ``(3,)``: as noted, else the middle of the points."""
    noted = recording.meta.get("camera")
    if noted and "axis" in noted:
        return np.asarray(noted["axis"], dtype=float)
    return np.asarray(0.5 * (points.min(axis=0) + points.max(axis=0)))
