"""The camera as PyBullet's TinyRenderer renders it: the drawn texture, flat or on a relief, and before it tool and arm.

Shifting the principal point in the projection matrix moves a window to any place of the image. TinyRenderer draws an
undistorted picture; the lens is put in by sampling it where the distorted pixels' rays hit it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.file_array import temporary_folder
from ideal_robot.robots.robot import Robot
from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Window
from sim.bullet import output_dropped, pybullet
from sim.camera.arm_bodies import ArmBodies
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.lamp import Lamp
from sim.camera.lens_sampling import add_samples, displacements, sample_rays
from sim.camera.surface import DrawnLine
from sim.camera.texture import Texture
from sim.camera.tool_mesh import TOOL_COLOUR, tool_mesh
from sim.contact.contact import HeightSurface

STRIP = 0.008
"""Length of the mesh's strips along the plane's x [m]: on a radius of 1 m they leave the surface by 8 µm."""
ROWS = 4
"""Strips across."""


# TinyRenderer samples at integer coordinates with rows counted from below: this much has to be added to the principal
# point of OpenCV's convention (pixel centres at integers) before it goes into the projection matrix.
PIXEL_SHIFT_U, PIXEL_SHIFT_V = 0.0, 1.0
NEAR, FAR = 0.02, 3.0


class BulletCamera(RenderedCamera):
    """Renders the drawn line by PyBullet.

    Args:
        model: the true camera.
        surface: the drawn line, given on the nominal plane; it is lifted to the relief.
        settings, rng, lamp: as ``RenderedCamera``.
        relief: heights over the same plane; None for the plane itself.
        tool: whether the tool's tip and a hose beside it are in the picture.
        arm: whose links are in the picture, with its tool; None for an arm that stays out of it.
        strips: length of the relief's flat pieces along the plane's x and y [m]; for a surface that is bent along x
            alone the usual ones.

    Attributes:
        arm: links in the picture; None where there are none.
    """

    def __init__(self, model: CameraModel, surface: DrawnLine, settings: CameraSettings, rng: np.random.Generator, *,
                 relief: HeightSurface | None = None, tool: bool = False, arm: Robot | None = None,
                 lamp: Lamp | None = None, strips: tuple[float, float] | None = None) -> None:
        super().__init__(model, surface, settings, rng, lamp=lamp)
        self._strips = strips
        self._relief = relief
        self._offsets = displacements(settings.sub_exposures)
        self._client = pybullet.connect(pybullet.DIRECT)
        self._tool = -1
        self.arm = None if arm is None else ArmBodies(arm, self._client, model)
        with output_dropped(), temporary_folder() as folder:
            self._load_surface(self.texture, folder)
            if tool:
                length = 0.0 if arm is None else arm.tool_length
                self._tool = self._body(folder, "tool", tool_mesh(length), pin.SE3.Identity(), TOOL_COLOUR)

    def close(self) -> None:
        """Frees the renderer."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    @property
    def shows_arm(self) -> bool:
        """See ``RenderedCamera.shows_arm``."""
        return self.arm is not None

    def _stand(self, q: Array, pose: pin.SE3, windows: Sequence[Window]) -> None:
        if self.arm is not None:
            self.arm.stand(q, pose, windows)

    def _sampled(self, windows: Sequence[Window], poses: Sequence[pin.SE3], n: int) -> tuple[Array, Array | float]:
        seen = [self._render(window, poses, n) for window in windows]
        gray = np.concatenate([np.empty(0), *(one.ravel() for one, _ in seen)])
        if self.arm is None or not self.arm.in_view:
            return gray, 1.0
        return gray, np.concatenate([np.empty(0), *(bare.ravel() for _, bare in seen)])

    def _view(self, pose: pin.SE3) -> list[float]:
        """OpenGL view matrix, column-major: base frame → camera with y up and z backwards."""
        T = (pose * self.model.T_tool_camera).inverse()
        V = np.eye(4)
        V[:3, :3], V[:3, 3] = T.rotation, T.translation
        V[1:3] *= -1.0
        return V.T.ravel().tolist()

    def _render(self, window: Window, poses: Sequence[pin.SE3], n: int) -> tuple[Array, Array]:
        """Mean gray values ``(height, width)`` of a window over the poses, ``n`` × ``n`` samples per pixel and pose.

        Beside them the share of each pixel in which the surface is seen, where the arm may be before it.
        """
        K, k = self.model.K, self.model.distortion
        if window.width == 0 or window.height == 0:
            return np.zeros((window.height, window.width)), np.zeros((window.height, window.width))
        x, y = sample_rays(window.u, window.v, window.height, window.width, n, K, k)
        scale = n * K[0, 0]
        offsets = self._offsets if len(poses) > 1 else np.zeros((1, 2))
        # The smallest undistorted picture that covers all samples wherever a sub-exposure moves its grid.
        pad_u, pad_v = np.abs(offsets).max(axis=0)
        column0, row0 = pad_u - scale * x.min(), pad_v - scale * y.min()
        width = int(scale * x.max() + column0 + pad_u) + 2
        height = int(scale * y.max() + row0 + pad_v) + 2
        total, bare = np.zeros((window.height, window.width)), np.zeros((window.height, window.width))
        for pose, (du, dv) in zip(poses, offsets, strict=True):
            self._carry_tool(pose)
            # The samples stay where they are; the renderer's own grid moves below them, which averages its hard edges.
            image, surface = self._picture(self._view(pose), width, height, scale, column0 + du, row0 + dv)
            add_samples(total, image, x, y, scale, column0 + du, row0 + dv, 1.0 / len(poses))
            if surface is not None:
                add_samples(bare, surface, x, y, scale, column0 + du, row0 + dv, 1.0 / len(poses))
        return total, bare

    def _picture(self, view: list[float], width: int, height: int, f: float, cx: float, cy: float
                 ) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
        """Rendered picture ``(height, width, 4)``; if the arm may be there, which pixels are surface ``(…, 1)``."""
        arm = self.arm is not None and self.arm.in_view
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
            flags=0 if arm else pybullet.ER_NO_SEGMENTATION_MASK, physicsClientId=self._client,
        )  # fmt: skip
        if not arm:
            return picture[2], None
        bodies = np.asarray(picture[4])
        return picture[2], ((bodies == self._ground) | (bodies < 0)).astype(np.uint8)[:, :, None]

    def _carry_tool(self, pose: pin.SE3) -> None:
        if self._tool >= 0:
            pybullet.resetBasePositionAndOrientation(self._tool, pose.translation.tolist(),
                                                     pin.Quaternion(pose.rotation).coeffs().tolist(),
                                                     physicsClientId=self._client)

    def _load_surface(self, texture: Texture, folder: Path) -> None:
        x0, y1 = texture.x_min, texture.y_max
        width, depth = texture.size
        rows = columns = 1
        if self._relief is not None:
            along, across = (STRIP, depth / ROWS) if self._strips is None else self._strips
            columns, rows = max(2, int(np.ceil(width / along))), max(2, int(np.ceil(depth / across)))
        x = x0 + width * np.arange(columns + 1) / columns
        y = y1 - depth + depth * np.arange(rows + 1) / rows
        lines = []
        for j in range(rows + 1):
            for i in range(columns + 1):
                z = 0.0 if self._relief is None else float(self._relief.height(x[i], y[j]))
                lines.append(f"v {x[i]:.9f} {y[j]:.9f} {z:.9f}")
        lines += [f"vt {i / columns:.9f} {j / rows:.9f}" for j in range(rows + 1) for i in range(columns + 1)]
        lines.append("vn 0 0 1")
        for j in range(rows):
            for i in range(columns):
                a = j * (columns + 1) + i + 1
                b, c, d = a + 1, a + columns + 2, a + columns + 1
                lines += [f"f {a}/{a}/1 {b}/{b}/1 {c}/{c}/1", f"f {a}/{a}/1 {c}/{c}/1 {d}/{d}/1"]
        body = self._ground = self._body(folder, "surface", lines, self.surface.plane, [1.0, 1.0, 1.0, 1.0])
        image = folder / "surface.png"
        image.write_bytes(cv2.imencode(".png", texture.image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
        identifier = pybullet.loadTexture(str(image), physicsClientId=self._client)
        pybullet.changeVisualShape(body, -1, textureUniqueId=identifier, physicsClientId=self._client)

    def _body(self, folder: Path, name: str, obj: Sequence[str], place: pin.SE3, colour: list[float]) -> int:
        """A body that is only seen, from the lines of an .obj file: only those have the right texture coordinates."""
        # PyBullet caches meshes by file name, so each camera's are in a folder of their own.
        mesh = folder / f"{name}.obj"
        mesh.write_text("\n".join(obj) + "\n", encoding="ascii")
        shape = pybullet.createVisualShape(pybullet.GEOM_MESH, fileName=str(mesh), rgbaColor=colour,
                                           physicsClientId=self._client)
        quaternion = pin.Quaternion(place.rotation).coeffs().tolist()
        return int(pybullet.createMultiBody(0, -1, shape, place.translation.tolist(), quaternion,
                                            physicsClientId=self._client))
