"""The arm's links in the camera's picture: boxes and cylinders of its URDF at the pose of the exposure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.urdf import without_meshes
from sensing.camera.camera_device import Window
from sensing.camera.camera_model import CameraModel
from sim.bullet import pybullet
from sim.camera.lamp import half_sizes, joint_places

LUMINANCE = np.array([0.299, 0.587, 0.114])
"""Shares of red, green and blue in a gray value."""
SIDES = 12
"""Of a cylinder."""
MARGIN, AROUND = 0.05, 0.002
"""By which a window counts as wider, as tangent, and a shape as larger [m]: the camera turns and moves during the
exposure."""
CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
"""Of a box with half sides of 1."""


def _prism(radius: float, half: float) -> tuple[list[list[float]], list[int]]:
    """Corners [m] and triangles of a cylinder about z, with fewer of them than PyBullet's own has."""
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    corners = np.vstack([np.column_stack([ring, np.full(SIDES, z)]) for z in (-half, half)])
    i = np.arange(SIDES)
    j = (i + 1) % SIDES
    sides = np.vstack([np.column_stack([i, j, SIDES + j]), np.column_stack([i, SIDES + j, SIDES + i])])
    ends = np.column_stack([np.zeros(SIDES - 2, dtype=int), i[2:], i[1:-1]])
    return corners.tolist(), np.vstack([sides, ends, SIDES + ends[:, ::-1]]).ravel().tolist()


class Body:
    """A body that is only rendered, and hidden where no window shows it.

    The renderer processes all triangles and pixels of every visible body.

    Args:
        number, client: PyBullet's ids of the body and of its physics client.
        colour: red, green, blue, opaque.
    """

    def __init__(self, number: int, client: int, colour: Sequence[float]) -> None:
        self.number, self._client = number, client
        self._colours = [*colour[:3], 0.0], [*colour[:3], 1.0]
        self._shown = True

    def show(self, shown: bool) -> None:
        """Shows or hides the body; hidden, it is fully transparent and skipped by the renderer."""
        if shown != self._shown:
            pybullet.changeVisualShape(self.number, -1, rgbaColor=self._colours[shown], physicsClientId=self._client)
            self._shown = shown

    def stand(self, place: pin.SE3) -> None:
        """Moves the body to a pose in the base frame."""
        pybullet.resetBasePositionAndOrientation(self.number, place.translation.tolist(),
                                                 pin.Quaternion(place.rotation).coeffs().tolist(),
                                                 physicsClientId=self._client)


class ArmBodies:
    """The arm's visible shapes in a camera's physics client.

    The renderer processes every body of its client, so a shape is loaded only when a window shows it for the first
    time.

    Args:
        robot: the arm; meshes of its URDF are not opened, and not seen.
        client: PyBullet's id of the camera's physics client.
        camera: the true one.

    Attributes:
        bodies: PyBullet's ids of the shapes that have been loaded, by their place in the URDF.
    """

    def __init__(self, robot: Robot, client: int, camera: CameraModel) -> None:
        self._model, self._data = robot.pinocchio, robot.pinocchio.createData()
        self._client, self._camera = client, camera
        text = without_meshes(robot.description)
        shapes = pin.buildGeomFromUrdfString(self._model, text, pin.GeometryType.VISUAL).geometryObjects
        sized = [(shape, half) for shape in shapes if (half := half_sizes(shape.geometry)) is not None]
        self._shapes: list[Any] = [shape for shape, _ in sized]
        self._parents = np.array([shape.parentJoint for shape in self._shapes], dtype=int)
        self._reach = np.array([np.linalg.norm(half) for _, half in sized])
        self._corners = np.array([[shape.placement.act(corner * half) for corner in CORNERS] for shape, half in sized]
                                 ).reshape(-1, len(CORNERS), 3)
        self.bodies: dict[int, Body] = {}
        self._standing: set[int] = set()

    def stand(self, q: Array, pose: pin.SE3) -> None:
        """Computes the links' poses at ``q (n,)`` [rad], the TCP at ``pose``; ``shown`` applies them."""
        pin.forwardKinematics(self._model, self._data, np.asarray(q, dtype=float))
        eye = pose * self._camera.T_tool_camera
        rotation, place = joint_places(self._data)
        turned, moved = eye.rotation.T @ rotation, (place - eye.translation) @ eye.rotation
        self._seen = self._corners @ turned[self._parents].transpose(0, 2, 1) + moved[self._parents, None]
        self._standing.clear()

    def shown(self, windows: Sequence[Window]) -> list[set[Body]]:
        """The links that each window may show, moved to their poses; none of the windows is empty."""
        visible = in_view(self._camera, windows, self._seen, self._reach)
        for k in np.flatnonzero(visible.any(axis=0)).tolist():
            if k not in self.bodies:
                self.bodies[k] = self._body(self._shapes[k])
            if k not in self._standing:
                shape = self._shapes[k]
                self.bodies[k].stand(self._data.oMi[shape.parentJoint] * shape.placement)
                self._standing.add(k)
        return [{self.bodies[k] for k in np.flatnonzero(row).tolist()} for row in visible]

    def _body(self, shape: Any) -> Body:
        gray = float(LUMINANCE @ np.asarray(shape.meshColor[:3], dtype=float))
        colour, x, client = [gray, gray, gray, 1.0], shape.geometry, self._client
        if hasattr(x, "halfSide"):
            visual = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=x.halfSide.tolist(), rgbaColor=colour,
                                                physicsClientId=client)
        else:
            corners, faces = _prism(x.radius, x.halfLength)
            visual = pybullet.createVisualShape(pybullet.GEOM_MESH, vertices=corners, indices=faces, rgbaColor=colour,
                                                physicsClientId=client)
        return Body(int(pybullet.createMultiBody(0.0, -1, visual, physicsClientId=client)), client, colour)


def in_view(camera: CameraModel, windows: Sequence[Window], corners: Array, reach: Array) -> NDArray[np.bool_]:
    """Which of some boxes each window may show, as a mask ``(windows, M)``.

    Args:
        camera: the camera that sees them.
        windows: of its picture.
        corners: of the boxes in the camera's frame ``(M, 8, 3)`` [m].
        reach: from their middles to their corners ``(M,)`` [m].
    """
    table = np.array(windows, dtype=float).reshape(-1, 4)
    u, v = table[:, :1] + (table[:, 2:3] - 1.0) * [0, 1, 0, 1], table[:, 1:2] + (table[:, 3:] - 1.0) * [0, 0, 1, 1]
    rays = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2))[:, :2].reshape(-1, 4, 2)
    return np.asarray(_in_front(corners, reach, rays.min(axis=1) - MARGIN, rays.max(axis=1) + MARGIN))


@jit()
def _in_front(corners: Array, reach: Array, least: Array, most: Array) -> NDArray[np.bool_]:
    """Which boxes, ``corners (M, 8, 3)`` [m] in the camera's frame, may be seen through which windows ``(windows, M)``.

    Those whose ball about their middle reaches in front of each of the four planes through the eye that bound the
    window, and then not all of whose corners are behind the same one. ``least`` are tangents of the sides to the left
    and above ``(windows, 2)``, ``most`` of those to the right and below.
    """
    visible = np.zeros((least.shape[0], corners.shape[0]), dtype=np.bool_)
    for k in range(corners.shape[0]):
        x, y, z, deepest = 0.0, 0.0, 0.0, -np.inf
        for c in range(8):
            x, y, z = x + corners[k, c, 0] / 8.0, y + corners[k, c, 1] / 8.0, z + corners[k, c, 2] / 8.0
            deepest = max(deepest, corners[k, c, 2])
        if deepest <= 0.0:
            continue
        for w in range(least.shape[0]):
            inside = True
            for side in range(4):
                a = side % 2
                sense, tangent = (1.0, least[w, a]) if side < 2 else (-1.0, most[w, a])
                length = np.sqrt(1.0 + tangent * tangent)
                if sense * ((y if a else x) - tangent * z) / length <= -reach[k]:
                    inside = False
                    break
                front = -np.inf
                for c in range(8):
                    front = max(front, sense * (corners[k, c, a] - tangent * corners[k, c, 2]) / length)
                if front <= -AROUND:
                    inside = False
                    break
            visible[w, k] = inside
    return visible
