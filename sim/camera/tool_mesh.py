"""What of the tool the camera has in the edge of its picture: the tip that follows the line, and a hose beside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array

TOOL_COLOUR = [0.2, 0.2, 0.2, 1.0]
"""Dark, as rubber and burnished steel are."""
SIDES = 12
TOOL_RADIUS = 0.006
"""Of the tool's shaft [m]."""
TIP = ((0.0, 0.001), (0.012, 0.004), (0.05, TOOL_RADIUS), (0.14, TOOL_RADIUS))
"""Distance behind the TCP along the approach axis and radius there [m]."""
HOSE = np.array([[-0.012, 0.014, -0.02], [-0.004, 0.05, -0.05], [0.004, 0.085, -0.09], [0.0, 0.1, -0.14]])
"""Middle of the hose in the tool frame [m]: it leaves the tip sideways and goes up out of the picture."""
HOSE_RADIUS = 0.007
NEAREST = 0.005
"""Depth from which on a camera may see the mesh [m], nearer than any renderer begins."""


def tool_mesh(length: float = 0.0) -> list[str]:
    """Lines of an .obj file in the tool frame, z along the approach axis.

    Args:
        length: of the tool from the flange to the TCP [m]; what is seen of it is never shorter than the usual shaft.
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


def outline(mesh: Sequence[str], T_camera_tool: pin.SE3) -> Array:
    """Boxes about what a camera sees of each triangle: least x, y and largest x, y as tangents ``(4, triangles)``.

    Triangles behind the camera are left out.

    Args:
        mesh: lines of its .obj file, from ``tool_mesh``.
        T_camera_tool: pose of the tool frame in the camera's.
    """
    lines = [line.split() for line in mesh]
    places = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    corners = np.array([[int(corner.split("/")[0]) - 1 for corner in line[1:]] for line in lines if line[0] == "f"])
    a = (places @ T_camera_tool.rotation.T + T_camera_tool.translation)[corners]
    b = np.roll(a, -1, axis=1)
    # What is left of a triangle before the camera has its corners on the sides, where they begin or come near enough.
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (NEAREST - a[..., 2]) / (b[..., 2] - a[..., 2])
        crossing = np.where(((share > 0.0) & (share < 1.0))[..., None], a + share[..., None] * (b - a), np.nan)
    seen = np.concatenate([np.where(a[..., 2:] >= NEAREST, a, np.nan), crossing], axis=1)
    seen = seen[~np.isnan(seen).all(axis=(1, 2))]
    tangents = seen[..., :2] / seen[..., 2:]
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
