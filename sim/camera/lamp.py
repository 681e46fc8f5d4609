"""What a lamp does to the picture of a surface: it fades with distance, is mirrored, and the arm's shadow falls on it.

TinyRenderer knows one light from infinity and shifts gray levels with it. Here a lamp stands somewhere, and each
pixel's place on the surface is lit as that lamp lights it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numba import njit

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import TOOL_TIP, Robot
from ideal_robot.robots.urdf import without_meshes
from sim.camera.tool_mesh import TOOL_RADIUS

SHINE = 240.0
"""How sharp the surface mirrors: exponent of the cosine between its normal and the middle of eye and lamp."""


@dataclass(frozen=True)
class Lamp:
    """A lamp above the surface.

    Attributes:
        place: where it is in the base frame ``(3,)`` [m].
        radius: of what shines [m]; it makes the shadow's soft edge.
        falloff: share of the light that comes from this lamp and fades with distance; the rest is the room's.
        shadow: share of the light that the arm takes away where it stands in the lamp's way.
        glare: gray levels added where the lamp is mirrored.
    """

    place: Array
    radius: float = 0.03
    falloff: float = 0.6
    shadow: float = 0.45
    glare: float = 60.0


class ArmShape:
    """The arm's links as capsules, for its shadow: boxes and cylinders of its URDF, or rods between the joints.

    A tool that a scene put on is one more.

    Args:
        robot: the arm.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._data = robot.pinocchio, robot.pinocchio.createData()
        text = without_meshes(robot.urdf.read_text(encoding="utf-8"))
        found: list[tuple[int, Array, Array, float]] = []
        for item in pin.buildGeomFromUrdfString(self._model, text, pin.GeometryType.VISUAL).geometryObjects:
            half = half_sizes(item.geometry)
            if half is None or item.parentJoint == 0:
                continue
            axis = int(np.argmax(half))
            radius = float(np.sort(half)[1])
            end = np.zeros(3)
            end[axis] = max(half[axis] - radius, 0.0)
            found.append((int(item.parentJoint), item.placement.act(-end), item.placement.act(end), radius))
        if not found:
            placed = self._model.jointPlacements
            found = [(int(self._model.parents[joint]), np.zeros(3), placed[joint].translation, 0.05)
                     for joint in range(2, self._model.njoints)]
        tool = self._model.frames[robot.tool_id]
        if tool.name == TOOL_TIP:
            flange = self._model.frames[tool.parentFrame].placement
            found.append((int(tool.parentJoint), flange.translation, tool.placement.translation, TOOL_RADIUS))
        self._parents = [parent for parent, *_ in found]
        self._ends = np.array([[a, b] for _, a, b, _ in found])
        self.radii = np.array([radius for *_, radius in found])

    def at(self, q: Array) -> Array:
        """Ends of the capsules' axes in the base frame ``(M, 2, 3)`` [m] at arm angles ``(n,)`` [rad]."""
        pin.forwardKinematics(self._model, self._data, np.asarray(q, dtype=float))
        return np.array([[self._data.oMi[parent].act(end) for end in ends]
                         for parent, ends in zip(self._parents, self._ends, strict=True)])


def half_sizes(shape: object) -> Array | None:
    """Half of the sides of the box ``(3,)`` [m] about a box or a cylinder; None for other shapes."""
    if hasattr(shape, "halfSide"):
        return np.array(shape.halfSide, dtype=float)
    if hasattr(shape, "halfLength") and hasattr(shape, "radius"):
        return np.array([shape.radius, shape.radius, shape.halfLength], dtype=float)
    return None


def light(lamp: Lamp, points: Array, normal: Array, centre: Array, hidden: Array) -> Array:
    """How bright places of the surface are ``(N,)``; 1 at ``centre`` with nothing in the lamp's way.

    Lambert's law with the lamp's distance r and the angle β from the normal: cos β / r², weighed by ``falloff``.

    Args:
        lamp: what lights them.
        points: on the surface ``(N, 3)`` [m].
        normal: of the surface ``(3,)``.
        centre: where the light is measured ``(3,)`` [m].
        hidden: share of the lamp that each place does not see ``(N,)``, as from ``covered``.
    """
    away, reference = lamp.place - points, lamp.place - centre
    lit = (away @ normal) / np.linalg.norm(away, axis=1) ** 3 * np.linalg.norm(reference) ** 3 / (reference @ normal)
    direct = 1.0 - lamp.falloff + lamp.falloff * np.clip(lit, 0.0, None)
    return np.asarray(direct * (1.0 - lamp.shadow * hidden))


def mirrored(lamp: Lamp, points: Array, normal: Array, eye: Array, hidden: Array) -> Array:
    """Gray levels of the lamp's mirror image ``(N,)``: Blinn's form of Phong's law; it moves with the view.

    Args:
        lamp: that is mirrored.
        points: on the surface ``(N, 3)`` [m].
        normal: of the surface ``(3,)``.
        eye: where the camera is ``(3,)`` [m].
        hidden: as for ``light``.
    """
    to_lamp, to_eye = lamp.place - points, eye - points
    half = to_lamp / np.linalg.norm(to_lamp, axis=1)[:, None] + to_eye / np.linalg.norm(to_eye, axis=1)[:, None]
    cosine = (half @ normal) / np.linalg.norm(half, axis=1)
    return np.asarray(lamp.glare * (1.0 - hidden) * np.clip(cosine, 0.0, 1.0) ** SHINE)


@njit(cache=True)
def covered(points: Array, lamp: Array, lamp_radius: float, ends: Array, radii: Array) -> Array:
    """Share of the lamp that each place does not see ``(N,)``: 0 in the light, 1 in the full shadow.

    The ray from the place to the lamp passes a capsule's axis at its nearest distance; the lamp's size makes an edge
    whose width grows with the way from what casts the shadow to the surface.

    Args:
        points: places ``(N, 3)`` [m].
        lamp: where the lamp is ``(3,)`` [m].
        lamp_radius: its radius [m].
        ends: of the capsules' axes ``(M, 2, 3)`` [m].
        radii: of the capsules ``(M,)`` [m].
    """
    share = np.zeros(points.shape[0])
    for i in range(points.shape[0]):
        x, y, z = points[i]
        d0, d1, d2 = lamp[0] - x, lamp[1] - y, lamp[2] - z
        dd = d0 * d0 + d1 * d1 + d2 * d2
        for k in range(radii.shape[0]):
            e0, e1, e2 = ends[k, 1, 0] - ends[k, 0, 0], ends[k, 1, 1] - ends[k, 0, 1], ends[k, 1, 2] - ends[k, 0, 2]
            r0, r1, r2 = x - ends[k, 0, 0], y - ends[k, 0, 1], z - ends[k, 0, 2]
            ee, de = e0 * e0 + e1 * e1 + e2 * e2, d0 * e0 + d1 * e1 + d2 * e2
            dr, er = d0 * r0 + d1 * r1 + d2 * r2, e0 * r0 + e1 * r1 + e2 * r2
            across = dd * ee - de * de
            # Nearest points of the two segments.
            u = min(max((de * er - ee * dr) / across, 0.0), 1.0) if across > 1e-12 else 0.0
            v = (de * u + er) / ee if ee > 1e-12 else 0.0
            if v < 0.0 or v > 1.0:
                v = min(max(v, 0.0), 1.0)
                u = min(max((de * v - dr) / dd, 0.0), 1.0)
            g0, g1, g2 = r0 + u * d0 - v * e0, r1 + u * d1 - v * e1, r2 + u * d2 - v * e2
            distance = np.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
            # What the lamp's disc looks like at the capsule's distance.
            edge = max(lamp_radius * u, 1e-6)
            hidden = min(max(0.5 * (radii[k] - distance) / edge + 0.5, 0.0), 1.0)
            share[i] = max(share[i], hidden)
    return share
