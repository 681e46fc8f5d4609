"""Tool paths of straight lines and arcs with a timing law, as a path planner of an industrial controller makes them.

The tool moves through segments that join tangentially, and stops at corners. Speed follows a trapezoid whose ramps are
sin² in acceleration, so acceleration and its rate are continuous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.tolerances import LONGEST_PATH


@dataclass(frozen=True)
class Line:
    """A straight segment to ``end (2,)`` [m] in the plane of the path."""

    end: tuple[float, float]


@dataclass(frozen=True)
class Arc:
    """A circular segment about ``centre (2,)`` [m] through ``angle`` [rad], positive counter-clockwise."""

    centre: tuple[float, float]
    angle: float


@dataclass(frozen=True)
class Shape:
    """A plane figure: its starting point and its segments in order."""

    start: tuple[float, float]
    pieces: tuple[Line | Arc, ...]

    def runs(self) -> list[list[tuple[Array, float, Line | Arc]]]:
        """Segments between stops, each with its start point ``(2,)`` and length [m]."""
        runs: list[list[tuple[Array, float, Line | Arc]]] = []
        here, heading = np.array(self.start, dtype=float), None
        for piece in self.pieces:
            length, first, last = _measured(piece, here)
            if heading is None or np.dot(first, heading) < 1 - 1e-6:
                runs.append([])
            runs[-1].append((here, length, piece))
            here, heading = _point(piece, here, length)[0], last
        return runs


def _measured(piece: Line | Arc, start: Array) -> tuple[float, Array, Array]:
    if isinstance(piece, Line):
        step = np.array(piece.end) - start
        length = float(np.linalg.norm(step))
        if length < 1e-6:
            raise InputError("a segment of the path has no length", field="shape", value=piece.end)
        return length, step / length, step / length
    radius = start - np.array(piece.centre)
    side = np.sign(piece.angle)
    end = _turned(radius, piece.angle)
    length = float(np.linalg.norm(radius)) * abs(piece.angle)
    return length, side * _turned(radius, np.pi / 2) / np.linalg.norm(radius), (
        side * _turned(end, np.pi / 2) / np.linalg.norm(end))


def _point(piece: Line | Arc, start: Array, s: Array | float) -> Array:
    """Points ``(m, 2)`` after arc lengths ``s`` of a piece."""
    s = np.atleast_1d(np.asarray(s, dtype=float))
    if isinstance(piece, Line):
        step = np.array(piece.end) - start
        return np.asarray(start + s[:, None] * step / np.linalg.norm(step))
    radius = start - np.array(piece.centre)
    angle = np.sign(piece.angle) * s / np.linalg.norm(radius)
    across = np.array([-radius[1], radius[0]])
    return np.asarray(np.array(piece.centre) + np.cos(angle)[:, None] * radius + np.sin(angle)[:, None] * across)


def _turned(v: Array, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])


@dataclass(frozen=True)
class ToolPath:
    """A timed tool path at the interpolation cycle.

    Attributes:
        poses: one per cycle; the tool rests before and after.
        speed: along the path ``(N,)`` [m/s].
    """

    poses: list[pin.SE3]
    speed: Array

    @property
    def positions(self) -> Array:
        """Positions of the tool ``(N, 3)`` [m]."""
        return np.array([pose.translation for pose in self.poses])


def travel(length: float, speed: float, acceleration: float, t: Array) -> tuple[Array, Array]:
    """Arc length and speed at ``t (m,)`` of one stop-to-stop motion with sin² ramps.

    Args:
        length: of the way from stop to stop [m].
        speed: wanted [m/s]; reached only where the length suffices.
        acceleration: largest [m/s²].
        t: [s].
    """
    # A sin² ramp takes 2 v/a and covers v²/a.
    peak = min(speed, np.sqrt(length * acceleration / 2))
    ramp = 2 * peak / acceleration
    cruise = (length - peak * ramp) / peak

    def ramped(time: Array) -> tuple[Array, Array]:
        x = np.clip(time / ramp, 0.0, 1.0)
        distance = peak * ramp * (x**2 / 2 - (1 - np.cos(2 * np.pi * x)) / (4 * np.pi**2))
        return distance, peak * (x - np.sin(2 * np.pi * x) / (2 * np.pi))

    up, rising = ramped(t)
    down, falling = ramped(2 * ramp + cruise - t)
    flat = np.clip(t - ramp, 0.0, cruise) * peak
    s = up + flat + (0.5 * peak * ramp - down)
    return np.clip(s, 0.0, length), np.minimum(rising, falling)


def duration(length: float, speed: float, acceleration: float) -> float:
    """Time of a stop-to-stop motion with sin² ramps [s].

    Args:
        length, speed, acceleration: as for ``travel``.
    """
    peak = min(speed, np.sqrt(length * acceleration / 2))
    return float(2 * peak / acceleration + length / peak)


def lasting(shape: Shape, speed: float, acceleration: float) -> float:
    """Time of all of a figure's parts [s].

    Args:
        shape: the figure.
        speed, acceleration: as for ``travel``.
    """
    return sum(duration(sum(length for _, length, _ in run), speed, acceleration) for run in shape.runs())


def tool_path(shape: Shape, plane: pin.SE3, speed: float, acceleration: float, t_ipo: float, *,
              rotation: Array | None = None, turn: tuple[tuple[float, float, float], float] | None = None) -> ToolPath:
    """Times a plane figure and gives it a tool orientation.

    Raises InputError for speed or acceleration not positive, a speed that is reached nowhere on the path, or one so low
    that the path lasts too long.

    Args:
        shape, plane: the figure in the x-y plane of ``plane``, which is in the base frame.
        speed, acceleration: as for ``travel``.
        t_ipo: cycle [s].
        rotation: tool orientation ``(3, 3)`` in the base frame; by default the tool's z axis points into the plane.
        turn: axis in the base frame and angle [rad] by which the orientation turns over the length of each stop-to-stop
            part, in proportion to the way; None for a constant orientation.
    """
    _check(shape, speed, acceleration)
    fixed = plane.rotation @ np.diag([1.0, -1.0, -1.0]) if rotation is None else np.asarray(rotation, dtype=float)
    points, speeds, shares = [], [], []
    carried = 0.0
    for run in shape.runs():
        lengths = np.array([length for _, length, _ in run])
        total = float(lengths.sum())
        time = duration(total, speed, acceleration)
        t = np.asarray(carried + t_ipo * np.arange(float(np.floor((time - carried) / t_ipo)) + 1), dtype=float)
        carried = t[-1] + t_ipo - time
        s, v = travel(total, speed, acceleration, t)
        ends = np.cumsum(lengths)
        place = np.empty((len(s), 2))
        which = np.minimum(np.searchsorted(ends, s), len(run) - 1)
        for i, (start, length, piece) in enumerate(run):
            chosen = which == i
            place[chosen] = _point(piece, start, s[chosen] - (ends[i] - length))
        points.append(place)
        speeds.append(v)
        shares.append(s / total)
    poses = []
    for x, share in zip(np.concatenate(points), np.concatenate(shares), strict=True):
        turned = fixed if turn is None else pin.exp3(turn[1] * share * np.array(turn[0])) @ fixed
        poses.append(pin.SE3(turned, plane.act(np.array([x[0], x[1], 0.0]))))
    return ToolPath(poses, np.concatenate(speeds))


def _check(shape: Shape, speed: float, acceleration: float) -> None:
    """Refuses speeds and accelerations that are none, that no part is long enough for, or that take too long."""
    if not (speed > 0 and acceleration > 0):
        raise InputError("speed and acceleration must be positive", field="speed", value=(speed, acceleration))
    longest = max(sum(length for _, length, _ in run) for run in shape.runs())
    reachable = float(np.sqrt(longest * acceleration / 2))
    if speed > reachable * (1 + 1e-9):
        raise InputError(f"the path is too short for this speed: with {acceleration:g} m/s² it reaches "
                         f"{reachable:.3g} m/s; move slower, or allow more acceleration", field="speed", value=speed)
    if not (lasts := lasting(shape, speed, acceleration)) <= LONGEST_PATH:
        raise InputError(f"the path would last {lasts:.3g} s; {LONGEST_PATH:g} s is the longest: move faster",
                         field="speed", value=speed)


# The figures of the papers' path experiments.
#
# [G] shows its first KR 15 path (Fig. 14, ISO 9283 A.5) as a picture without dimensions: edge length 400 mm, straight
# lines, sharp corners, circles. ``iso9283`` has these in proportions that are ours.

def iso9283(edge: float) -> Shape:
    """ISO 9283-like test figure in a square of side ``edge`` [m]: long and short straights, corners, two circles."""
    h = edge / 2
    small, large = 0.125 * edge, 0.25 * edge
    full = 2 * np.pi
    return Shape((-h, -h), (
        Line((-h, h)), Line((0.0, h)), Arc((0.0, h - small), -full), Line((h, h)), Line((h, 0.3 * h)),
        Line((0.65 * h, 0.0)), Line((h, -0.3 * h)), Line((h, -h)), Line((0.0, -h)), Arc((0.0, -h + large), -full),
        Line((-h, -h))))


def triangle(edge: float) -> Shape:
    """Equilateral triangle of side ``edge`` [m] about its centre."""
    r = edge / np.sqrt(3)
    corners = [(r * np.cos(a), r * np.sin(a)) for a in np.radians([90.0, 210.0, 330.0, 90.0])]
    return Shape(corners[0], tuple(Line(corner) for corner in corners[1:]))


def circle(diameter: float) -> Shape:
    """One full circle from its lowest point."""
    return Shape((0.0, -diameter / 2), (Arc((0.0, 0.0), 2 * np.pi),))


def edge(length: float, radius: float) -> Shape:
    """Two sides of ``length`` [m] at a right angle, rounded with ``radius`` [m] so that the tool need not stop."""
    return Shape((-length, 0.0), (Line((-radius, 0.0)), Arc((-radius, radius), np.pi / 2), Line((0.0, length))))


def shape_of(name: str, size: float) -> Shape:
    """The figure ``name`` of a characteristic ``size`` [m].

    Args:
        name: ``edge``, ``iso9283``, ``triangle`` or ``circle``.
        size: length of both sides, side of the square, side, or diameter [m].
    """
    if name == "edge":
        return edge(size, 0.1 * size)
    return {"iso9283": iso9283, "triangle": triangle, "circle": circle}[name](size)
