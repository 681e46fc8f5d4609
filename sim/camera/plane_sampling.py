"""Gray values of a drawn plane, sampled where the rays of the pixels meet it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from sim.camera.texture import Texture

OUTSIDE = 255.0
"""Gray value of what is beyond the drawn surface."""


def texel_map(T_plane_camera: pin.SE3, texture: Texture) -> Array:
    """Homogeneous map ``(3, 3)`` of a ray (x, y, 1) in the camera's frame to column and row in the texture [texels].

    With R, c the camera's pose in the plane's frame, the ray d meets z = 0 at (c_x - c_z (R_x d)/(R_z d), …); as a
    homogeneous vector (c_z R_x d - c_x R_z d, c_z R_y d - c_y R_z d, -R_z d), whose last entry is positive where a
    camera above the plane looks at it. Texel centres lie at whole numbers.

    Args:
        T_plane_camera: pose of the camera in the plane's frame.
        texture: of the plane.
    """
    R, c = T_plane_camera.rotation, T_plane_camera.translation
    on_plane = np.array([c[2] * R[0] - c[0] * R[2], c[2] * R[1] - c[1] * R[2], -R[2]])
    per = 1.0 / texture.resolution
    to_texels = np.array([[per, 0.0, -per * texture.x_min - 0.5], [0.0, -per, per * texture.y_max - 0.5],
                          [0.0, 0.0, 1.0]])
    return np.asarray(to_texels @ on_plane)


@jit()
def sample_plane(image: NDArray[np.uint8], maps: Array, rays: Array, u0: int, v0: int, windows: NDArray[np.int64]
                 ) -> Array:
    """Mean gray value of every pixel of the windows over its samples and the views, one window after the other.

    Between the centres of texels the gray value is linear in both directions.

    Args:
        image: gray values of the texture ``(rows, columns)``.
        maps: of rays to texels, one per view ``(views, 3, 3)``.
        rays: x, y of the samples' rays (x, y, 1) ``(height, width, n, 2)``, n samples a pixel.
        u0: column of the first pixel of ``rays`` [px].
        v0: row of the first pixel of ``rays`` [px].
        windows: first column and row, columns and rows ``(m, 4)`` [px].
    """
    rows, columns = image.shape
    views, n = maps.shape[0], rays.shape[2]
    gray = np.empty(int(np.sum(windows[:, 2] * windows[:, 3])))
    at = 0
    for i in range(windows.shape[0]):
        for v in range(windows[i, 1] - v0, windows[i, 1] - v0 + windows[i, 3]):
            for u in range(windows[i, 0] - u0, windows[i, 0] - u0 + windows[i, 2]):
                total = 0.0
                for m in range(n):
                    x, y = rays[v, u, m, 0], rays[v, u, m, 1]
                    for k in range(views):
                        H = maps[k]
                        value = OUTSIDE
                        w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
                        if w > 0.0:
                            c = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w
                            r = (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
                            if -0.5 <= c < columns - 0.5 and -0.5 <= r < rows - 0.5:
                                c, r = min(max(c, 0.0), columns - 1.0), min(max(r, 0.0), rows - 1.0)
                                j, q = min(int(c), columns - 2), min(int(r), rows - 2)
                                a, b = c - j, r - q
                                value = ((1.0 - b) * ((1.0 - a) * image[q, j] + a * image[q, j + 1])
                                         + b * ((1.0 - a) * image[q + 1, j] + a * image[q + 1, j + 1]))
                        total += value
                gray[at] = total / (n * views)
                at += 1
    return gray
