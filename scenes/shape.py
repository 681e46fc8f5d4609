"""The shape of a line in its own plane, as a person writes it: a formula, a list of points, or an SVG path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pydantic
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from scenes.formula import evaluated
from scenes.svg_file import first_path, parsed_path

STEP = 0.0005
"""Spacing of the points that stand for the curve [m]; far below what a camera resolves."""

LONGEST = 100.0
"""Longest curve [m]: no arm follows more, and a slip of units must not fill the memory."""


class Shape(pydantic.BaseModel):
    """One of ``formula`` (y [m] as a function of x [m], with ``length``), ``points`` or ``svg``."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    formula: str | None = None
    """y [m] of x [m], e.g. ``0.04*sin(2*pi*x/0.8)``, for x from 0 to ``length``."""
    length: float | None = pydantic.Field(default=None, gt=0, le=10)
    points: list[tuple[float, float]] | None = None
    """Corner points [m], joined by straight pieces with corners rounded by ``corner_radius``."""
    corner_radius: float = pydantic.Field(default=0.0, ge=0)
    svg: str | None = None
    """The ``d`` of an SVG path, or the path of an .svg file, whose first path is taken; y points down as in SVG."""
    svg_length: float | None = pydantic.Field(default=None, gt=0, le=10)
    """Length the SVG path is scaled to [m]; without it one SVG unit is one millimetre."""

    @pydantic.model_validator(mode="after")
    def _one_of(self) -> Shape:
        given = [key for key in ("formula", "points", "svg") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"expected exactly one of formula, points and svg, got {', '.join(given) or 'none'}")
        if self.formula is not None and self.length is None:
            raise ValueError("a formula needs length [m], the range of x")
        return self

    def curve(self, folder: Path | None = None) -> Array:
        """Points of the curve every half millimetre of arc length, shape ``(N, 2)`` [m], starting at the origin.

        Raises:
            InputError: the formula cannot be evaluated, the SVG is broken, or the curve has no length.
        """
        if self.formula is not None:
            raw = _formula(self.formula, float(self.length or 0.0))
        elif self.points is not None:
            raw = _rounded(np.array(self.points, dtype=float), self.corner_radius)
        else:
            raw = _svg(str(self.svg), self.svg_length, folder)
        return _even(raw - raw[0])


def _formula(formula: str, length: float) -> Array:
    x = np.linspace(0.0, length, max(int(length / STEP), 200) + 1)
    y = evaluated(formula, x)
    return np.column_stack([x, y])


def _rounded(corners: Array, radius: float) -> Array:
    """Straight pieces joined by circular arcs of ``radius`` (0: sharp corners)."""
    if len(corners) < 2 or np.any(np.linalg.norm(np.diff(corners, axis=0), axis=1) < 1e-6):
        raise InputError("expected at least two different points, none repeated", field="line.points")
    if radius <= 0:
        return corners
    pieces = [corners[:1]]
    for before, corner, after in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
        u = (before - corner) / np.linalg.norm(before - corner)
        v = (after - corner) / np.linalg.norm(after - corner)
        half = 0.5 * np.arccos(np.clip(u @ v, -1.0, 1.0))
        if half > np.pi / 2 - 1e-6:
            continue
        tangent = radius / np.tan(half)
        if tangent > 0.5 * min(np.linalg.norm(before - corner), np.linalg.norm(after - corner)) + 1e-12:
            raise InputError("the corners are too close for this radius", field="line.corner_radius", value=radius)
        centre = corner + (u + v) / np.linalg.norm(u + v) * radius / np.sin(half)
        start, end = corner + tangent * u - centre, corner + tangent * v - centre
        sweep = np.arctan2(start[0] * end[1] - start[1] * end[0], start @ end)
        angles = np.linspace(0.0, sweep, 60)
        pieces.append(centre + np.column_stack([np.cos(angles) * start[0] - np.sin(angles) * start[1],
                                                np.sin(angles) * start[0] + np.cos(angles) * start[1]]))
    pieces.append(corners[-1:])
    return np.vstack(pieces)


def _svg(svg: str, length: float | None, folder: Path | None) -> Array:
    import svgpathtools

    path: Any = first_path(svg, folder or Path.cwd()) if svg.endswith(".svg") else parsed_path(svg)
    if len(path) == 0:
        raise InputError("broken SVG path: it draws nothing", field="line.svg", value=svg[:60])
    if not path.iscontinuous():
        raise InputError("the SVG path has several parts; give one that is drawn without lifting the pen",
                         field="line.svg", value=svg[:60])
    fine = np.concatenate([segment.points(np.linspace(0.0, 1.0, 400)) if hasattr(segment, "points") and
                           not isinstance(segment, svgpathtools.Arc)
                           else np.array([segment.point(u) for u in np.linspace(0.0, 1.0, 400)]) for segment in path])
    xy = np.column_stack([fine.real, -fine.imag])
    total = float(np.sum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    if not np.isfinite(total) or total <= 0:
        raise InputError("broken SVG path: it has no length", field="line.svg", value=svg[:60])
    return xy * (length / total if length else 1e-3)


def _even(raw: Array) -> Array:
    """The curve at even steps of arc length."""
    step = np.linalg.norm(np.diff(raw, axis=0), axis=1)
    keep = np.concatenate([[True], step > 1e-9])
    raw = raw[keep]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(raw, axis=0), axis=1))])
    if len(raw) < 2 or s[-1] < 20 * STEP:
        raise InputError("the line is shorter than 10 mm", field="line", value=float(s[-1]) if len(s) else 0.0)
    if not s[-1] <= LONGEST:
        raise InputError(f"the line is longer than {LONGEST:g} m; is the unit right?", field="line", value=float(s[-1]))
    even = np.linspace(0.0, s[-1], round(s[-1] / STEP) + 1)
    # Straight pieces have few points: linear between them; curves come finely sampled and get a spline.
    if len(raw) > 300:
        return np.asarray(CubicSpline(s, raw)(even), dtype=float)
    return np.column_stack([np.interp(even, s, raw[:, 0]), np.interp(even, s, raw[:, 1])])
