"""A line drawn on a plane, as analytic geometry: the object of the camera and the reference for errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.jit import jit
from ideal_robot.row_log import let_go, new_array
from sensing.camera.line_polynomial import Nearest, Polyline

AT_A_TIME = 32768
"""Positions whose places on the line are looked for at a time."""
FeatureKind = Literal["gap", "crossing", "parallel", "scratch", "glare", "shade"]


@dataclass(frozen=True)
class Feature:
    """Something that makes the line hard to see, placed by arc length.

    Attributes:
        kind: ``gap`` (line missing over ``length``), ``crossing`` (a stroke through the line under ``angle``),
            ``parallel`` (a stroke beside it at ``offset``), ``scratch`` (a thin stroke under ``angle``, beside the
            line at ``offset``), ``glare`` (a bright patch), ``shade`` (a dark patch).
        at: arc length of its middle [m].
        length: extent along the line, or of the stroke; diameter of a patch [m].
        offset: distance to the left of the line [m].
        angle: angle between stroke and line [rad].
        width: width of the stroke [m].
        gray: gray value of the stroke, or the value added (glare) or factor in percent (shade) in its middle.
    """

    kind: FeatureKind
    at: float
    length: float = 0.03
    offset: float = 0.0
    angle: float = math.pi / 2
    width: float = 0.003
    gray: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(FeatureKind):
            kinds = ", ".join(get_args(FeatureKind))
            raise InputError(f"expected one of {kinds}", field="feature.kind", value=self.kind)
        if not (self.length > 0.0 and self.width > 0.0):
            raise InputError("length and width of a feature must be positive", field=f"feature.{self.kind}",
                             value=(self.length, self.width))


@dataclass(frozen=True)
class DrawnLine:
    """A line on a plane, given by a dense polyline that *is* the analytic line.

    With points ``ds`` apart on a curve of radius R the polyline leaves the curve by ds²/(8R): 0.8 µm for 0.5 mm on
    40 mm.

    Attributes:
        points: polyline in the base frame ``(N, 3)`` [m].
        plane: pose of the plane in the base frame; its z is the normal, towards the camera.
        width: width of the line [m].
        gray, background: gray values of line and surface, 0 to 255.
        edge: width of the soft edge, over which the gray value changes linearly [m].
        features: features that make it hard to see.
        grain, grain_seed: texture of the bare surface, see ``sim.camera.surface``; even gray if None.
        widths, grays: at each point ``(N,)`` where they are not the same everywhere [m], gray values.
    """

    points: Array
    plane: pin.SE3 = field(compare=False)
    width: float = 0.003
    gray: float = 40.0
    background: float = 200.0
    edge: float = 0.001
    features: tuple[Feature, ...] = ()
    widths: Array | None = None
    grays: Array | None = None
    grain: str | None = None
    grain_seed: int = 0

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.all(np.isfinite(points)):
            raise InputError("expected at least two finite points, shape (N, 3)", field="line.points",
                             value=points.shape)
        if not (self.width > 0.0 and self.edge > 0.0):
            raise InputError("width and soft edge of the line must be positive", field="line.width, line.edge",
                             value=(self.width, self.edge))
        local = (points - self.plane.translation) @ self.plane.rotation
        if np.max(np.abs(local[:, 2])) > 1e-6:
            raise InputError("the line's points must lie on its plane", field="line.points",
                             value=f"{np.max(np.abs(local[:, 2])):.2e} m off")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "polyline", Polyline(points))
        object.__setattr__(self, "_local", local)

    polyline: Polyline = field(init=False, repr=False, compare=False)
    _local: Array = field(init=False, repr=False, compare=False)

    @property
    def s(self) -> Array:
        """Arc length of the points ``(N,)`` [m]."""
        return self.polyline.s

    @classmethod
    def from_plane_points(cls, xy: Array, plane: pin.SE3, **options: Any) -> DrawnLine:
        """A line from points ``(N, 2)`` [m] in the plane's x and y; further arguments as attributes.

        Args:
            xy: points in the plane ``(N, 2)`` [m].
            plane: pose of the plane in the base frame; z is its normal.
            options: further attributes.
        """
        xy = np.asarray(xy, dtype=float)
        if xy.ndim != 2 or xy.shape[1] != 2:
            raise InputError("expected points of shape (N, 2)", field="line.points", value=xy.shape)
        local = np.column_stack([xy, np.zeros(len(xy))])
        return cls(local @ plane.rotation.T + plane.translation, plane, **options)

    @property
    def length(self) -> float:
        """Length of the line [m]."""
        return self.polyline.length

    @property
    def plane_points(self) -> Array:
        """The polyline in the plane's x and y ``(N, 2)`` [m]."""
        return self._local[:, :2]

    def at(self, s: Array) -> tuple[Array, Array]:
        """Points ``(m, 3)`` [m] and unit tangents ``(m, 3)`` in the base frame at arc lengths ``(m,)`` [m]."""
        return self.polyline.at(s)

    def nearest(self, points: Array) -> Nearest:
        """Exact nearest points of the line to points ``(m, 3)`` [m] in the base frame."""
        return self.polyline.nearest(points, self.plane.rotation[:, 2])

    def beside(self, tool: Array) -> tuple[Array, Array]:
        """Arc length of the line ``(m,)`` [m] at tool positions ``(m, 3)`` [m], and how far left of it they are [m].

        The height above the plane is ignored.
        """
        up, s, lateral = self.plane.rotation[:, 2], new_array(len(tool)), new_array(len(tool))
        # Many positions at once take several times their own memory, so they are processed in parts.
        for first in range(0, len(tool), AT_A_TIME):
            part = slice(first, first + AT_A_TIME)
            nearest = self.nearest(tool[part] - np.outer((tool[part] - self.plane.translation) @ up, up))
            s[part], lateral[part] = nearest.s, nearest.lateral
            let_go(tool, s, lateral)
        return s, lateral

    def distance(self, points: Array) -> Array:
        """Distance ``(m,)`` [m] of points ``(m, 3)`` [m] in the base frame from the analytic line."""
        return self.nearest(points).distance


# Texture of the bare surface: paper, wood or brushed metal instead of one even gray.

GRAINS: dict[str, tuple[tuple[int, int], float]] = {
    "paper": ((2, 2), 6.0),
    "wood": ((200, 12), 15.0),
    "metal": ((40, 1), 10.0),
}
"""Texels along the plane's x and y over which the grain is the same, and its standard deviation in gray values."""


def _add_grain(gray: NDArray[np.float32], kind: str, seed: int) -> None:
    """Adds a grain to gray values ``(rows, columns)``: noise averaged over texels along and across."""
    size, sigma = GRAINS[kind]
    noise = cv2.blur(np.random.default_rng(seed).standard_normal(gray.shape, dtype=np.float32), size)
    gray += np.float32(sigma / float(noise.std())) * noise


# The drawn line painted into a gray image, with soft edges, for a renderer that takes the nearest texel.

MAX_TEXELS = 64_000_000  # bytes of the picture


@dataclass(frozen=True)
class Texture:
    """A gray image of the surface.

    Attributes:
        image: gray values, row 0 at the largest y, column 0 at the smallest x of the plane; uint8.
        x_min, y_max: plane coordinates of the outer corner of the first texel [m].
        resolution: size of a texel [m].
    """

    image: NDArray[np.uint8]
    x_min: float
    y_max: float
    resolution: float

    @property
    def size(self) -> tuple[float, float]:
        """Extent along the plane's x and y [m]."""
        rows, columns = self.image.shape
        return columns * self.resolution, rows * self.resolution


@jit()
def _stroke_distance(distance: NDArray[np.float32], nearest: NDArray[np.int32], xy: Array, drawn: NDArray[np.bool_],
                     reach: float) -> None:
    """Lowers ``distance`` [texels] of every texel within ``reach`` of a segment, and notes which one is nearest."""
    rows, columns = distance.shape
    for i in range(xy.shape[0] - 1):
        if not drawn[i]:
            continue
        ax, ay, bx, by = xy[i, 0], xy[i, 1], xy[i + 1, 0], xy[i + 1, 1]
        dx, dy = bx - ax, by - ay
        length2 = dx * dx + dy * dy
        for row in range(max(0, int(min(ay, by) - reach)), min(rows, int(max(ay, by) + reach) + 2)):
            y = row + 0.5
            for column in range(max(0, int(min(ax, bx) - reach)), min(columns, int(max(ax, bx) + reach) + 2)):
                x = column + 0.5
                along = 0.0
                if length2 > 0.0:
                    along = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / length2))
                ex, ey = x - ax - along * dx, y - ay - along * dy
                d = np.sqrt(ex * ex + ey * ey)
                if d < distance[row, column]:
                    distance[row, column] = d
                    nearest[row, column] = i


class _Canvas:
    """Gray image in plane coordinates, with the two things that are painted: strokes and patches."""

    def __init__(
        self, x_min: float, y_max: float, rows: int, columns: int, resolution: float, background: float
    ) -> None:
        self.x_min, self.y_max, self.resolution = x_min, y_max, resolution
        self.gray = np.full((rows, columns), background, dtype=np.float32)

    def stroke(self, xy: Array, width: float | Array, edge: float, gray: float | Array,
               drawn: NDArray[np.bool_] | None = None) -> None:
        """Paints a stroke through ``xy (N, 2)`` [m]; width and gray value are one for all or one a point ``(N,)``.

        Of its segments those ``drawn (N - 1,)`` are there, all if None.
        """
        texels = self._texels(xy)
        reach = (np.max(width) + edge) / 2 / self.resolution + 1.0
        first = np.maximum(np.floor(texels.min(axis=0) - reach).astype(int), 0)
        last = np.maximum(np.ceil(texels.max(axis=0) + reach).astype(int), first)
        part = self.gray[first[1] : last[1], first[0] : last[0]]
        distance = np.full(part.shape, np.inf, dtype=np.float32)
        drawn = np.ones(len(xy) - 1, dtype=bool) if drawn is None else drawn
        nearest = np.zeros(part.shape, dtype=np.int32)
        _stroke_distance(distance, nearest, texels - first, drawn, reach)
        touched = np.isfinite(distance)
        wide, ink = (np.broadcast_to(value, len(xy))[nearest[touched]] for value in (width, gray))
        cover = np.clip(0.5 + (wide / 2 - distance[touched] * self.resolution) / edge, 0.0, 1.0)
        part[touched] += cover * (ink - part[touched])

    def patch(self, centre: Array, radius: float, add: float, factor: float) -> None:
        """Adds and multiplies with a smooth bump (1 - d²/r²)²."""
        column, row = self._texels(centre[None])[0]
        reach = radius / self.resolution
        rows = slice(max(0, int(row - reach)), max(0, int(row + reach) + 1))
        columns = slice(max(0, int(column - reach)), max(0, int(column + reach) + 1))
        part = self.gray[rows, columns]
        y = np.arange(rows.start, rows.start + part.shape[0]) + 0.5 - row
        x = np.arange(columns.start, columns.start + part.shape[1]) + 0.5 - column
        bump = np.clip(1.0 - (x[None, :] ** 2 + y[:, None] ** 2) / reach**2, 0.0, None) ** 2
        part *= 1.0 + (factor - 1.0) * bump
        part += add * bump

    def _texels(self, xy: Array) -> Array:
        return np.column_stack([xy[:, 0] - self.x_min, self.y_max - xy[:, 1]]) / self.resolution


def paint(line: DrawnLine, resolution: float = 0.00025, margin: float = 0.2) -> Texture:
    """Paints the line and its features into a gray image.

    Raises ``InputError`` for more than 64 million texels, or a resolution that is not positive.

    Args:
        line: the line.
        resolution: size of a texel [m]; a quarter of the soft edge or finer keeps the nearest texel's error small.
        margin: how far the surface reaches beyond the line [m].
    """
    if not resolution > 0.0:
        raise InputError("must be positive", field="surface.resolution", value=resolution)
    xy = line.plane_points
    low, high = xy.min(axis=0) - margin, xy.max(axis=0) + margin
    with np.errstate(over="ignore"):
        across, down = np.ceil((high - low) / resolution)
    if not across * down <= MAX_TEXELS:
        raise InputError(f"the surface would need {across:.6g} × {down:.6g} texels; take a coarser one or a smaller "
                         "line", field="surface.resolution", value=resolution)
    columns, rows = int(across), int(down)
    canvas = _Canvas(low[0], high[1], rows, columns, resolution, line.background)
    drawn = np.ones(len(xy) - 1, dtype=bool)
    middle = 0.5 * (line.s[1:] + line.s[:-1])
    for feature in line.features:
        if feature.kind == "gap":
            drawn &= np.abs(middle - feature.at) > feature.length / 2
        elif feature.kind in ("crossing", "parallel", "scratch"):
            _paint_stroke(canvas, line, feature)
    canvas.stroke(xy, line.width if line.widths is None else line.widths, line.edge,
                  line.gray if line.grays is None else line.grays, drawn)
    for feature in line.features:
        if feature.kind in ("glare", "shade"):
            gray = feature.gray if feature.gray is not None else (120.0 if feature.kind == "glare" else 50.0)
            centre = _beside(line, np.array([feature.at]), feature.offset)[0]
            if feature.kind == "glare":
                canvas.patch(centre, feature.length / 2, gray, 1.0)
            else:
                canvas.patch(centre, feature.length / 2, 0.0, gray / 100.0)
    if line.grain is not None:
        _add_grain(canvas.gray, line.grain, line.grain_seed)
    image = np.clip(np.rint(canvas.gray, out=canvas.gray), 0, 255, out=canvas.gray).astype(np.uint8)
    return Texture(image, float(low[0]), float(high[1]), resolution)


def _paint_stroke(canvas: _Canvas, line: DrawnLine, feature: Feature) -> None:
    if feature.kind == "parallel":
        s = np.arange(feature.at - feature.length / 2, feature.at + feature.length / 2, 0.0005)
        xy = _beside(line, s[(s >= 0.0) & (s <= line.length)], feature.offset)
    else:
        centre = _beside(line, np.array([feature.at]), feature.offset)[0]
        tangent = line.at(np.array([feature.at]))[1][0] @ line.plane.rotation[:, :2]
        c, s_ = np.cos(feature.angle), np.sin(feature.angle)
        direction = np.array([c * tangent[0] - s_ * tangent[1], s_ * tangent[0] + c * tangent[1]])
        xy = centre + np.array([[-0.5], [0.5]]) * feature.length * direction
    gray = feature.gray if feature.gray is not None else (235.0 if feature.kind == "scratch" else line.gray)
    if len(xy) > 1:
        canvas.stroke(xy, feature.width, line.edge, gray)


def _beside(line: DrawnLine, s: Array, offset: float) -> Array:
    """Points ``(m, 2)`` in the plane at a distance to the left of the line."""
    points, tangents = line.at(s)
    local = (points - line.plane.translation) @ line.plane.rotation[:, :2]
    t = tangents @ line.plane.rotation[:, :2]
    return local + offset * np.column_stack([-t[:, 1], t[:, 0]])
