"""What of the tool the camera has in the edge of its picture: the tip that follows the line, and a hose beside it."""

from __future__ import annotations

import numpy as np

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
