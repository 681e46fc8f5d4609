"""How a line looks, found in pictures of which only the surface's place is known: width and polarity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from sensing import SensingError
from sensing.camera.camera_device import Gray
from sensing.camera.camera_model import CameraModel
from sensing.camera.picture_line import RoughLine, find_rough_line

AHEAD = (0.025, 0.2)
"""Distances ahead of the TCP that are looked at [m]."""
LEAST = 0.25
"""Share of the picture's sides that has to be left of it; else all of it is looked at."""


@dataclass(frozen=True)
class LineAppearance:
    """A line as pictures show it.

    Attributes:
        width: on the surface [m].
        dark: darker than its surroundings.
        contrast: how much darker or brighter [gray].
        pictures: how many of the pictures showed it.
        places: of each picture two points of the line in the tool frame, in its direction away from the tool, on the
            plane through the tool's tip ``(k, 2, 3)`` [m]; NaN where the picture did not show it.
    """

    width: float
    dark: bool
    contrast: float
    pictures: int
    places: Array


def line_appearance(pictures: Sequence[Gray], camera: CameraModel) -> LineAppearance:
    """Width, polarity and contrast of the line in whole pictures, taken with the tool's tip on the surface's height.

    In each picture the longest ridge ahead of the tool is the line (``find_rough_line``); behind, the tool itself or
    its hose could be longer. The polarity is that of most pictures, width and contrast are the medians of those.

    Args:
        pictures: gray, of different pieces of the line ``(height, width)`` each.
        camera: as it is believed to be.

    Raises:
        SensingError: no picture shows a line.
    """
    ahead = _ahead_of_the_tool(camera)
    cut = [find_rough_line(np.ascontiguousarray(picture[ahead])) for picture in pictures]
    found = [rough for rough in cut if rough is not None]
    if not found:
        raise SensingError(f"none of {len(pictures)} pictures shows a line")
    dark = 2 * sum(rough.dark for rough in found) >= len(found)
    same = [rough for rough in found if rough.dark == dark]
    return LineAppearance(float(np.median([_width(rough, ahead, camera) for rough in same])), dark,
                          float(np.median([rough.contrast for rough in same])), len(same),
                          np.array([_places(rough, ahead, camera) if rough is not None and rough.dark == dark
                                    else np.full((2, 3), np.nan) for rough in cut]))


def _ahead_of_the_tool(camera: CameraModel) -> tuple[slice, slice]:
    """Rows and columns of the picture that show the surface ahead of the tool."""
    near, far = AHEAD
    corners = np.array([[x, y, 0.0] for x in (near, far) for y in (-far, far)])
    pixels = camera.project_tool(corners)
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(pixels.min(axis=0)), 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)), 0, size).astype(int)
    if not np.isfinite(pixels).all() or np.any(high - low < LEAST * size):
        low, high = np.zeros(2, dtype=int), size
    return slice(low[1], high[1]), slice(low[0], high[0])


def _places(rough: RoughLine, ahead: tuple[slice, slice], camera: CameraModel) -> Array:
    """Points at a third and at two thirds of the picture's line in the tool frame ``(2, 3)`` [m]."""
    along = rough.span[0] + np.array([1.0, 2.0]) / 3.0 * (rough.span[1] - rough.span[0])
    pixels = np.column_stack([along, rough.at(along)])
    pixels = (pixels if rough.along == 0 else pixels[:, ::-1]) + [ahead[1].start, ahead[0].start]
    points = camera.on_plane(pixels, np.array([0.0, 0.0, 1.0]), 0.0)
    return np.asarray(points if points[0, 0] <= points[1, 0] else points[::-1])


def _width(rough: RoughLine, ahead: tuple[slice, slice], camera: CameraModel) -> float:
    """Width on the surface in the middle of the picture's line [m]."""
    along = np.array([0.5 * sum(rough.span)])
    slope = float(rough.slope(along)[0])
    across = np.array([-slope, 1.0]) / np.hypot(1.0, slope)
    middle = np.array([along[0], float(rough.at(along)[0])])
    edges = middle + 0.5 * rough.width * np.array([[-1.0], [1.0]]) * across
    pixels = (edges if rough.along == 0 else edges[:, ::-1]) + [ahead[1].start, ahead[0].start]
    low, high = camera.on_plane(pixels, np.array([0.0, 0.0, 1.0]), 0.0)
    return float(np.linalg.norm(high - low))
