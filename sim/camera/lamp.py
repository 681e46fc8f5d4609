"""Effects of a lamp on the picture of a surface: fading with distance, mirror image, and the arm's shadow.

TinyRenderer knows one light from infinity and shifts gray levels with it. Here the lamp has a place, and each pixel's
point on the surface is lit from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from ideal_robot.robots.robot import TOOL_TIP, Robot
from ideal_robot.robots.urdf import without_meshes

# The part of the tool at the edge of the camera's picture: the tip that follows the line, and a hose beside it.

TOOL_COLOUR = [0.2, 0.2, 0.2, 1.0]
"""Dark, as rubber and burnished steel are."""
SIDES = 12
"""Corners of the circles that tool and hose are drawn with."""
TOOL_RADIUS = 0.006
"""Of the tool's shaft [m]."""
TIP = ((0.0, 0.001), (0.012, 0.004), (0.05, TOOL_RADIUS), (0.14, TOOL_RADIUS))
"""Distance behind the TCP along the approach axis and radius there [m]."""
HOSE = np.array([[-0.012, 0.014, -0.02], [-0.004, 0.05, -0.05], [0.004, 0.085, -0.09], [0.0, 0.1, -0.14]])
"""Middle of the hose in the tool frame [m]: it leaves the tip sideways and goes up out of the picture."""
HOSE_RADIUS = 0.007
"""Of the hose [m]."""
NEAREST = 0.005
"""Depth from which on a camera may see the mesh [m], nearer than any renderer begins."""


def tool_mesh(length: float = 0.0) -> list[str]:
    """Lines of an .obj file in the tool frame, z along the approach axis.

    ``length`` is that from the flange to the TCP [m]; its visible part is never shorter than the default shaft.
    """
    shaft = (*TIP, (length, TOOL_RADIUS)) if length > TIP[-1][0] else TIP
    tip = np.array([[0.0, 0.0, -behind] for behind, _ in shaft])
    tubes = [(tip, np.array([radius for _, radius in shaft])), (HOSE, np.full(len(HOSE), HOSE_RADIUS))]
    vertices: list[str] = []
    normals: list[str] = []
    faces: list[str] = []
    for middle, radius in tubes:
        rings, outwards = _rings(middle, radius)
        first = len(vertices) + 1
        vertices += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in rings.reshape(-1, 3)]
        normals += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in outwards.reshape(-1, 3)]
        for k in range(len(middle) - 1):
            for i in range(SIDES):
                a, b = first + k * SIDES + i, first + k * SIDES + (i + 1) % SIDES
                c, d = b + SIDES, a + SIDES
                faces += [f"f {a}//{a} {b}//{b} {c}//{c}", f"f {a}//{a} {c}//{c} {d}//{d}"]
    return vertices + normals + faces


def triangles(mesh: Sequence[str]) -> tuple[Array, NDArray[np.int_]]:
    """Places ``(N, 3)`` [m] and corners of the triangles ``(M, 3)`` from the lines of ``tool_mesh``."""
    lines = [line.split() for line in mesh]
    return (np.array([line[1:] for line in lines if line[0] == "v"], dtype=float),
            np.array([[int(corner.split("/")[0]) - 1 for corner in line[1:]] for line in lines if line[0] == "f"]))


def outline(mesh: Sequence[str], T_camera_tool: pin.SE3) -> Array:
    """Boxes about what a camera sees of each triangle: least x, y and largest x, y as tangents ``(4, triangles)``.

    Triangles of ``tool_mesh`` that are behind the camera are left out.
    """
    places, corners = triangles(mesh)
    a = (places @ T_camera_tool.rotation.T + T_camera_tool.translation)[corners]
    b = np.roll(a, -1, axis=1)
    # A triangle is clipped at the near plane: new corners lie on the sides that cross it.
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (NEAREST - a[..., 2]) / (b[..., 2] - a[..., 2])
        crossing = np.where(((share > 0.0) & (share < 1.0))[..., None], a + share[..., None] * (b - a), np.nan)
    visible = np.concatenate([np.where(a[..., 2:] >= NEAREST, a, np.nan), crossing], axis=1)
    visible = visible[~np.isnan(visible).all(axis=(1, 2))]
    tangents = visible[..., :2] / visible[..., 2:]
    return np.concatenate([np.nanmin(tangents, axis=1), np.nanmax(tangents, axis=1)], axis=1).T.copy()


def _rings(middle: Array, radius: Array) -> tuple[Array, Array]:
    """Circles around a curve and their outward normals, ``(K, SIDES, 3)`` each."""
    tangents = np.gradient(middle, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    aside = np.cross(tangents, [1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    other = np.cross(tangents, aside)
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    outwards = np.cos(angle)[None, :, None] * aside[:, None] + np.sin(angle)[None, :, None] * other[:, None]
    return middle[:, None] + radius[:, None, None] * outwards, outwards


SHINE = 240.0
"""How sharp the surface mirrors: exponent of the cosine between its normal and the middle of eye and lamp."""
GROUP = 32
"""Neighbouring places for which it is decided together what cannot stand in their light."""


@dataclass(frozen=True)
class Lamp:
    """A lamp above the surface.

    Attributes:
        place: position in the base frame ``(3,)`` [m].
        radius: of the luminous disc [m]; it gives the shadow its soft edge.
        falloff: share of the light from this lamp, which fades with distance; the rest is room light.
        shadow: share of the light that is missing in the arm's shadow.
        glare: gray levels added where the lamp is mirrored.
    """

    place: Array
    radius: float = 0.03
    falloff: float = 0.6
    shadow: float = 0.45
    glare: float = 60.0


class ArmShape:
    """The arm's links as capsules, for its shadow: boxes and cylinders of its URDF, or rods between the joints.

    A tool that a scene adds is one more capsule.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._data = robot.pinocchio, robot.pinocchio.createData()
        text = without_meshes(robot.description)
        capsules: list[tuple[int, Array, Array, float]] = []
        for item in pin.buildGeomFromUrdfString(self._model, text, pin.GeometryType.VISUAL).geometryObjects:
            half = half_sizes(item.geometry)
            if half is None or item.parentJoint == 0:
                continue
            axis = int(np.argmax(half))
            radius = float(np.sort(half)[1])
            end = np.zeros(3)
            end[axis] = max(half[axis] - radius, 0.0)
            capsules.append((int(item.parentJoint), item.placement.act(-end), item.placement.act(end), radius))
        if not capsules:
            placed = self._model.jointPlacements
            capsules = [(int(self._model.parents[joint]), np.zeros(3), placed[joint].translation, 0.05)
                        for joint in range(2, self._model.njoints)]
        tool = self._model.frames[robot.tool_id]
        if tool.name == TOOL_TIP:
            flange = self._model.frames[tool.parentFrame].placement
            capsules.append((int(tool.parentJoint), flange.translation, tool.placement.translation, TOOL_RADIUS))
        self._parents = np.array([parent for parent, *_ in capsules])
        self._ends = np.array([[a, b] for _, a, b, _ in capsules])
        self.radii = np.array([radius for *_, radius in capsules])

    def at(self, q: Array) -> Array:
        """Ends of the capsules' axes in the base frame ``(M, 2, 3)`` [m] at arm angles ``(n,)`` [rad]."""
        pin.forwardKinematics(self._model, self._data, np.asarray(q, dtype=float))
        rotation, place = joint_places(self._data)
        return np.asarray(self._ends @ rotation[self._parents].transpose(0, 2, 1) + place[self._parents, None])


def joint_places(data: pin.Data) -> tuple[Array, Array]:
    """Places of Pinocchio's joints in the base frame: rotations ``(joints, 3, 3)``, positions ``(joints, 3)`` [m]."""
    joints = list(data.oMi)
    return np.array([joint.rotation for joint in joints]), np.array([joint.translation for joint in joints])


def half_sizes(shape: object) -> Array | None:
    """Half of the sides of the box ``(3,)`` [m] about a box or a cylinder; None for other shapes."""
    if hasattr(shape, "halfSide"):
        return np.array(shape.halfSide, dtype=float)
    if hasattr(shape, "halfLength") and hasattr(shape, "radius"):
        return np.array([shape.radius, shape.radius, shape.halfLength], dtype=float)
    return None


def light(lamp: Lamp, points: Array, normal: Array, centre: Array, hidden: Array) -> Array:
    """Brightness of points of the surface ``(N,)``; 1 at ``centre`` if nothing shades it.

    Lambert's law with the lamp's distance r and the angle β from the normal: cos β / r², weighted by ``falloff``.

    Args:
        lamp: the lamp.
        points: on the surface ``(N, 3)`` [m].
        normal: of the surface ``(3,)``.
        centre: position at which the light is measured ``(3,)`` [m].
        hidden: share of the lamp that each place does not see ``(N,)``, as from ``covered``.
    """
    reference = lamp.place - centre
    full = float(np.linalg.norm(reference) ** 3 / (reference @ normal))
    return np.asarray(_lambert(points, lamp.place, normal, full, lamp.falloff, lamp.shadow, hidden))


def mirrored(lamp: Lamp, points: Array, normal: Array, eye: Array, hidden: Array) -> Array:
    """Gray levels of the lamp's mirror image ``(N,)``: Blinn's form of Phong's law; it moves with the view.

    Args:
        lamp: the lamp that is mirrored.
        points: on the surface ``(N, 3)`` [m].
        normal: of the surface ``(3,)``.
        eye: position of the camera ``(3,)`` [m].
        hidden: as for ``light``.
    """
    return np.asarray(_blinn(points, lamp.place, normal, eye, lamp.glare, hidden))


@jit(error_model="numpy")
def _lambert(points: Array, lamp: Array, normal: Array, full: float, falloff: float, shadow: float, hidden: Array
             ) -> Array:
    lit = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        x, y, z = lamp[0] - points[i, 0], lamp[1] - points[i, 1], lamp[2] - points[i, 2]
        r = np.sqrt(x * x + y * y + z * z)
        direct = (x * normal[0] + y * normal[1] + z * normal[2]) / (r * r * r) * full
        lit[i] = (1.0 - falloff + falloff * max(direct, 0.0)) * (1.0 - shadow * hidden[i])
    return lit


@jit(error_model="numpy")
def _blinn(points: Array, lamp: Array, normal: Array, eye: Array, glare: float, hidden: Array) -> Array:
    gray = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        a0, a1, a2 = lamp[0] - points[i, 0], lamp[1] - points[i, 1], lamp[2] - points[i, 2]
        b0, b1, b2 = eye[0] - points[i, 0], eye[1] - points[i, 1], eye[2] - points[i, 2]
        a, b = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2), np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
        h0, h1, h2 = a0 / a + b0 / b, a1 / a + b1 / b, a2 / a + b2 / b
        cosine = (h0 * normal[0] + h1 * normal[1] + h2 * normal[2]) / np.sqrt(h0 * h0 + h1 * h1 + h2 * h2)
        gray[i] = glare * (1.0 - hidden[i]) * min(max(cosine, 0.0), 1.0) ** SHINE
    return gray


@jit()
def covered(points: Array, lamp: Array, lamp_radius: float, ends: Array, radii: Array) -> Array:
    """Share of the lamp that is hidden from each point ``(N,)``: 0 in the light, 1 in the full shadow.

    The ray from the place to the lamp passes a capsule's axis at its nearest distance; the lamp's size makes an edge
    whose width grows with the distance from the capsule to the surface. Capsules far from all rays of a group of points
    are skipped for the whole group.

    Args:
        points: places ``(N, 3)`` [m].
        lamp: position of the lamp ``(3,)`` [m].
        lamp_radius: its radius [m].
        ends: of the capsules' axes ``(M, 2, 3)`` [m].
        radii: of the capsules ``(M,)`` [m].
    """
    share = np.zeros(points.shape[0])
    for first in range(0, points.shape[0], GROUP):
        last = min(first + GROUP, points.shape[0])
        # The ball about the group: no ray from it to the lamp is farther from the middle one than its radius.
        x, y, z = 0.0, 0.0, 0.0
        for i in range(first, last):
            x, y, z = x + points[i, 0], y + points[i, 1], z + points[i, 2]
        x, y, z = x / (last - first), y / (last - first), z / (last - first)
        ball = 0.0
        for i in range(first, last):
            ball = max(ball, (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2 + (points[i, 2] - z) ** 2)
        ball = np.sqrt(ball) + 1e-9
        for k in range(radii.shape[0]):
            distance, _ = _passing(x, y, z, lamp, ends[k])
            if distance > radii[k] + max(lamp_radius, 1e-6) + ball:
                continue
            for i in range(first, last):
                distance, u = _passing(points[i, 0], points[i, 1], points[i, 2], lamp, ends[k])
                # Radius of the lamp's disc, projected to the capsule's distance.
                edge = max(lamp_radius * u, 1e-6)
                hidden = min(max(0.5 * (radii[k] - distance) / edge + 0.5, 0.0), 1.0)
                share[i] = max(share[i], hidden)
    return share


@jit(inline="always")
def _passing(x: float, y: float, z: float, lamp: Array, ends: Array) -> tuple[float, float]:
    """Distance of the ray from a place to the lamp from a capsule's axis [m], and the share of the ray before it."""
    d0, d1, d2 = lamp[0] - x, lamp[1] - y, lamp[2] - z
    e0, e1, e2 = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1], ends[1, 2] - ends[0, 2]
    r0, r1, r2 = x - ends[0, 0], y - ends[0, 1], z - ends[0, 2]
    dd = d0 * d0 + d1 * d1 + d2 * d2
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
    return np.sqrt(g0 * g0 + g1 * g1 + g2 * g2), u
