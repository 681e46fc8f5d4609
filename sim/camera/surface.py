"""A line drawn on a plane, as analytic geometry: what the camera sees and what errors are measured against."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.file_array import let_go, new_array
from sensing.camera.polyline import Nearest, Polyline

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
        gray: gray value of the stroke, or what is added (glare) or multiplied (shade, in percent) in the middle.
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

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> Feature:
        """Reads a table of a scene file.

        Raises:
            InputError: unknown or missing key, unknown kind, size that is not positive.
        """
        allowed = [f.name for f in fields(cls)]
        for key in table:
            if key not in allowed:
                raise InputError(f"unknown key; allowed are {', '.join(allowed)}", field=f"feature.{key}")
        for key in ("kind", "at"):
            if key not in table:
                raise InputError("missing", field=f"feature.{key}")
        return cls(**table)


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
        features: what makes it hard to see.
        grain, grain_seed: what the bare surface looks like, see ``sim.camera.grain``; even gray if None.
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

        The height above the plane counts for nothing.
        """
        up, s, lateral = self.plane.rotation[:, 2], new_array(len(tool)), new_array(len(tool))
        # Many positions at a time take several times their own memory.
        for first in range(0, len(tool), AT_A_TIME):
            part = slice(first, first + AT_A_TIME)
            nearest = self.nearest(tool[part] - np.outer((tool[part] - self.plane.translation) @ up, up))
            s[part], lateral[part] = nearest.s, nearest.lateral
            let_go(tool, s, lateral)
        return s, lateral

    def distance(self, points: Array) -> Array:
        """Distance ``(m,)`` [m] of points ``(m, 3)`` [m] in the base frame from the analytic line."""
        return self.nearest(points).distance
