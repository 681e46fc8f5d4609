"""A distorted picture from an undistorted one: where each pixel's samples lie in it, and their mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from sensing.camera.camera_model import undistort


@jit()
def add_samples(
    total: Array, image: NDArray[np.uint8], x: Array, y: Array, scale: float, column0: float, row0: float, weight: float
) -> None:
    """Adds the picture, sampled bilinearly at normalised coordinates, averaged over each pixel's samples, to ``total``.

    ``x``, ``y`` have shape ``(height, width, n)``: n samples per pixel.

    Args:
        total: sum so far ``(height, width)`` [gray], changed.
        image: undistorted picture ``(rows, columns, channels)`` [gray].
        x: normalised coordinates to the right ``(height, width, n)``, n samples per pixel.
        y: the same downwards.
        scale: focal length of the undistorted picture [px].
        column0: column of its principal point [px].
        row0: row of its principal point [px].
        weight: of this picture in the sum.
    """
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
    """Where rays (x, y, 1) in a camera's frame meet a plane ``(N, 3)`` [m].

    Args:
        x: of the rays, to the right ``(N,)``.
        y: downwards ``(N,)``.
        R: the camera's rotation in the base frame ``(3, 3)``.
        c: where it is ``(3,)`` [m].
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
