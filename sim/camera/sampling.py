"""Gray values of a plane along the rays of a camera with a lens."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from sensing.camera.camera_model import undistort
from sim.camera.surface import Texture

# A distorted picture from an undistorted one: where each pixel's samples lie in it, and their mean.

@jit()
def add_samples(
    total: Array, image: NDArray[np.uint8], x: Array, y: Array, at: tuple[float, float, float], weight: float
) -> None:
    """Adds to ``total`` a picture sampled bilinearly at normalised coordinates, averaged per pixel.

    Args:
        total: sum so far ``(height, width)`` [gray], changed.
        image: undistorted picture ``(rows, columns, channels)`` [gray].
        x: normalised coordinates to the right ``(height, width, n)``, n samples per pixel.
        y: the same downwards.
        at: focal length of the undistorted picture, column and row of its principal point [px].
        weight: of this picture in the sum.
    """
    scale, column0, row0 = at
    rows, columns = image.shape[0], image.shape[1]
    height, width, n = x.shape
    for i in range(height):
        for j in range(width):
            value = 0.0
            for m in range(n):
                c = min(max(x[i, j, m] * scale + column0, 0.0), columns - 1.000001)
                r = min(max(y[i, j, m] * scale + row0, 0.0), rows - 1.000001)
                ci, ri = int(c), int(r)
                a, b = c - ci, r - ri
                value += (1.0 - b) * ((1.0 - a) * image[ri, ci, 0] + a * image[ri, ci + 1, 0]) + b * (
                    (1.0 - a) * image[ri + 1, ci, 0] + a * image[ri + 1, ci + 1, 0]
                )
            total[i, j] += weight * value / n


@jit()
def sample_rays(u0: int, v0: int, height: int, width: int, n: int, K: Array, k: Array) -> tuple[Array, Array]:
    """Undistorted normalised coordinates ``(height, width, n²)`` of ``n`` × ``n`` samples spread over each pixel.

    Args:
        u0: first column [px].
        v0: first row [px].
        height: rows [px].
        width: columns [px].
        n: samples a pixel in each direction.
        K: camera matrix ``(3, 3)`` [px].
        k: distortion k1, k2, p1, p2, k3 ``(5,)``.
    """
    x = np.empty((height, width, n * n))
    y = np.empty((height, width, n * n))
    for i in range(height):
        for j in range(width):
            for a in range(n):
                for b in range(n):
                    y_d = (v0 + i + (a + 0.5) / n - 0.5 - K[1, 2]) / K[1, 1]
                    x_d = (u0 + j + (b + 0.5) / n - 0.5 - K[0, 2] - K[0, 1] * y_d) / K[0, 0]
                    x[i, j, a * n + b], y[i, j, a * n + b] = undistort(x_d, y_d, k)
    return x, y


@jit(error_model="numpy")
def on_plane(x: Array, y: Array, R: Array, c: Array, up: Array, place: Array) -> Array:
    """Points ``(N, 3)`` [m] where rays (x, y, 1) in a camera's frame meet a plane.

    Args:
        x: of the rays, to the right ``(N,)``.
        y: downwards ``(N,)``.
        R: the camera's rotation in the base frame ``(3, 3)``.
        c: its position ``(3,)`` [m].
        up: the plane's normal ``(3,)``.
        place: one of the plane's points ``(3,)`` [m].
    """
    points = np.empty((x.shape[0], 3))
    above = (place[0] - c[0]) * up[0] + (place[1] - c[1]) * up[1] + (place[2] - c[2]) * up[2]
    for i in range(x.shape[0]):
        d0 = R[0, 0] * x[i] + R[0, 1] * y[i] + R[0, 2]
        d1 = R[1, 0] * x[i] + R[1, 1] * y[i] + R[1, 2]
        d2 = R[2, 0] * x[i] + R[2, 1] * y[i] + R[2, 2]
        depth = above / (d0 * up[0] + d1 * up[1] + d2 * up[2])
        points[i, 0], points[i, 1], points[i, 2] = c[0] + depth * d0, c[1] + depth * d1, c[2] + depth * d2
    return points


@jit()
def extent(x: Array, y: Array) -> tuple[float, float, float, float]:
    """Least x and y, largest x and y of arrays that are not empty."""
    return x.min(), y.min(), x.max(), y.max()


def displacements(n: int) -> Array:
    """Displacements ``(n, 2)`` in samples, evenly spread over one sample: a rotated lattice."""
    i = np.arange(n)
    return np.column_stack([(i + 0.5) / n, (i * 0.618034 + 0.5) % 1.0]) - 0.5


# Gray values of a drawn plane, sampled where the rays of the pixels meet it.

OUTSIDE = 255.0
"""Gray value of what is beyond the drawn surface."""


def texel_map(T_plane_camera: pin.SE3, texture: Texture) -> Array:
    """Homogeneous map ``(3, 3)`` of a ray (x, y, 1) in the camera's frame to column and row in the texture [texels].

    With R, c the camera's pose in the plane's frame, the ray d meets z = 0 at (c_x - c_z (R_x d)/(R_z d), …); as a
    homogeneous vector (c_z R_x d - c_x R_z d, c_z R_y d - c_y R_z d, -R_z d), whose last entry is positive where a
    camera above the plane looks at it. Texel centres lie at whole numbers.
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
    """Mean gray value of every pixel of the windows over samples and views, the windows one after the other.

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
    pixel = 0
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
                gray[pixel] = total / (n * views)
                pixel += 1
    return gray
