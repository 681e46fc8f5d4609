"""The arm's links in the camera's picture: boxes and cylinders of its URDF, where they stand at the exposure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.urdf import without_meshes
from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Window
from sim.bullet import pybullet
from sim.camera.lamp import half_sizes

LUMINANCE = np.array([0.299, 0.587, 0.114])
"""Shares of red, green and blue in a gray value."""
SIDES = 12
"""Of a cylinder."""
MARGIN = 0.05
"""By which a window counts as wider, as tangent: the camera moves and turns during the exposure."""


def prism(radius: float, half: float) -> tuple[list[list[float]], list[int]]:
    """Corners [m] and triangles of a cylinder about z, with fewer of them than PyBullet's own has.

    Args:
        radius: of the cylinder [m].
        half: of its length [m].
    """
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    corners = np.vstack([np.column_stack([ring, np.full(SIDES, z)]) for z in (-half, half)])
    i = np.arange(SIDES)
    j = (i + 1) % SIDES
    sides = np.vstack([np.column_stack([i, j, SIDES + j]), np.column_stack([i, SIDES + j, SIDES + i])])
    ends = np.column_stack([np.zeros(SIDES - 2, dtype=int), i[2:], i[1:-1]])
    return corners.tolist(), np.vstack([sides, ends, SIDES + ends[:, ::-1]]).ravel().tolist()


class ArmBodies:
    """The arm's visible shapes in a camera's physics client.

    A renderer works through all that is in its client, so a shape is brought in the first time that a window shows it.

    Args:
        robot: the arm; meshes of its URDF are not opened, and not seen.
        client: PyBullet's id of the camera's physics client.
        camera: the true one.

    Attributes:
        bodies: PyBullet's ids of the shapes that have been looked at, by their place in the URDF.
        in_view: whether a window may show one of them now.
    """

    def __init__(self, robot: Robot, client: int, camera: CameraModel) -> None:
        self._model, self._data = robot.pinocchio, robot.pinocchio.createData()
        self._client, self._camera = client, camera
        text = without_meshes(robot.urdf.read_text(encoding="utf-8"))
        found = pin.buildGeomFromUrdfString(self._model, text, pin.GeometryType.VISUAL).geometryObjects
        sized = [(one, half) for one in found if (half := half_sizes(one.geometry)) is not None]
        self._shapes: list[Any] = [one for one, _ in sized]
        self._reach = np.array([np.linalg.norm(half) for _, half in sized])
        self.bodies: dict[int, int] = {}
        self.in_view = False

    def stand(self, q: Array, pose: pin.SE3, windows: Sequence[Window]) -> None:
        """Puts the links where they are.

        Args:
            q: arm angles ``(n,)`` [rad].
            pose: of the TCP in the base frame.
            windows: what is looked at.
        """
        pin.forwardKinematics(self._model, self._data, np.asarray(q, dtype=float))
        places = [self._data.oMi[one.parentJoint] * one.placement for one in self._shapes]
        eye = pose * self._camera.T_tool_camera
        seen = (np.array([place.translation for place in places]) - eye.translation) @ eye.rotation
        shown = np.flatnonzero(self._in_view(seen, windows)).tolist()
        self.in_view = bool(shown)
        for k in shown:
            if k not in self.bodies:
                self.bodies[k] = self._body(self._shapes[k])
        for k, body in self.bodies.items():
            quaternion = pin.Quaternion(places[k].rotation).coeffs().tolist()
            pybullet.resetBasePositionAndOrientation(body, places[k].translation.tolist(), quaternion,
                                                     physicsClientId=self._client)

    def _in_view(self, seen: Array, windows: Sequence[Window]) -> NDArray[np.bool_]:
        """Which of the shapes' balls about their middles ``(M, 3)`` in the camera's frame [m] a window may show."""
        table = np.array([window for window in windows if window.width * window.height], dtype=float).reshape(-1, 4)
        u, v = table[:, :1] + (table[:, 2:3] - 1.0) * [0, 1, 0, 1], table[:, 1:2] + (table[:, 3:] - 1.0) * [0, 0, 1, 1]
        rays = self._camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2))[:, :2].reshape(-1, 4, 2)
        least, most = rays.min(axis=1) - MARGIN, rays.max(axis=1) + MARGIN
        # Distances from the planes through the eye that bound each window, positive inside, (windows, M, 2).
        across, ahead = seen[None, :, :2], seen[None, :, 2:]
        low = (across - least[:, None] * ahead) / np.hypot(1.0, least)[:, None]
        high = (most[:, None] * ahead - across) / np.hypot(1.0, most)[:, None]
        inside = (np.minimum(low, high).min(axis=2) > -self._reach).any(axis=0)
        return np.asarray(inside & (seen[:, 2] > -self._reach))

    def _body(self, shape: Any) -> int:
        gray = float(LUMINANCE @ np.asarray(shape.meshColor[:3], dtype=float))
        colour, x, client = [gray, gray, gray, 1.0], shape.geometry, self._client
        if hasattr(x, "halfSide"):
            seen = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=x.halfSide.tolist(), rgbaColor=colour,
                                              physicsClientId=client)
        else:
            corners, faces = prism(x.radius, x.halfLength)
            seen = pybullet.createVisualShape(pybullet.GEOM_MESH, vertices=corners, indices=faces, rgbaColor=colour,
                                              physicsClientId=client)
        return int(pybullet.createMultiBody(0.0, -1, seen, physicsClientId=client))
