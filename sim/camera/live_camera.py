"""Whole pictures of the drawn surface fast enough for real time: the texture looked up along the pixels' rays.

``RenderedCamera`` draws windows with TinyRenderer, which takes a tenth of a second for a whole picture. Here the place
on the surface is computed for every fourth pixel each way, interpolated between, and the texture, smoothed to the size
of a pixel, is sampled there.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Gray
from sim.camera.surface import DrawnLine
from sim.camera.texture import paint
from sim.contact.contact import HeightSurface

_SPACING = 4
"""Pixels between the places that are computed."""
_STEPS = 3
"""Steps in which a ray finds the height of a surface that is not flat."""


class LiveCamera:
    """Pictures of a drawn line on a plane or a height surface.

    Args:
        model: the true camera.
        surface: what it looks at, given on the plane.
        resolution: of the painted surface [m].
        noise: standard deviation of gray noise.
        rng: draws the noise.
        relief: heights over the same plane; None for the plane itself.
    """

    def __init__(self, model: CameraModel, surface: DrawnLine, resolution: float, noise: float,
                 rng: np.random.Generator, relief: HeightSurface | None = None) -> None:
        self.model, self._plane, self._relief, self._noise, self._rng = model, surface.plane, relief, noise, rng
        self._texture = texture = paint(surface, resolution)
        # A pixel sees the mean over its footprint: of the same standard deviation as a box of that width.
        height = -float(model.T_tool_camera.translation[2])
        sigma = max(height / model.K[0, 0] / resolution / np.sqrt(12.0), 0.3)
        self._image = cv2.GaussianBlur(texture.image, (0, 0), sigma)
        self._background = float(surface.background)
        u, self._across = _nodes(model.width)
        v, self._down = _nodes(model.height)
        grid = np.stack(np.meshgrid(u, v), axis=-1)
        self._shape = grid.shape[:2]
        self._rays = model.rays(grid.reshape(-1, 2))

    def picture(self, poses: Sequence[pin.SE3]) -> Gray:
        """The picture ``(height, width)`` of an exposure during which the tool was at ``poses``."""
        total = np.zeros((self.model.height, self.model.width), dtype=np.float32)
        for pose in poses:
            columns, rows = (self._down @ part.reshape(self._shape) @ self._across.T for part in self._texels(pose))
            seen = cv2.remap(self._image, columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR,
                             borderMode=cv2.BORDER_CONSTANT, borderValue=self._background)
            total += seen
        total /= len(poses)
        if self._noise > 0:
            total += np.float32(self._noise) * self._rng.standard_normal(total.shape, dtype=np.float32)
        return np.asarray(np.clip(np.rint(total), 0, 255), dtype=np.uint8)

    def _texels(self, pose: pin.SE3) -> tuple[Array, Array]:
        """Column and row of the texture that each computed ray meets."""
        T = self._plane.actInv(pose * self.model.T_tool_camera)
        directions = self._rays @ T.rotation.T
        height: float | NDArray[np.float64] = 0.0
        for _ in range(_STEPS if self._relief is not None else 1):
            depth = (height - T.translation[2]) / directions[:, 2]
            x, y = (T.translation[i] + depth * directions[:, i] for i in range(2))
            if self._relief is not None:
                height = self._relief.height(x, y)
        scale = self._texture.resolution
        return (x - self._texture.x_min) / scale - 0.5, (self._texture.y_max - y) / scale - 0.5


def _nodes(size: int) -> tuple[Array, Array]:
    """Pixels at which is computed, and the weights that interpolate between them ``(size, nodes)``."""
    count = (size - 2) // _SPACING + 2
    nodes = np.linspace(0.0, size - 1.0, count)
    at = np.arange(size) / (size - 1.0) * (count - 1)
    left = np.minimum(at.astype(int), count - 2)
    weights = np.zeros((size, count))
    weights[np.arange(size), left] = 1.0 - (at - left)
    weights[np.arange(size), left + 1] = at - left
    return nodes, weights
