"""The camera on the arm, rendered by PyBullet's TinyRenderer from the arm's true poses.

Only the pixels of the search windows are rendered: shifting the principal point in the projection matrix moves the
window to any place of the image. TinyRenderer draws an undistorted picture; the lens is put in by sampling it where
the distorted pixels' rays hit it. Exposure, gray noise, time stamp, latency and lost fields follow the settings.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Field, Gray, Window
from sim.bullet import output_dropped, pybullet
from sim.camera.camera_settings import CameraSettings
from sim.camera.lens_sampling import add_samples, displacements, sample_rays
from sim.camera.surface import DrawnLine
from sim.camera.texture import Texture, paint

__all__ = ["CameraSettings", "PoseAt", "RenderedCamera"]

PoseAt = Callable[[float], pin.SE3]
"""True TCP pose in the base frame at a time [s]."""

# TinyRenderer samples at integer coordinates with rows counted from below: this much has to be added to the principal
# point of OpenCV's convention (pixel centres at integers) before it goes into the projection matrix.
PIXEL_SHIFT_U, PIXEL_SHIFT_V = 0.0, 1.0
NEAR, FAR = 0.02, 3.0
FINE = 160_000
"""Pixels from which on a whole image gets one sample a pixel."""


class RenderedCamera:
    """Renders fields of the drawn surface; sees of the arm only the true TCP pose.

    Args:
        model: the true camera.
        surface: what it looks at.
        settings: exposure, noise, timing.
        rng: seeds the camera's noise. Every field draws from a stream of its own, so that a field is the same
            whatever was asked before.
        texture: painted surface; made from ``surface`` if not given, and kept as ``texture`` for another camera on it.

    Raises:
        InputError: the surface is too large for its resolution, or the lens cannot be inverted within the image.
    """

    def __init__(
        self,
        model: CameraModel,
        surface: DrawnLine,
        settings: CameraSettings,
        rng: np.random.Generator,
        texture: Texture | None = None,
    ) -> None:
        self.model, self.surface, self.settings = model, surface, settings
        edge_u, edge_v = np.linspace(0, model.width - 1, 9), np.linspace(0, model.height - 1, 9)
        border = np.stack(np.meshgrid(edge_u, edge_v), axis=-1).reshape(-1, 2)
        if not np.isfinite(model.rays(border)).all():
            raise InputError("this lens folds the picture over within the image; take a weaker distortion",
                             field="camera.distortion", value=tuple(model.distortion))
        self._key = int(rng.integers(2**63))
        self._offsets = displacements(settings.sub_exposures)
        self._client = pybullet.connect(pybullet.DIRECT)
        self.texture = paint(surface, settings.resolution) if texture is None else texture
        with output_dropped():
            self._load(self.texture)

    def __enter__(self) -> RenderedCamera:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Frees the renderer."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def due(self, t0: float, t1: float) -> list[float]:
        """Mid-exposure times [s] of the fields whose exposure *ends* in ``[t0, t1)``, without the lost ones.

        After the arm has been moved to ``t1`` all poses are known that these exposures need.
        """
        half = 0.5 * self.settings.exposure
        first = max(0, math.ceil(round((t0 - half - self.settings.phase) * self.settings.rate, 6)))
        times = []
        for k in range(first, first + 2 + int((t1 - t0) * self.settings.rate)):
            t = self.settings.phase + k / self.settings.rate
            if round((t + half - t1) * self.settings.rate, 6) >= 0.0:
                break
            if self._stream(k).random() >= self.settings.loss:
                times.append(t)
        return times

    def stamp(self, t_exposure: float) -> float:
        """Controller time that the camera says of the field exposed at ``t_exposure`` [s], one of ``due``."""
        rng = self._stream(round((t_exposure - self.settings.phase) * self.settings.rate))
        rng.random(), rng.standard_normal()
        return float(t_exposure + self.settings.stamp_offset + self.settings.stamp_noise * rng.standard_normal())

    def windows(self, t_exposure: float, pose_at: PoseAt, windows: Sequence[Window]) -> Field:
        """One field, cut to windows.

        Args:
            t_exposure: true time of mid-exposure, one of ``due`` [s].
            pose_at: true TCP pose at a time; called within half the exposure time around ``t_exposure``.
            windows: rectangles inside the image; empty ones give empty patches.

        Raises:
            InputError: a window reaches outside the image.
        """
        for window in windows:
            inside = min(window) >= 0 and window.u + window.width <= self.model.width
            if not (inside and window.v + window.height <= self.model.height):
                raise InputError(f"outside the image of {self.model.width}×{self.model.height} px", field="window",
                                 value=tuple(window))
        s = self.settings
        rng = self._stream(round((t_exposure - s.phase) * s.rate))
        rng.random()
        latency = max(s.latency + s.jitter * rng.standard_normal(), 0.5 * s.exposure)
        rng.standard_normal()
        t_stamp = self.stamp(t_exposure)
        n = s.sub_exposures
        poses = [pose_at(t_exposure + ((i + 0.5) / n - 0.5) * s.exposure) for i in range(n)]
        views = [self._view(pose) for pose in poses]
        patches = tuple(self._noisy(self._render(window, views, s.supersampling), rng) for window in windows)
        return Field(t_stamp, t_exposure + latency, tuple(windows), patches)

    def frame(self, pose: pin.SE3, noise_rng: np.random.Generator | None = None) -> Gray:
        """The whole image ``(height, width)`` from one TCP pose, for reports; noise only if ``noise_rng`` is given."""
        whole = Window(0, 0, self.model.width, self.model.height)
        # A fine image shows its line smooth enough with one sample a pixel, and takes long anyway.
        samples = 2 if whole.width * whole.height <= FINE else 1
        gray = self._render(whole, [self._view(pose)], samples)
        return self._noisy(gray, noise_rng)

    def _stream(self, k: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=[self._key, k + 2**32]))

    def _noisy(self, gray: Array, rng: np.random.Generator | None) -> Gray:
        if rng is not None and self.settings.noise > 0.0:
            gray = gray + self.settings.noise * rng.standard_normal(gray.shape)
        return np.clip(np.rint(gray), 0, 255).astype(np.uint8)

    def _view(self, pose: pin.SE3) -> list[float]:
        """OpenGL view matrix, column-major: base frame → camera with y up and z backwards."""
        T = (pose * self.model.T_tool_camera).inverse()
        V = np.eye(4)
        V[:3, :3], V[:3, 3] = T.rotation, T.translation
        V[1:3] *= -1.0
        return V.T.ravel().tolist()

    def _render(self, window: Window, views: Sequence[list[float]], n: int) -> Array:
        """Mean gray values ``(height, width)`` of a window over the views, ``n`` × ``n`` samples per pixel and view."""
        K, k = self.model.K, self.model.distortion
        if window.width == 0 or window.height == 0:
            return np.zeros((window.height, window.width))
        x, y = sample_rays(window.u, window.v, window.height, window.width, n, K, k)
        scale = n * K[0, 0]
        offsets = self._offsets if len(views) > 1 else np.zeros((1, 2))
        # The smallest undistorted picture that covers all samples wherever a sub-exposure moves its grid.
        pad_u, pad_v = np.abs(offsets).max(axis=0)
        column0, row0 = pad_u - scale * x.min(), pad_v - scale * y.min()
        width = int(scale * x.max() + column0 + pad_u) + 2
        height = int(scale * y.max() + row0 + pad_v) + 2
        total = np.zeros((window.height, window.width))
        for view, (du, dv) in zip(views, offsets, strict=True):
            # The samples stay where they are; the renderer's own grid moves below them, which averages its hard edges.
            image = self._picture(view, width, height, scale, column0 + du, row0 + dv)
            add_samples(total, image, x, y, scale, column0 + du, row0 + dv, 1.0 / len(views))
        return total

    def _picture(self, view: list[float], width: int, height: int, f: float, cx: float, cy: float) -> NDArray[np.uint8]:
        cx, cy = cx + PIXEL_SHIFT_U, cy + PIXEL_SHIFT_V
        projection = [
            2 * f / width, 0.0, 0.0, 0.0,
            0.0, 2 * f / height, 0.0, 0.0,
            (width - 2 * cx) / width, (2 * cy - height) / height, -(FAR + NEAR) / (FAR - NEAR), -1.0,
            0.0, 0.0, -2 * FAR * NEAR / (FAR - NEAR), 0.0,
        ]  # fmt: skip
        picture: Any = pybullet.getCameraImage(
            width, height, view, projection, lightDirection=[0, 0, 1], lightColor=[1, 1, 1], lightAmbientCoeff=1.0,
            lightDiffuseCoeff=0.0, lightSpecularCoeff=0.0, shadow=0, renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK, physicsClientId=self._client,
        )  # fmt: skip
        return picture[2]

    def _mesh(self, texture: Texture) -> str:
        """The surface as an .obj: two triangles with texture coordinates, in the plane's frame."""
        x0, y1 = texture.x_min, texture.y_max
        x1, y0 = x0 + texture.size[0], y1 - texture.size[1]
        corners = "".join(f"v {x!r} {y!r} 0\n" for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1)))
        return corners + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n"

    def _load(self, texture: Texture) -> None:
        """Puts the surface into the renderer's client. Only an .obj file has the right texture coordinates there."""
        # PyBullet caches meshes by file name, so each file gets a fresh folder.
        with tempfile.TemporaryDirectory(prefix="ideal_robot_surface_") as folder:
            mesh, image = Path(folder) / "surface.obj", Path(folder) / "surface.png"
            mesh.write_text(self._mesh(texture), encoding="ascii")
            cv2.imwrite(str(image), texture.image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            shape = pybullet.createVisualShape(pybullet.GEOM_MESH, fileName=str(mesh), rgbaColor=[1, 1, 1, 1],
                                               physicsClientId=self._client)
            plane = self.surface.plane
            quaternion = pin.Quaternion(plane.rotation).coeffs().tolist()
            body = pybullet.createMultiBody(0, -1, shape, plane.translation.tolist(), quaternion,
                                            physicsClientId=self._client)
            identifier = pybullet.loadTexture(str(image), physicsClientId=self._client)
        pybullet.changeVisualShape(body, -1, textureUniqueId=identifier, physicsClientId=self._client)
