"""The rendered camera over a surface that is not flat: the drawn texture on a relief."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pinocchio as pin

from sensing.camera.camera_model import CameraModel
from sim.bullet import pybullet
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.surface import DrawnLine
from sim.camera.texture import Texture
from sim.contact.contact import HeightSurface

STRIP = 0.008
"""Length of the mesh's strips along the plane's x [m]: on a radius of 1 m they leave the surface by 8 µm."""
ROWS = 4
"""Strips across."""


class ReliefCamera(RenderedCamera):
    """Renders the drawn line on a height surface instead of on its plane.

    Args:
        model: the true camera.
        surface: the drawn line, given on the nominal plane; it is lifted to the relief.
        relief: heights over the same plane.
        settings, rng: as ``RenderedCamera``.
    """

    def __init__(self, model: CameraModel, surface: DrawnLine, relief: HeightSurface, settings: CameraSettings,
                 rng: np.random.Generator) -> None:
        self._relief = relief
        super().__init__(model, surface, settings, rng)

    def _load(self, texture: Texture) -> None:
        x0, y1 = texture.x_min, texture.y_max
        width, depth = texture.size
        columns = max(2, int(np.ceil(width / STRIP)))
        x = x0 + width * np.arange(columns + 1) / columns
        y = y1 - depth + depth * np.arange(ROWS + 1) / ROWS
        lines = []
        for j in range(ROWS + 1):
            for i in range(columns + 1):
                lines.append(f"v {x[i]:.9f} {y[j]:.9f} {float(self._relief.height(x[i], y[j])):.9f}")
        lines += [f"vt {i / columns:.9f} {j / ROWS:.9f}" for j in range(ROWS + 1) for i in range(columns + 1)]
        lines.append("vn 0 0 1")
        for j in range(ROWS):
            for i in range(columns):
                a = j * (columns + 1) + i + 1
                b, c, d = a + 1, a + columns + 2, a + columns + 1
                lines += [f"f {a}/{a}/1 {b}/{b}/1 {c}/{c}/1", f"f {a}/{a}/1 {c}/{c}/1 {d}/{d}/1"]
        with tempfile.TemporaryDirectory(prefix="ideal_robot_relief_") as folder:
            mesh, image = Path(folder) / "relief.obj", Path(folder) / "relief.png"
            mesh.write_text("\n".join(lines) + "\n", encoding="ascii")
            cv2.imwrite(str(image), texture.image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            shape = pybullet.createVisualShape(pybullet.GEOM_MESH, fileName=str(mesh), rgbaColor=[1, 1, 1, 1],
                                               physicsClientId=self._client)
            plane = self.surface.plane
            quaternion = pin.Quaternion(plane.rotation).coeffs().tolist()
            body = pybullet.createMultiBody(0, -1, shape, plane.translation.tolist(), quaternion,
                                            physicsClientId=self._client)
            identifier = pybullet.loadTexture(str(image), physicsClientId=self._client)
        pybullet.changeVisualShape(body, -1, textureUniqueId=identifier, physicsClientId=self._client)
