"""The figures of the papers' path experiments.

[G] shows its first KR 15 path (Fig. 14, ISO 9283 A.5) as a picture without dimensions: edge length 400 mm, straight
lines, sharp corners, circles. ``iso9283`` has these in proportions that are ours.
"""

from __future__ import annotations

import numpy as np

from scenes.path.tool_path import Arc, Line, Shape


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
    """The figure ``name`` of a characteristic ``size`` [m]: edge, edge, diameter, side."""
    if name == "edge":
        return edge(size, 0.1 * size)
    return {"iso9283": iso9283, "triangle": triangle, "circle": circle}[name](size)
