"""The arithmetic of path coordinates that runs several times in each cycle, compiled.

A path is given by its segments: cubics ``(K, 4, 3)`` of the position, highest power first, on even knots from 0 on,
with one straight piece more at each end; and likewise ``(K - 2, 4, 3)`` of the surface normal, without those.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.jit import jit


@jit()
def frames_at(
    cubics: Array, ups: Array, knot: float, s: Array
) -> tuple[Array, Array, Array, Array, Array]:  # pragma: no cover
    """Position, tangent, normal, up ``(m, 3)`` and curvature ``(m,)`` at arc lengths ``s (m,)``.

    Args:
        cubics: coefficients of the cubics between knots by arc length, highest power first ``(K, 4, 3)`` [m]; the first
            and the last are the straight ends.
        ups: the same for the surface normals, without the ends ``(K - 2, 4, 3)``.
        knot: spacing of the knots [m].
        s: arc lengths ``(m,)`` [m].
    """
    m, last = s.size, cubics.shape[0] - 1
    length = (last - 1) * knot
    position, tangent = np.empty((m, 3)), np.empty((m, 3))
    normal, up = np.empty((m, 3)), np.empty((m, 3))
    curvature = np.empty(m)
    velocity, bend, out = np.empty(3), np.empty(3), np.empty(3)
    for i in range(m):
        k = min(max(int(np.floor(s[i] / knot)) + 1, 0), last)
        u = s[i] - max(k - 1, 0) * knot
        inside = min(max(s[i], 0.0), length)
        j = min(int(np.floor(inside / knot)), last - 2)
        w = inside - j * knot
        for a in range(3):
            c0, c1, c2, c3 = cubics[k, 0, a], cubics[k, 1, a], cubics[k, 2, a], cubics[k, 3, a]
            position[i, a] = ((c0 * u + c1) * u + c2) * u + c3
            velocity[a] = (3.0 * c0 * u + 2.0 * c1) * u + c2
            bend[a] = 6.0 * c0 * u + 2.0 * c1
            out[a] = ((ups[j, 0, a] * w + ups[j, 1, a]) * w + ups[j, 2, a]) * w + ups[j, 3, a]
        square = velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2
        for a in range(3):
            tangent[i, a] = velocity[a] / np.sqrt(square)
        t = tangent[i]
        n0, n1, n2 = out[1] * t[2] - out[2] * t[1], out[2] * t[0] - out[0] * t[2], out[0] * t[1] - out[1] * t[0]
        size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        normal[i, 0], normal[i, 1], normal[i, 2] = n0 / size, n1 / size, n2 / size
        n = normal[i]
        up[i, 0] = t[1] * n[2] - t[2] * n[1]
        up[i, 1] = t[2] * n[0] - t[0] * n[2]
        up[i, 2] = t[0] * n[1] - t[1] * n[0]
        curvature[i] = (bend[0] * n[0] + bend[1] * n[1] + bend[2] * n[2]) / square
    return position, tangent, normal, up, curvature


@jit()
def feet_of(cubics: Array, knot: float, points: Array, first: float, end: float) -> Array:  # pragma: no cover
    """Arc lengths ``(m,)`` of the feet of ``points (m, 3)`` on the path between ``first`` and ``end``.

    The nearest of samples a knot apart, then Newton's method on (x - p(s))·p'(s) = 0; the curvature term is kept away
    from the centre of curvature.

    Args:
        cubics: coefficients of the path as for ``frames_at``.
        knot: spacing of the knots [m].
        points: ``(m, 3)`` [m].
        first: least arc length of the search [m].
        end: largest one [m].
    """
    last = cubics.shape[0] - 1
    count = max(int((end - first) / knot), 1)
    s = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        x0, x1, x2 = points[i, 0], points[i, 1], points[i, 2]
        best, s_best = np.inf, first
        for j in range(count + 1):
            place = first + j * knot
            k = min(max(int(np.floor(place / knot)) + 1, 0), last)
            u = place - max(k - 1, 0) * knot
            c = cubics[k]
            d0 = x0 - (((c[0, 0] * u + c[1, 0]) * u + c[2, 0]) * u + c[3, 0])
            d1 = x1 - (((c[0, 1] * u + c[1, 1]) * u + c[2, 1]) * u + c[3, 1])
            d2 = x2 - (((c[0, 2] * u + c[1, 2]) * u + c[2, 2]) * u + c[3, 2])
            square = d0 * d0 + d1 * d1 + d2 * d2
            if square < best:
                best, s_best = square, place
        for _ in range(4):
            k = min(max(int(np.floor(s_best / knot)) + 1, 0), last)
            u = s_best - max(k - 1, 0) * knot
            miss, slope = 0.0, 0.0
            for a in range(3):
                c0, c1, c2 = cubics[k, 0, a], cubics[k, 1, a], cubics[k, 2, a]
                d = points[i, a] - (((c0 * u + c1) * u + c2) * u + cubics[k, 3, a])
                v = (3.0 * c0 * u + 2.0 * c1) * u + c2
                miss += d * v
                slope += v * v - d * (6.0 * c0 * u + 2.0 * c1)
            s_best += miss / max(slope, 0.3)
        s[i] = s_best
    return s


class Rigid(NamedTuple):
    """A rigid motion of a path about ``centre (3,)``, with ``axes`` as rows ``(3, 3)``.

    ``size`` is 3 for a motion in the plane of the first two axes, 6 for any.
    """

    centre: Array
    axes: Array
    size: int


class Splines(NamedTuple):
    """Cubic B-splines: first knot [m], spacing of the knots [m] and how many there are."""

    start: float
    spacing: float
    number: int


@jit()
def deviation_basis(position: Array, directions: tuple[Array, Array], wanted: int, turning: Rigid, s: Array,
                    splines: Splines) -> Array:  # pragma: no cover
    """Deviation per state, ``(m, wanted, rigid + wanted · count)``: rigid motion and cubic B-splines.

    Args:
        position: points of the path ``(m, 3)``.
        directions: normals and ups there, ``(m, 3)`` each; the first ``wanted`` are used.
        wanted: number of directions.
        turning: the rigid motion.
        s: arc lengths ``(m,)``.
        splines: of the change of shape.
    """
    m, (centre, axes, rigid), (start, spacing, count) = s.size, turning, splines
    H = np.zeros((m, wanted, rigid + wanted * count))
    for i in range(m):
        u = min(max((s[i] - start) / spacing, 0.0), count - 3 - 1e-9)
        j = int(u)
        u -= j
        weights = (
            (1.0 - u) ** 3 / 6.0,
            (3.0 * u**3 - 6.0 * u**2 + 4.0) / 6.0,
            (-3.0 * u**3 + 3.0 * u**2 + 3.0 * u + 1.0) / 6.0,
            u**3 / 6.0,
        )
        for d in range(wanted):
            g = directions[d][i]
            for b in range(4):
                H[i, d, rigid + d * count + j + b] = weights[b]
            l0, l1, l2 = position[i, 0] - centre[0], position[i, 1] - centre[1], position[i, 2] - centre[2]
            # g·(τ + φ × lever) with τ and φ along the axes, and g·(e × lever) = e·(lever × g).
            t0, t1, t2 = l1 * g[2] - l2 * g[1], l2 * g[0] - l0 * g[2], l0 * g[1] - l1 * g[0]
            for a in range(3):
                move = axes[a, 0] * g[0] + axes[a, 1] * g[1] + axes[a, 2] * g[2]
                turn = axes[a, 0] * t0 + axes[a, 1] * t1 + axes[a, 2] * t2
                if rigid == 6:
                    H[i, d, a], H[i, d, 3 + a] = move, turn
                elif a < 2:
                    H[i, d, a] = move
                else:
                    H[i, d, 2] = turn
    return H


@jit()
def displaced_frames(
    position: Array, tangent: Array, normal: Array, up: Array, curvature: Array, deviation: Array, slope: Array
) -> tuple[Array, Array, Array]:  # pragma: no cover
    """Points, unit tangents and unit normals out of the surface of the path p + d n + h u, ``(m, 3)`` each.

    Its derivative by arc length is (1 - κ d) t + d' n + h' u.

    Args:
        position: p ``(m, 3)`` [m].
        tangent: t ``(m, 3)``.
        normal: n ``(m, 3)``.
        up: u ``(m, 3)``.
        curvature: κ ``(m,)`` [1/m].
        deviation: d, and h where heights are known too ``(m, 1 or 2)`` [m].
        slope: their derivatives by arc length ``(m, 1 or 2)``.
    """
    m, high = position.shape[0], deviation.shape[1] > 1
    points, ahead, out = np.empty((m, 3)), np.empty((m, 3)), up.copy()
    for i in range(m):
        d, h = deviation[i, 0], deviation[i, 1] if high else 0.0
        rise = slope[i, 1] if high else 0.0
        square = along = 0.0
        for a in range(3):
            points[i, a] = position[i, a] + d * normal[i, a] + h * up[i, a]
            ahead[i, a] = (1.0 - curvature[i] * d) * tangent[i, a] + slope[i, 0] * normal[i, a] + rise * up[i, a]
            square += ahead[i, a] ** 2
        for a in range(3):
            ahead[i, a] /= np.sqrt(square)
            along += up[i, a] * ahead[i, a]
        if high:
            square = 0.0
            for a in range(3):
                out[i, a] -= along * ahead[i, a]
                square += out[i, a] ** 2
            for a in range(3):
                out[i, a] /= np.sqrt(square)
    return points, ahead, out


@jit(error_model="numpy")
def sensor_errors(
    normal: Array, up: Array, ray: Array, lever: Array, velocity: Array, rate: Array
) -> tuple[Array, Array, Array]:  # pragma: no cover
    """Displacements of seen points along ``normal`` by a camera's errors and by a wrong height, ``(m,)`` each.

    Of a camera turned about the surface normal [m/rad], n·(u × r); of a time stamp [m/s], n·(v + ω × l); and by how
    much a ray slants across the path, (r·n)/(r·u).

    Args:
        normal: n, across the path ``(m, 3)``.
        up: u, out of the surface ``(m, 3)``.
        ray: r, from the camera to the points ``(m, 3)`` [m].
        lever: l, from the TCP to the points ``(m, 3)`` [m].
        velocity: v, of the TCP ``(3,)`` [m/s].
        rate: ω, of the tool ``(3,)`` [rad/s].
    """
    m = normal.shape[0]
    turned, moved, slant = np.empty(m), np.empty(m), np.empty(m)
    for i in range(m):
        n, u, r, k = normal[i], up[i], ray[i], lever[i]
        turned[i] = (n[0] * (u[1] * r[2] - u[2] * r[1]) + n[1] * (u[2] * r[0] - u[0] * r[2])
                     + n[2] * (u[0] * r[1] - u[1] * r[0]))
        moved[i] = (n[0] * (velocity[0] + rate[1] * k[2] - rate[2] * k[1])
                    + n[1] * (velocity[1] + rate[2] * k[0] - rate[0] * k[2])
                    + n[2] * (velocity[2] + rate[0] * k[1] - rate[1] * k[0]))
        slant[i] = (r[0] * n[0] + r[1] * n[1] + r[2] * n[2]) / (r[0] * u[0] + r[1] * u[1] + r[2] * u[2])
    return turned, moved, slant


# Products of a few 3-vectors at a time, without the overhead of NumPy's general ones, for the real-time part.

def dot(a: Array, b: Array) -> Array:
    """Scalar products over the last axis: ``(…, 3)`` and ``(…, 3)`` to ``(…)``."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def unit(vectors: Array) -> Array:
    """Vectors ``(…, 3)`` scaled to length 1."""
    return np.asarray(vectors / np.sqrt(dot(vectors, vectors))[..., None])


def exp(w: Array) -> Array:
    """Rotation matrices ``(…, 3, 3)`` of rotation vectors ``(…, 3)``: Rodrigues' formula for many at once."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = np.zeros((*np.shape(w)[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    # sin(x)/x and (1 - cos x)/x², both well behaved at 0.
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * K + second * (K @ K))
