"""An arm and what is around it in a browser (viser)."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from scenes.report.arm_shapes import link_poses, polygons

GHOST = "ghost"
ARM = "arm"
_FARTHEST = 1.4
"""How much farther away a page looks from that is higher than wide, at most."""
_ABOVE_CONTROLS = 0.12
"""How far below the scene's middle it looks, as a share of the distance: there lie the controls."""


class Viewer:
    """A browser page with the arm; ``show(q)`` moves it.

    Args:
        robot: the arm, drawn from the primitive shapes of its URDF; rods where it has meshes only.
        port: TCP port on this machine; the next free one where it is taken, ``port`` then says which.

    Raises:
        InputError: viser is not installed.
    """

    def __init__(self, robot: Robot, port: int = 8080) -> None:
        try:
            import viser
        except ImportError as error:
            raise InputError("needs the package viser (pip install 'ideal-robot[view]')", field="view") from error
        self.robot = robot
        self.shapes, self._links = polygons(robot)
        self.server: Any = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        self.port = int(self.server.get_port())
        self.server.scene.set_up_direction("+z")
        self.server.initial_camera.position = (2.6, -2.2, 1.7)
        self.server.initial_camera.look_at = (0.5, 0.0, 0.6)
        self.server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.25)
        self.server.on_client_connect(self._step_back)
        self._arrows: dict[str, Any] = {}
        self.frames: dict[str, list[Any]] = {ARM: self._add(ARM, None)}
        self.show(robot.home)

    def _add(self, name: str, opacity: float | None) -> list[Any]:
        """A frame for each link, with its shapes as meshes."""
        frames = [self.server.scene.add_frame(f"/{name}/{link}", show_axes=False) for link in self._links]
        for index, shape in enumerate(self.shapes):
            corners = np.array([corner for face in shape["faces"] for corner in face])
            triangles, first = [], 0
            for face in shape["faces"]:
                triangles += [(first, first + i, first + i + 1) for i in range(1, len(face) - 1)]
                first += len(face)
            self.server.scene.add_mesh_simple(
                f"/{name}/{shape['link']}/{index}", vertices=corners, faces=np.array(triangles), flat_shading=True,
                side="double", opacity=opacity, color=tuple(shape["colour"]) if opacity is None else (120, 130, 145))
        return frames

    def show(self, q: Array, name: str = ARM) -> None:
        """Shows an arm at joint positions.

        Args:
            q: ``(n,)`` [rad].
            name: ``ARM``, or ``GHOST`` for a second, pale one.
        """
        if name not in self.frames:
            self.frames[name] = self._add(name, 0.25)
        poses = link_poses(self.robot, np.asarray(q, dtype=float)[None], self._links)[0]
        with self.server.atomic():
            for frame, pose in zip(self.frames[name], poses, strict=True):
                frame.wxyz = _quaternion(pose[:9].reshape(3, 3))
                frame.position = tuple(pose[9:])

    def draw(self, name: str, points: Array, colour: tuple[int, int, int] | Array, thickness: float = 3.0) -> None:
        """Draws a curve.

        Args:
            name: of the curve in the scene's tree.
            points: ``(N, 3)`` [m] in the base frame.
            colour: of the whole curve, or of each piece ``(N - 1, 3)``; 0 to 255.
            thickness: on the screen [px].
        """
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        whole = np.shape(colour) == (3,)
        colours: Any = colour if whole else np.repeat(np.asarray(colour, dtype=np.uint8)[:, None], 2, axis=1)
        self.server.scene.add_line_segments(f"/curves/{name}", points=pieces, colors=colours, thickness=thickness,
                                            thickness_units="screen")

    def arrow(self, name: str, start: Array, vector: Array, colour: tuple[int, int, int]) -> None:
        """Draws an arrow, or moves it.

        Args:
            name: of the arrow in the scene's tree.
            start: where it begins ``(3,)`` [m].
            vector: from there to its point ``(3,)`` [m].
            colour: 0 to 255.
        """
        points = np.array([[start, start + vector]])
        if name in self._arrows:
            self._arrows[name].points = points
        else:
            self._arrows[name] = self.server.scene.add_arrows(f"/arrows/{name}", points=points, colors=colour,
                                                              shaft_radius=0.008, head_radius=0.02, head_length=0.05)

    def look_at(self, place: Array, distance: float) -> None:
        """Where a page that is opened looks.

        Args:
            place: ``(3,)`` [m].
            distance: from it [m].
        """
        camera = self.server.initial_camera
        # A little to the right of it: there the controls lie above the picture.
        aim = np.asarray(place) + 0.12 * distance * np.array([0.66, 0.75, 0.0])
        camera.position = tuple(aim + distance * np.array([0.68, -0.6, 0.42]))
        camera.look_at = tuple(aim)

    def _step_back(self, client: Any) -> None:
        """A page that is higher than wide, as a phone's, sees the arm from farther away, above the controls."""
        if client.camera.aspect >= 1.0:
            return
        # The page tells of its camera before it has taken the first view.
        first = self.server.initial_camera
        aim, position = np.asarray(first.look_at), np.asarray(first.position)
        away = min(1.0 / client.camera.aspect, _FARTHEST) * (position - aim)
        aim = aim - [0.0, 0.0, _ABOVE_CONTROLS * float(np.linalg.norm(away))]
        with client.atomic():
            client.camera.position, client.camera.look_at = tuple(aim + away), tuple(aim)

    def surface(self, corners: Array) -> None:
        """Draws a flat surface with ``corners (4, 3)`` [m]."""
        # A little lower than it is, so that what is drawn on it can be seen.
        lowered = np.asarray(corners) - [0.0, 0.0, 0.003]
        self.server.scene.add_mesh_simple("/surface", vertices=lowered,
                                          faces=np.array([[0, 1, 2], [0, 2, 3]]), color=(245, 245, 240), side="double",
                                          cast_shadow=False)


def _quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """A rotation matrix as w, x, y, z."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return float(w), float(x), float(y), float(z)
