"""Checks an arm for contact with itself, its base plane, a surface or boxes: by the URDF's shapes, or capsules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import coal
import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot, spread_postures
from ideal_robot.robots.size import reach
from ideal_robot.robots.urdf import without_meshes

THICK = 0.045
"""Radius of a link without a shape, relative to the arm's reach: UR10 0.05, LBR iiwa 0.07, KR 16 0.05."""
OFTEN = 0.5
"""Share of the postures all over its range in which shapes that overlap say nothing: they stand for neighbours."""
NEIGHBOURS = 2
"""Links so many joints apart touch each other by their gears, not by accident. So do links whose joints are less apart
than a link is thick, as those about the centre of a wrist."""
BOARD = 0.02
"""Thickness of a surface [m]."""
ON_THE_WAY = 12
"""Postures that are looked at between two."""
FLOOR = "the base plane"
SURFACE = "the surface"


@dataclass(frozen=True)
class Obstacle:
    """A box that stands in the cell.

    Attributes:
        name: in messages.
        place: pose of its middle in the base frame.
        size: along its axes [m].
    """

    name: str
    place: pin.SE3
    size: tuple[float, float, float]

    def edges(self) -> Array:
        """A polyline along all edges of the box, some of them twice ``(16, 3)`` [m]."""
        around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
        low, high = (np.column_stack([around, np.full(5, z)]) for z in (-1, 1))
        rest = np.array([[1, -1, 1], [1, -1, -1], [1, 1, -1], [1, 1, 1], [-1, 1, 1], [-1, 1, -1]])
        corners = 0.5 * np.vstack([low, high, rest]) * self.size
        return np.asarray(corners @ self.place.rotation.T + self.place.translation)


@dataclass(frozen=True)
class Touch:
    """A contact of an arm with itself or an obstacle.

    Attributes:
        row: row of the checked postures.
        one, other: names of the two bodies.
    """

    row: int
    one: str
    other: str

    def __str__(self) -> str:
        return f"{self.one} touches {self.other}"


class Shapes:
    """The arm's shapes and obstacles in its cell.

    Args:
        robot: the arm, base plane z = 0.
        surface: pose of a surface's middle, z out of it, that only the tool may touch; None for none.
        size: of the surface along its x and y axis [m].
        boxes: in the cell, which nothing of the arm but its base may touch.
    """

    def __init__(self, robot: Robot, surface: pin.SE3 | None = None, size: tuple[float, float] = (1.0, 1.0),
                 boxes: Sequence[Obstacle] = ()) -> None:
        self._robot, self._data = robot, robot.pinocchio.createData()
        self._radius = THICK * reach(robot)
        self._geometry = pin.GeometryModel()
        links = self._links()
        for (i, shape), (j, other) in combinations(links, 2):
            if j - i > NEIGHBOURS and self._between(i, j) > 2.0 * self._radius:
                self._geometry.addCollisionPair(pin.CollisionPair(shape, other))
        self._planes(links, surface, size)
        self._drop_neighbours()
        for box in boxes:
            standing = self._add(box.name, 0, box.place, coal.Box(*box.size))
            for joint, number in links:
                if joint > 0:
                    self._geometry.addCollisionPair(pin.CollisionPair(number, standing))
        self._found = pin.GeometryData(self._geometry)

    def first_touch(self, q: Array) -> Touch | None:
        """The first of postures ``(N, n)`` [rad] with a contact; None without any."""
        model = self._robot.pinocchio
        for row, posture in enumerate(q):
            if pin.computeCollisions(model, self._data, self._geometry, self._found, posture, True):
                for k, result in enumerate(self._found.collisionResults):
                    if result.isCollision():
                        pair = self._geometry.collisionPairs[k]
                        objects = self._geometry.geometryObjects
                        return Touch(row, *(_said(objects[i].name) for i in (pair.first, pair.second)))
        return None

    def touch_between(self, start: Array, end: Array) -> Touch | None:
        """The first contact on the straight joint motion between two postures ``(n,)`` [rad]; None without one."""
        return self.first_touch(start + np.linspace(0.0, 1.0, ON_THE_WAY)[:, None] * (end - start))

    def _between(self, first: int, last: int) -> float:
        """Length of the links between two others, along the chain from joint to joint [m]."""
        places = self._robot.pinocchio.jointPlacements
        return sum(float(np.linalg.norm(places[joint].translation)) for joint in range(first + 2, last + 1))

    def _links(self) -> list[tuple[int, int]]:
        """Adds the links' shapes; joint that carries each, and its number."""
        model = self._robot.pinocchio
        objects = pin.buildGeomFromUrdfString(model, without_meshes(self._robot.description),
                                              pin.GeometryType.COLLISION).geometryObjects
        shaped = {item.parentJoint for item in objects}
        links = [(int(item.parentJoint), self._add(f"link {item.parentJoint}", item.parentJoint, item.placement,
                                                   item.geometry)) for item in objects]
        ends = [*(model.jointPlacements[j].translation for j in range(1, model.njoints)), self._robot.tool_place]
        for joint, end in enumerate(ends):
            length = float(np.linalg.norm(end))
            if joint in shaped or length < self._radius:
                continue
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length).matrix()
            capsule = coal.Capsule(self._radius, max(length - self._radius, 1e-3))
            # The capsule starts away from its joint, as it would overlap the previous link there.
            place = pin.SE3(turn, np.asarray(end) * (0.5 + 0.5 * self._radius / length))
            links.append((joint, self._add(f"link {joint}", joint, place, capsule)))
        return links

    def _planes(self, links: list[tuple[int, int]], surface: pin.SE3 | None, size: tuple[float, float]) -> None:
        last = self._robot.pinocchio.frames[self._robot.tool_id].parentJoint
        floor = self._add(FLOOR, 0, pin.SE3.Identity(), coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0))
        for joint, number in links:
            if joint > 1:
                self._geometry.addCollisionPair(pin.CollisionPair(number, floor))
        if surface is None:
            return
        below = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * BOARD]))
        table = self._add(SURFACE, 0, surface * below, coal.Box(*size, BOARD))
        for joint, number in links:
            # The last links are not checked against the surface, as they are close to it with a short tool.
            if 1 < joint < last - 1:
                self._geometry.addCollisionPair(pin.CollisionPair(number, table))

    def _add(self, name: str, joint: int, place: pin.SE3, shape: coal.CollisionGeometry) -> int:
        number = self._geometry.ngeoms
        item = pin.GeometryObject(f"{name} ({number})", joint, place, shape)
        return int(self._geometry.addGeometryObject(item))

    def _drop_neighbours(self) -> None:
        """Takes away the pairs of shapes that overlap in most postures."""
        model, data = self._robot.pinocchio, pin.GeometryData(self._geometry)
        pairs = list(self._geometry.collisionPairs)
        count = np.zeros(len(pairs))
        postures = spread_postures(self._robot.q_min, self._robot.q_max)
        for q in postures:
            pin.computeCollisions(model, self._data, self._geometry, data, q, False)
            count += [result.isCollision() for result in data.collisionResults]
        for pair, often in zip(pairs, count / len(postures), strict=True):
            if often > OFTEN:
                self._geometry.removeCollisionPair(pair)


def _said(name: str) -> str:
    return name.rpartition(" (")[0].replace("link 0", "the base")
