"""Finds width and polarity of a line in pictures where only the place of the surface is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from sensing import SensingError
from sensing.camera.camera_device import Gray
from sensing.camera.camera_model import CameraModel
from sensing.camera.picture_line import PictureLine, detect_in_picture

AHEAD = (0.025, 0.2)
"""Distances ahead of the TCP that are looked at [m]."""
LEAST = 0.25
"""Share of the picture's sides that has to be left of it; else all of it is looked at."""


@dataclass(frozen=True)
class LineAppearance:
    """Width, polarity and contrast of a line as pictures show it.

    Attributes:
        width: on the surface [m].
        dark: darker than its surroundings.
        contrast: difference in brightness between line and surface [gray].
        places: of each picture two points of the line in the tool frame, in its direction away from the tool, on the
            surface ``(k, 2, 3)`` [m]; NaN where the picture did not show it.
    """

    width: float
    dark: bool
    contrast: float
    places: Array


def line_appearance(pictures: Sequence[Gray], camera: CameraModel, above: float = 0.0) -> LineAppearance:
    """Width, polarity and contrast of the line in whole pictures where only the place of the surface is known.

    In each picture only the line ahead of the tool is used (``detect_in_picture``); behind, the tool itself or its hose
    could be clearer. The polarity is that of most pictures, width and contrast are the medians of those. Raises
    ``SensingError`` where no picture shows a line.

    Args:
        pictures: gray, of different pieces of the line ``(height, width)`` each.
        camera: as it is believed to be.
        above: height of the tool's tip over the surface [m].
    """
    ahead = _ahead_of_the_tool(camera)
    detections = [detect_in_picture(np.ascontiguousarray(picture[ahead]), kind="line") for picture in pictures]
    lines = [line for line in detections if line.found]
    if not lines:
        raise SensingError(f"none of {len(pictures)} pictures shows a line")
    dark = 2 * sum(line.dark for line in lines) >= len(lines)
    same = [line for line in lines if line.dark == dark]
    return LineAppearance(float(np.median([_width(line, ahead, camera, above) for line in same])), dark,
                          float(np.median([line.contrast for line in same])),
                          np.array([_places(line, ahead, camera, above) if line.found and line.dark == dark
                                    else np.full((2, 3), np.nan) for line in detections]))


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


def _places(line: PictureLine, ahead: tuple[slice, slice], camera: CameraModel, above: float) -> Array:
    """Points at a third and at two thirds of the picture's line in the tool frame ``(2, 3)`` [m]."""
    n = len(line.points) - 1
    pixels = line.points[[round(n / 3), round(2 * n / 3)]] + [ahead[1].start, ahead[0].start]
    points = camera.on_plane(pixels, np.array([0.0, 0.0, 1.0]), above)
    return np.asarray(points if points[0, 0] <= points[1, 0] else points[::-1])


def _width(line: PictureLine, ahead: tuple[slice, slice], camera: CameraModel, above: float) -> float:
    """Width on the surface, the median along the picture's line [m]."""
    assert line.strip is not None
    half = 0.5 * line.strip.widths[:, None] * line.strip.normals
    first, down = [ahead[1].start, ahead[0].start], np.array([0.0, 0.0, 1.0])
    low, high = (camera.on_plane(line.points + side + first, down, above) for side in (-half, half))
    return float(np.median(np.linalg.norm(high - low, axis=1)))
