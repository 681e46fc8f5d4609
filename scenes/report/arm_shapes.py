"""The visible shapes of an arm as polygons, and where they are along a motion: for replays and the viewer.

Only primitive shapes are drawn; no file that a URDF names is opened. An arm of meshes is drawn as rods between its
joints.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.urdf import without_meshes

SIDES = 10
"""Corners of a circle."""


def polygons(robot: Robot) -> tuple[list[dict[str, Any]], list[int]]:
    """The visible shapes of an arm as polygons, and the joints whose poses carry them.

    Args:
        robot: the arm; meshes are left out.

    Returns:
        For each shape its link's place in the second list, colour, and faces with their corners [m]; and Pinocchio's
        joint indices of these links. Without any shape the links are drawn as rods between the joints.
    """
    model = robot.pinocchio
    shapes: list[dict[str, Any]] = []
    links = list(range(model.njoints))
    text = without_meshes(robot.urdf.read_text(encoding="utf-8"))
    for item in pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL).geometryObjects:
        faces = _faces(item.geometry)
        if not faces:
            continue
        placed = [[rounded(item.placement.act(np.asarray(corner)), 4) for corner in face] for face in faces]
        shapes.append({"link": int(item.parentJoint), "faces": placed,
                       "colour": [round(255 * float(c)) for c in item.meshColor[:3]]})
    if robot.tool_length > 0.0:
        flange = model.frames[model.frames[robot.tool_id].parentFrame]
        rod = [[rounded(flange.placement.act(np.asarray(corner)), 4) for corner in face]
               for face in _rod(np.array([0.0, 0.0, robot.tool_length]), 0.006)]
        shapes.append({"link": int(flange.parentJoint), "faces": rod, "colour": [51, 51, 51]})
    if not shapes:
        for joint in range(1, model.njoints):
            end = model.jointPlacements[joint].translation
            if np.linalg.norm(end) > 1e-6:
                shapes.append({"link": int(model.parents[joint]), "faces": _rod(end, 0.04), "colour": [224, 106, 0]})
    return shapes, links


def link_poses(robot: Robot, q: Array, links: list[int]) -> Array:
    """Poses of links along a motion, rotation matrix by rows and place, ``(N, links, 12)``.

    Args:
        robot: the arm.
        q: arm angles ``(N, n)`` [rad].
        links: Pinocchio's joint indices.
    """
    data = robot.pinocchio.createData()
    poses = np.empty((len(q), len(links), 12))
    for k, row in enumerate(np.ascontiguousarray(q)):
        pin.forwardKinematics(robot.pinocchio, data, row)
        for i, link in enumerate(links):
            poses[k, i, :9] = data.oMi[link].rotation.ravel()
            poses[k, i, 9:] = data.oMi[link].translation
    return poses


def _faces(shape: Any) -> list[list[list[float]]]:
    """Faces of a primitive shape in its own frame; none for meshes."""
    kind = type(shape).__name__
    if kind == "Box":
        return _box(*(float(v) for v in shape.halfSide))
    if kind in ("Cylinder", "Capsule"):
        return _cylinder(float(shape.radius), float(shape.halfLength))
    if kind == "Sphere":
        return _sphere(float(shape.radius))
    return []


def _box(x: float, y: float, z: float) -> list[list[list[float]]]:
    corner = [[sx * x, sy * y, sz * z] for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)]
    order = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return [[corner[i] for i in face] for face in order]


def _cylinder(radius: float, half: float) -> list[list[list[float]]]:
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    low = [[radius * float(np.cos(a)), radius * float(np.sin(a)), -half] for a in angle]
    high = [[x, y, half] for x, y, _ in low]
    sides = [[low[i], low[(i + 1) % SIDES], high[(i + 1) % SIDES], high[i]] for i in range(SIDES)]
    return [*sides, high, low[::-1]]


def _sphere(radius: float) -> list[list[list[float]]]:
    rings = 6
    grid = [[[radius * float(np.sin(p) * np.cos(a)), radius * float(np.sin(p) * np.sin(a)), radius * float(np.cos(p))]
             for a in 2.0 * np.pi * np.arange(SIDES) / SIDES] for p in np.pi * np.arange(rings + 1) / rings]
    return [[grid[i][j], grid[i + 1][j], grid[i + 1][(j + 1) % SIDES], grid[i][(j + 1) % SIDES]]
            for i in range(rings) for j in range(SIDES)]


def _rod(end: Array, radius: float) -> list[list[list[float]]]:
    """A square rod from the origin to ``end (3,)`` [m]."""
    length = float(np.linalg.norm(end))
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.asarray(end) / length).matrix()
    return [[rounded(rotation @ (np.asarray(corner) + np.array([0.0, 0.0, 0.5 * length])), 4) for corner in face]
            for face in _box(radius, radius, 0.5 * length)]


def rounded(values: Array, digits: int) -> list[Any]:
    """Nested lists of the values, rounded to keep pages small."""
    short: list[Any] = np.round(np.asarray(values, dtype=float), digits).tolist()
    return short
