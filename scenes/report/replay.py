"""A replay inside a page: the arm moves, the error is drawn enlarged, all in one self-contained piece of HTML.

No library is loaded and nothing is fetched: the arm's primitive shapes become polygons that a short script draws on a
canvas, so that the page also plays on a phone and without a network.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot

FRAMES = 400
"""A replay has no more frames than that; longer runs are thinned out."""
SIDES = 10
"""Corners of a circle."""


@dataclass(frozen=True)
class Replay:
    """What a replay shows; everything over one time axis of ``N`` samples.

    Attributes:
        robot: the arm, drawn from its URDF's primitive shapes.
        t: times ``(N,)`` [s].
        q: arm angles ``(N, n)`` [rad].
        tool: where the TCP truly was ``(N, 3)`` [m].
        wanted: the point it should have been at, or the nearest one of the line ``(N, 3)`` [m].
        error: what is plotted below and colours the trace ``(N,)``, in ``unit``; NaN where it does not count.
        error_name, unit: what that is.
        curves: further curves by name ``(K, 3)`` [m], e.g. the drawn line.
        surface: corners of the surface ``(4, 3)`` [m], or None.
        pictures: camera pictures, time [s] and PNG.
        ghost: arm angles of another method at the same times ``(N, n)`` [rad], drawn pale, or None.
        enlarged: how many times the error is enlarged in the view from above.
    """

    robot: Robot
    t: Array
    q: Array
    tool: Array
    wanted: Array
    error: Array
    error_name: str = "distance from the path"
    unit: str = "mm"
    curves: dict[str, Array] = field(default_factory=dict)
    surface: Array | None = None
    pictures: tuple[tuple[float, bytes], ...] = ()
    ghost: Array | None = None
    enlarged: float = 50.0

    def __post_init__(self) -> None:
        n = len(self.t)
        shapes = {"q": (n, self.robot.n), "tool": (n, 3), "wanted": (n, 3), "error": (n,)}
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise InputError(f"expected the shape {shape}", field=name, value=np.shape(getattr(self, name)))
        if n < 2:
            raise InputError("a replay needs two samples at least", field="t", value=n)

    def html(self) -> str:
        """The replay as a piece of HTML for a page."""
        script = resources.files("scenes").joinpath("templates/replay.js").read_text(encoding="utf-8")
        # "</" inside a script would end it.
        data = json.dumps(self._data(), allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
        return f'<div class="replay"></div>\n<script>\n(function () {{\nconst DATA = {data};\n{script}}})();\n</script>'

    def _data(self) -> dict[str, Any]:
        step = max(1, -(-len(self.t) // FRAMES))
        rows = slice(None, None, step)
        shapes, links = polygons(self.robot)
        counts = np.isfinite(self.error)
        # Where the error does not count, there is nothing to enlarge.
        wanted = np.where(counts[:, None], self.wanted, self.tool)
        error = [None if not np.isfinite(value) else round(float(value), 4) for value in self.error[rows]]
        return {
            "t": _rounded(self.t[rows] - self.t[0], 3),
            "links": _rounded(link_poses(self.robot, self.q[rows], links), 4),
            "ghost": None if self.ghost is None else _rounded(link_poses(self.robot, self.ghost[rows], links), 4),
            "shapes": shapes,
            "tool": _rounded(self.tool[rows], 5), "wanted": _rounded(wanted[rows], 5),
            "error": error, "errorName": self.error_name, "unit": self.unit,
            "curves": {name: _rounded(curve[:: max(1, len(curve) // 300)], 4) for name, curve in self.curves.items()},
            "surface": None if self.surface is None else _rounded(self.surface, 4),
            "pictures": [[round(float(t - self.t[0]), 3), "data:image/png;base64,"
                          + base64.b64encode(png).decode("ascii")] for t, png in self.pictures],
            "enlarged": self.enlarged,
        }


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
    try:
        items = pin.buildGeomFromUrdf(model, str(robot.urdf), pin.GeometryType.VISUAL).geometryObjects
    except (ValueError, RuntimeError):
        # The meshes that the URDF names are not there; rods stand for the links.
        items = []
    for item in items:
        faces = _faces(item.geometry)
        if not faces:
            continue
        placed = [[_rounded(item.placement.act(np.asarray(corner)), 4) for corner in face] for face in faces]
        shapes.append({"link": int(item.parentJoint), "faces": placed,
                       "colour": [round(255 * float(c)) for c in item.meshColor[:3]]})
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
    return [[_rounded(rotation @ (np.asarray(corner) + np.array([0.0, 0.0, 0.5 * length])), 4) for corner in face]
            for face in _box(radius, radius, 0.5 * length)]


def _rounded(values: Array, digits: int) -> list[Any]:
    rounded: list[Any] = np.round(np.asarray(values, dtype=float), digits).tolist()
    return rounded
