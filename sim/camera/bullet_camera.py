"""The camera rendered by PyBullet's TinyRenderer: the drawn texture, flat or on a relief, with tool and arm.

Shifting the principal point in the projection matrix moves a window to any place of the image. TinyRenderer draws an
undistorted picture; the lens is put in by sampling it where the distorted pixels' rays hit it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import temporary_folder
from sensing.camera.camera_device import Window
from sensing.camera.camera_model import CameraModel
from sim.bullet import output_dropped, pybullet
from sim.camera.arm_bodies import CORNERS, ArmBodies, Body, in_view
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.lamp import TOOL_COLOUR, Lamp, outline, tool_mesh
from sim.camera.sampling import add_samples, displacements, extent
from sim.camera.surface import DrawnLine, Texture
from sim.contact.contact import HeightSurface

STRIP = 0.008
"""Length of the mesh's strips along the plane's x [m]: on a radius of 1 m they leave the surface by 8 µm."""
ROWS = 4
"""Strips across."""
PIECE = 0.05
"""Length of the relief's pieces, of which those that no window shows are taken out [m]: the renderer works through all
triangles of the others."""

# TinyRenderer samples at integer coordinates with rows counted from below: this much has to be added to the principal
# point of OpenCV's convention (pixel centres at integers) before it goes into the projection matrix.
PIXEL_SHIFT_U, PIXEL_SHIFT_V = 0.0, 1.0
NEAR, FAR = 0.02, 3.0  # depths that are drawn [m]
BESIDE = 3.0
"""Pixels around the tool's outline that count as the tool: the shift above, and where sub-exposures look."""
STILL = ([0.0, 0.0], [[0.0, 0.0]])
"""Displacements of a picture's only exposure, and the largest of them."""
UPWARDS, WHITE = [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]


class BulletCamera(RenderedCamera):
    """Renders the drawn line by PyBullet.

    Args:
        model: the true camera.
        surface: the drawn line, given on the nominal plane; it is lifted to the relief.
        settings, rng, lamp: as ``RenderedCamera``.
        relief: heights over the same plane; None for the plane itself.
        tool: whether the tool's tip and a hose beside it are in the picture.
        arm: whose links are in the picture, with its tool; None for an arm that stays out of it.
        strips: length of the relief's flat facets along the plane's x and y [m]; by default those for a surface curved
            along x alone.

    Attributes:
        arm: links in the picture; None where there are none.
    """

    def __init__(self, model: CameraModel, surface: DrawnLine, settings: CameraSettings, rng: np.random.Generator, *,
                 relief: HeightSurface | None = None, tool: bool = False, arm: Robot | None = None,
                 lamp: Lamp | None = None, strips: tuple[float, float] | None = None) -> None:
        super().__init__(model, surface, settings, rng, lamp=lamp)
        self._strips = strips
        self._relief = relief
        offsets = displacements(settings.sub_exposures)
        self._offsets = np.abs(offsets).max(axis=0).tolist(), offsets.tolist()
        self._client = pybullet.connect(pybullet.DIRECT)
        self._tool: Body | None = None
        self.arm = None if arm is None else ArmBodies(arm, self._client, model)
        self.shows_arm = arm is not None
        self._pieces: list[Body] = []
        with output_dropped(), temporary_folder() as folder:
            self._load_surface(self.texture, folder)
            if tool:
                mesh = tool_mesh(0.0 if arm is None else arm.tool_length)
                number = self._body(folder, "tool", mesh, pin.SE3.Identity(), TOOL_COLOUR)
                self._tool = Body(number, self._client, TOOL_COLOUR)
                self._outline = outline(mesh, model.T_tool_camera.inverse())
                self._tool_within = [*self._outline[:2].min(axis=1, initial=np.inf).tolist(),
                                     *self._outline[2:].max(axis=1, initial=-np.inf).tolist()]

    def close(self) -> None:
        """Frees the renderer."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def _stand(self, q: Array, pose: pin.SE3) -> None:
        if self.arm is not None:
            self.arm.stand(q, pose)

    def _sampled(self, windows: Sequence[Window], poses: Sequence[pin.SE3], n: int) -> tuple[Array, Array | float]:
        looked = [window for window in windows if window.width * window.height]
        if not looked:
            return np.empty(0), 1.0
        views = [self._view(pose) for pose in poses]
        self._show_surface(looked, poses[len(poses) // 2])
        arm = self.arm.shown(looked) if self.arm is not None else [set[Body]()] * len(looked)
        rendered = [self._render(*each, poses, views, n) for each in zip(looked, arm, strict=True)]
        gray, bare = (np.concatenate([picture.ravel() for picture in part]) for part in zip(*rendered, strict=True))
        return gray, bare

    def _show_surface(self, windows: Sequence[Window], pose: pin.SE3) -> None:
        """Takes out of the picture what no window shows of the surface, with the TCP at ``pose``."""
        T = (pose * self.model.T_tool_camera).inverse() * self.surface.plane
        visible = in_view(self.model, windows, self._corners @ T.rotation.T + T.translation, self._reach)
        for piece, by_any in zip(self._pieces, visible.T.tolist(), strict=True):
            piece.show(any(by_any))

    def _view(self, pose: pin.SE3) -> list[float]:
        """OpenGL view matrix, column-major: base frame → camera with y up and z backwards."""
        T = (pose * self.model.T_tool_camera).inverse()
        V = np.eye(4)
        V[:3, :3], V[:3, 3] = T.rotation, T.translation
        V[1:3] *= -1.0
        return V.T.ravel().tolist()

    def _render(self, window: Window, arm: set[Body], poses: Sequence[pin.SE3], views: Sequence[list[float]], n: int
                ) -> tuple[Array, Array]:
        """Mean gray values ``(height, width)`` of a window over the poses, ``n`` × ``n`` samples per pixel and pose.

        Beside them the share of each pixel in which no arm hides the surface; the tool of a camera without an arm is
        lit as the surface is. Of both only what the window may show is drawn: the renderer takes as long for what is
        beside the picture.
        """
        x, y = self._samples(window, n)
        scale = n * self.model.K[0, 0]
        (pad_u, pad_v), offsets = self._offsets if len(poses) > 1 else STILL
        # The smallest undistorted picture that covers all samples wherever a sub-exposure moves its grid.
        left, top, right, bottom = extent(x, y)
        column0, row0 = pad_u - scale * left, pad_v - scale * top
        width = int(scale * right + column0 + pad_u) + 2
        height = int(scale * bottom + row0 + pad_v) + 2
        tool = self._tool if self._tool is not None and self._tool_in(-column0, -row0, width, height, scale) else None
        shown = arm if tool is None else arm | {tool}
        for body in self._before:
            body.show(body in shown)
        total, weight = np.zeros((window.height, window.width)), 1.0 / len(poses)
        parted = self.arm is not None and bool(shown)
        bare = np.zeros_like(total) if parted else np.ones_like(total)
        for pose, view, (du, dv) in zip(poses, views, offsets, strict=True):
            if tool is not None:
                tool.stand(pose)
            # The samples are fixed; the renderer's own grid is shifted below them, which averages its hard edges.
            grid = scale, column0 + du, row0 + dv
            image, bodies = self._picture(view, width, height, *grid, parted=parted)
            add_samples(total, image, x, y, grid, weight)
            if bodies is not None:
                add_samples(bare, self._surface_in(bodies), x, y, grid, weight)
        return total, bare

    @property
    def _before(self) -> list[Body]:
        """All that may stand before the surface."""
        return [*([] if self._tool is None else [self._tool]), *([] if self.arm is None else self.arm.bodies.values())]

    def _picture(self, view: list[float], width: int, height: int, f: float, cx: float, cy: float, *, parted: bool
                 ) -> tuple[NDArray[np.uint8], NDArray[np.int32] | None]:
        """Rendered picture ``(height, width, 4)``; if asked for, the body that each pixel shows ``(height, width)``."""
        cx, cy = cx + PIXEL_SHIFT_U, cy + PIXEL_SHIFT_V
        projection = [
            2 * f / width, 0.0, 0.0, 0.0,
            0.0, 2 * f / height, 0.0, 0.0,
            (width - 2 * cx) / width, (2 * cy - height) / height, -(FAR + NEAR) / (FAR - NEAR), -1.0,
            0.0, 0.0, -2 * FAR * NEAR / (FAR - NEAR), 0.0,
        ]  # fmt: skip
        picture: Any = pybullet.getCameraImage(
            width, height, view, projection, lightDirection=UPWARDS, lightColor=WHITE, lightAmbientCoeff=1.0,
            lightDiffuseCoeff=0.0, lightSpecularCoeff=0.0, shadow=0, renderer=pybullet.ER_TINY_RENDERER,
            flags=0 if parted else pybullet.ER_NO_SEGMENTATION_MASK, physicsClientId=self._client,
        )  # fmt: skip
        return picture[2], np.asarray(picture[4]) if parted else None

    def _surface_in(self, bodies: NDArray[np.int32]) -> NDArray[np.uint8]:
        """Which pixels show the surface, or nothing ``(height, width, 1)``, of the bodies that they show."""
        # The surface's facets are the client's first bodies; -1 means no body.
        return (bodies < len(self._pieces)).astype(np.uint8)[:, :, None]

    def _tool_in(self, left: float, top: float, width: int, height: int, scale: float) -> bool:
        """Whether an undistorted picture may show the tool; first column and row from the principal point, all [px]."""
        u0, v0 = (left - BESIDE) / scale, (top - BESIDE) / scale
        u1, v1 = (left + width + BESIDE) / scale, (top + height + BESIDE) / scale
        least_u, least_v, most_u, most_v = self._tool_within
        if least_u > u1 or most_u < u0 or least_v > v1 or most_v < v0:
            return False
        box = self._outline
        return bool(((box[0] < u1) & (box[2] > u0) & (box[1] < v1) & (box[3] > v0)).any())

    def _load_surface(self, texture: Texture, folder: Path) -> None:
        x0, y1 = texture.x_min, texture.y_max
        width, depth = texture.size
        rows = columns = 1
        if self._relief is not None:
            along, across = (STRIP, depth / ROWS) if self._strips is None else self._strips
            columns, rows = max(2, int(np.ceil(width / along))), max(2, int(np.ceil(depth / across)))
        x = x0 + width * np.arange(columns + 1) / columns
        y = y1 - depth + depth * np.arange(rows + 1) / rows
        z = np.array([[0.0 if self._relief is None else float(self._relief.height(along, across)) for along in x]
                      for across in y])
        boxes, colour = [], [*WHITE, 1.0]
        pieces = max(min(round(width / PIECE), columns), 1)
        for first, last in pairwise(np.linspace(0, columns, pieces + 1).astype(int).tolist()):
            span = slice(first, last + 1)
            u = texture.image.shape[1] * np.arange(first, last + 1) / columns
            left, right = int(u[0]), int(np.ceil(u[-1]))
            lines = _strips(x[span], y, z[:, span], (u - left) / (right - left))
            number = self._body(folder, f"surface{first}", lines, self.surface.plane, colour)
            # An uncompressed file: writing and reading a compressed one takes twice as long.
            image = folder / f"surface{first}.bmp"
            image.write_bytes(cv2.imencode(".bmp", texture.image[:, left:right])[1].data)
            identifier = pybullet.loadTexture(str(image), physicsClientId=self._client)
            pybullet.changeVisualShape(number, -1, textureUniqueId=identifier, physicsClientId=self._client)
            self._pieces.append(Body(number, self._client, colour))
            ends = np.array([[x[first], y[0], z[:, span].min()], [x[last], y[-1], z[:, span].max()]])
            boxes.append(ends.mean(axis=0) + 0.5 * np.diff(ends, axis=0) * CORNERS)
        self._corners = np.array(boxes)
        self._reach = np.linalg.norm(self._corners - self._corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)

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


def _strips(x: Array, y: Array, z: Array, u: Array) -> list[str]:
    """Lines of a relief's .obj file: heights ``z (rows + 1, columns + 1)`` [m]; ``u``: columns of the texture."""
    rows, columns = len(y) - 1, len(x) - 1
    lines = [f"v {x[i]:.9f} {y[j]:.9f} {z[j, i]:.9f}" for j in range(rows + 1) for i in range(columns + 1)]
    lines += [f"vt {along:.9f} {j / rows:.9f}" for j in range(rows + 1) for along in u]
    lines.append("vn 0 0 1")
    for j in range(rows):
        for i in range(columns):
            a = j * (columns + 1) + i + 1
            b, c, d = a + 1, a + columns + 2, a + columns + 1
            lines += [f"f {a}/{a}/1 {b}/{b}/1 {c}/{c}/1", f"f {a}/{a}/1 {c}/{c}/1 {d}/{d}/1"]
    return lines
