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
from sensing.camera.camera_device import Gray, Window
from sensing.camera.camera_model import CameraModel
from sim.camera.image_chain import CameraSettings, ImageChain
from sim.camera.lamp import TOOL_COLOUR, Lamp, covered, light, mirrored, tool_mesh, triangles
from sim.camera.surface import DrawnLine, paint
from sim.contact.contact import HeightSurface

NOTHING = (np.empty((0, 2, 3)), np.empty(0))
"""Nothing stands in the lamp's way."""
_FINER = 4
"""Pixels of the tool's outline in one of the picture, each way."""
_SPACING = 4
"""Pixels between the places that are computed."""
_STILL = 0.05
"""Pixels by which a picture may move within its exposure and still be drawn once."""
_STEPS = 3
"""Steps in which a ray finds the height of a surface that is not flat."""


class LiveCamera:
    """Pictures of a drawn line on a plane or a height surface, with tool and lamp where there are any.

    Args:
        model: the true camera.
        surface, relief: the drawn surface on the plane, and heights over the plane; None for none.
        settings: resolution of the painted surface, lag of the automatic exposure, what lens and sensor do.
        rng: draws the noise.
        lamp: lights the surface; None for light from everywhere.
        tool: whether the tool's tip and a hose beside it are in the picture.
    """

    def __init__(self, model: CameraModel, surface: DrawnLine, settings: CameraSettings, rng: np.random.Generator, *,
                 relief: HeightSurface | None = None, lamp: Lamp | None = None, tool: bool = False) -> None:
        self.model, self._plane, self._relief, self._settings, self._rng = model, surface.plane, relief, settings, rng
        self._texture = texture = paint(surface, settings.resolution)
        # A pixel sees the mean over its footprint: a Gaussian with the standard deviation of a box of that width.
        self._distance = height = -float(model.T_tool_camera.translation[2])
        sigma = max(height / model.K[0, 0] / settings.resolution / np.sqrt(12.0), 0.3)
        self._chain = ImageChain(model.width, model.height, settings)
        self._image = cv2.GaussianBlur(texture.image, (0, 0), sigma)
        self._background = float(surface.background)
        grid = np.stack(np.meshgrid(_nodes(model.width), _nodes(model.height)), axis=-1)
        self._shape = grid.shape[:2]
        self._rays = model.rays(grid.reshape(-1, 2))
        self._lamp, self._lit_at = lamp, surface.at(np.array([0.5 * surface.length]))[0][0]
        self._gain, self._exposed = 1.0, -np.inf
        # The tool moves with the camera, so its picture is always the same.
        self._tool = _tool_picture(model) if tool else None

    def picture(self, poses: Sequence[pin.SE3], t: float = 0.0, shape: tuple[Array, Array] = NOTHING) -> Gray:
        """The picture ``(height, width)`` of an exposure.

        Args:
            poses: of the tool during it.
            t: its middle [s].
            shape: parts of the arm that may cast a shadow: ends of capsules ``(M, 2, 3)`` [m] and their radii ``(M,)``
                [m].
        """
        total = np.zeros((self.model.height, self.model.width), dtype=np.float32)
        if self._still(poses):
            poses = poses[len(poses) // 2 :][:1]
        for pose in poses:
            x, y, _ = self._met(pose)
            scale = self._texture.resolution
            columns, rows = (x - self._texture.x_min) / scale - 0.5, (self._texture.y_max - y) / scale - 0.5
            total += cv2.remap(self._image, self._whole(columns), self._whole(rows), cv2.INTER_LINEAR,
                               borderMode=cv2.BORDER_CONSTANT, borderValue=self._background)
        total /= len(poses)
        if self._tool is not None:
            total += self._tool * (np.float32(255.0 * TOOL_COLOUR[0]) - total)
        if self._lamp is not None:
            total = self._lit(self._lamp, total, poses[len(poses) // 2], t, shape)
        return self._chain.developed(total, Window(0, 0, self.model.width, self.model.height), self._rng)

    def _still(self, poses: Sequence[pin.SE3]) -> bool:
        """Whether the picture moves so little within its exposure that one pose shows as much as all."""
        first, last = (pose * self.model.T_tool_camera for pose in (poses[0], poses[-1]))
        motion = first.actInv(last)
        moved = np.linalg.norm(motion.translation) / self._distance + np.linalg.norm(pin.log3(motion.rotation))
        return bool(self.model.K[0, 0] * moved < _STILL)

    def _lit(self, lamp: Lamp, gray: NDArray[np.float32], pose: pin.SE3, t: float, shape: tuple[Array, Array]
             ) -> NDArray[np.float32]:
        """Gray values under the lamp, with its mirror image, as exposed: the exposure follows the light with a lag."""
        met = np.column_stack(np.broadcast_arrays(*self._met(pose)))
        points = met @ self._plane.rotation.T + self._plane.translation
        up, eye = self._plane.rotation[:, 2], (pose * self.model.T_tool_camera).translation
        hidden = covered(points, lamp.place, lamp.radius, *shape)
        bright = light(lamp, points, up, self._lit_at, hidden)
        lag = self._settings.auto_exposure
        if lag > 0.0:
            places = bright.reshape(self._shape)
            grid = [np.round(np.array([0.2, 0.5, 0.8]) * (count - 1)).astype(int) for count in self._shape]
            share = 1.0 if t <= self._exposed else 1.0 - np.exp((self._exposed - t) / lag)
            self._gain += share * (1.0 / float(places[np.ix_(*grid)].max()) - self._gain)
            self._exposed = t
        glare = mirrored(lamp, points, up, eye, hidden)
        return np.float32(self._gain) * (gray * self._whole(bright) + self._whole(glare))

    def _whole(self, at_nodes: Array) -> NDArray[np.float32]:
        """Values at the places that are computed, between them for all pixels."""
        nodes = at_nodes.reshape(self._shape).astype(np.float32)
        rows, columns = self._shape
        finer = cv2.resize(nodes, (_SPACING * columns, _SPACING * rows), interpolation=cv2.INTER_LINEAR)
        return np.asarray(finer[_SPACING : _SPACING + self.model.height, _SPACING : _SPACING + self.model.width],
                          dtype=np.float32)

    def _met(self, pose: pin.SE3) -> tuple[Array, Array, Array | float]:
        """Where each computed ray meets the surface, in the plane's frame [m]."""
        T = self._plane.actInv(pose * self.model.T_tool_camera)
        directions = self._rays @ T.rotation.T
        height: float | NDArray[np.float64] = 0.0
        for _ in range(_STEPS if self._relief is not None else 1):
            depth = (height - T.translation[2]) / directions[:, 2]
            x, y = (T.translation[i] + depth * directions[:, i] for i in range(2))
            if self._relief is not None:
                height = self._relief.height(x, y)
        return x, y, height


def _tool_picture(model: CameraModel) -> NDArray[np.float32]:
    """Share of each pixel that the tool's tip and hose cover ``(height, width)``."""
    places, faces = triangles(tool_mesh())
    pixels = _FINER * (model.project_tool(places) + 0.5)
    mask = np.zeros((_FINER * model.height, _FINER * model.width), dtype=np.uint8)
    for corners in pixels[faces]:
        if np.isfinite(corners).all() and np.abs(corners).max() < 1e6:
            cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 255)
    small = cv2.resize(mask, (model.width, model.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32) / np.float32(255.0)


def _nodes(size: int) -> Array:
    """Pixels at which is computed: in the middle of every ``_SPACING``, one more on each side.

    There OpenCV takes them to be when it enlarges a picture, and all pixels lie between two of them.
    """
    return np.asarray(_SPACING * (np.arange(-(size // -_SPACING) + 2) - 0.5) - 0.5)
