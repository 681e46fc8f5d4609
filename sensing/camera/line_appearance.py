"""How a line looks, found in pictures of which only the surface's place is known: width and polarity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Gray
from sensing.camera.picture_line import RoughLine, find_rough_line
from sensing.sensing_error import SensingError


@dataclass(frozen=True)
class LineAppearance:
    """A line as pictures show it.

    Attributes:
        width: on the surface [m].
        dark: darker than its surroundings.
        contrast: how much darker or brighter [gray].
        pictures: how many of the pictures showed it.
    """

    width: float
    dark: bool
    contrast: float
    pictures: int


def line_appearance(pictures: Sequence[Gray], camera: CameraModel) -> LineAppearance:
    """Width, polarity and contrast of the line in whole pictures, taken with the tool's tip on the surface's height.

    In each picture the longest ridge is the line (``find_rough_line``). The polarity is that of most pictures, width
    and contrast are the medians of those.

    Args:
        pictures: gray, of different pieces of the line ``(height, width)`` each.
        camera: as it is believed to be.

    Raises:
        SensingError: no picture shows a line.
    """
    found = [rough for rough in map(find_rough_line, pictures) if rough is not None]
    if not found:
        raise SensingError(f"none of {len(pictures)} pictures shows a line")
    dark = 2 * sum(rough.dark for rough in found) >= len(found)
    same = [rough for rough in found if rough.dark == dark]
    return LineAppearance(float(np.median([_width(rough, camera) for rough in same])), dark,
                          float(np.median([rough.contrast for rough in same])), len(same))


def _width(rough: RoughLine, camera: CameraModel) -> float:
    """Width on the surface in the middle of the picture's line [m]."""
    along = np.array([0.5 * sum(rough.span)])
    slope = float(rough.slope(along)[0])
    across = np.array([-slope, 1.0]) / np.hypot(1.0, slope)
    middle = np.array([along[0], float(rough.at(along)[0])])
    edges = middle + 0.5 * rough.width * np.array([[-1.0], [1.0]]) * across
    pixels = edges if rough.along == 0 else edges[:, ::-1]
    low, high = camera.on_plane(pixels, np.array([0.0, 0.0, 1.0]), 0.0)
    return float(np.linalg.norm(high - low))
