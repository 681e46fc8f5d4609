"""Finds a line's cross-section in one small gray window: edge pairs first, then a least-squares fit of each.

Along the window's scan direction u the gray values of row r are modelled as

    g(u, r) = b + m (u - u_r) - c/2 [erf((u - u_r + w/2) / (√2 σ)) - erf((u - u_r - w/2) / (√2 σ))],  u_r = u_0 + h r

a box of width w and depth c, blurred by σ, on a sloping background; h is the line's known slant, r counts from the
middle row. All pixels enter the fit as they are, nothing is interpolated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.estimate.cholesky import factor, solve
from ideal_robot.jit import jit

MAX_EDGES, MAX_CANDIDATES = 8, 4  # per window: four lines side by side fill it
SQRT2, SQRT_2PI = math.sqrt(2.0), math.sqrt(2.0 * math.pi)  # of the normal distribution


class Look(NamedTuple):
    """Appearance of the line and accepted cross-sections: ``DetectionSettings`` as compiled functions take it.

    Attributes:
        line_width, blur, min_contrast, width_tolerance, min_quality, smoothness, noise: see ``DetectionSettings``.
        polarity: 1 for a dark line, -1 for a bright one.
    """

    line_width: float
    blur: float
    polarity: float
    min_contrast: float
    width_tolerance: float
    min_quality: float
    smoothness: float
    noise: float


@jit()
def _normal_equations(patch: NDArray[np.uint8], scan: tuple[float, float, float, float, float],
                      box: tuple[float, float, float, float, float], A: Array, g: Array) -> tuple[float, int]:
    """Sets ``A (5, 5)``, ``g (5,)`` for b, m, c, u_0, w; sum of the squared residuals, and how many pixels count.

    ``scan``: start, slant, reach, blur [px] and polarity; ``box``: u_0, w [px], c, b [gray], m [gray/px] so far.
    """
    start, slant, reach, blur, polarity = scan
    u0, w, c, b, m = box
    rows, columns = patch.shape
    middle = 0.5 * (rows - 1)
    J = np.empty(5)
    A[:] = 0.0
    g[:] = 0.0
    residual, n = 0.0, 0
    for r in range(rows):
        centre = u0 + slant * (r - middle)
        for j in range(max(0, math.ceil(start + slant * (r - middle) - reach)),
                       min(columns, math.floor(start + slant * (r - middle) + reach) + 1)):
            d = j - centre
            left, right = (d + 0.5 * w) / blur, (d - 0.5 * w) / blur
            inside = 0.5 * (math.erf(left / SQRT2) - math.erf(right / SQRT2))
            pl = math.exp(-0.5 * left * left) / (SQRT_2PI * blur)
            pr = math.exp(-0.5 * right * right) / (SQRT_2PI * blur)
            e = polarity * patch[r, j] - (b + m * d - c * inside)
            J[0], J[1], J[2], J[3], J[4] = 1.0, d, -inside, c * (pl - pr) - m, -0.5 * c * (pl + pr)
            residual += e * e
            n += 1
            for p in range(5):
                g[p] += J[p] * e
                for q in range(5):
                    A[p, q] += J[p] * J[q]
    return residual, n


@jit()
def _fit_section(patch: NDArray[np.uint8], start: float, slant: float, width: float, blur: float,
                polarity: float) -> tuple[float, float, float, float, float]:
    """Fits the cross-section near ``start`` [px from the window's first pixel] of the middle row, as ``find_sections``.

    u_0 [px], w [px], c [gray], root mean square residual [gray], standard deviation of u_0 per unit of residual
    [px/gray]; NaN where the fit failed.
    """
    reach = 0.5 * width + 2.5 * blur + 2.0
    u0, w, c = start, width, 0.0
    b, m = 0.0, 0.0
    failed = (np.nan, np.nan, np.nan, np.nan, np.nan)
    A, g = np.empty((5, 5)), np.empty(5)
    residual, n = 0.0, 0
    for iteration in range(8):
        residual, n = _normal_equations(patch, (start, slant, reach, blur, polarity), (u0, w, c, b, m), A, g)
        if n < 8:
            return failed
        # The first pass has no depth yet, so centre and width do not show: it is linear in the other three.
        if iteration == 0:
            for p in (3, 4):
                A[p, p] += 1e6
        if not factor(A):
            return failed
        solve(A, g)
        b, m, c = b + g[0], m + g[1], c + g[2]
        u0 += min(max(g[3], -1.0), 1.0)
        w = max(w + min(max(g[4], -1.0), 1.0), 0.3)
        if abs(u0 - start) > 0.5 * width + 1.0:
            return failed
        if iteration > 1 and abs(g[3]) < 2e-3 and abs(g[4]) < 1e-2:
            break
    g[:] = 0.0
    g[3] = 1.0
    solve(A, g)
    return u0, w, c, math.sqrt(residual / max(n - 5, 1)), math.sqrt(g[3])


@jit()
def _edges(profile: Array, threshold: float) -> tuple[Array, Array]:
    """Falling and rising edges of a profile, sub-pixel, strongest neighbours only."""
    falling, rising = np.empty(MAX_EDGES), np.empty(MAX_EDGES)
    nf = nr = 0
    n = profile.size
    slope = np.zeros(n)
    for j in range(1, n - 1):
        slope[j] = 0.5 * (profile[j + 1] - profile[j - 1])
    for j in range(1, n - 1):
        a, s, z = abs(slope[j - 1]), abs(slope[j]), abs(slope[j + 1])
        if s < threshold or (slope[j] * slope[j - 1] > 0.0 and a > s) or (slope[j] * slope[j + 1] > 0.0 and z >= s):
            continue
        shift = 0.0
        if slope[j] * slope[j - 1] > 0.0 and slope[j] * slope[j + 1] > 0.0 and 2.0 * s - a - z > 0.0:
            shift = 0.5 * (z - a) / (2.0 * s - a - z)
        if slope[j] < 0.0 and nf < MAX_EDGES:
            falling[nf] = j + shift
            nf += 1
        elif slope[j] > 0.0 and nr < MAX_EDGES:
            rising[nr] = j + shift
            nr += 1
    return falling[:nf], rising[:nr]


@jit()
def _centres(falling: Array, rising: Array, predicted: float, width: float, tolerance: float) -> Array:
    """Middles of the edge pairs that are as far apart as the line is wide, the nearest to the prediction first."""
    centres = np.empty(MAX_EDGES * MAX_EDGES)
    k = 0
    for i in range(falling.size):
        for j in range(rising.size):
            apart = rising[j] - falling[i]
            if (1.0 - tolerance) * width - 1.0 <= apart <= (1.0 + tolerance) * width + 1.0:
                centres[k] = 0.5 * (rising[j] + falling[i])
                k += 1
    # By insertion: a library's sort takes longer to compile than all the rest.
    for i in range(1, k):
        centre, j = centres[i], i
        while j > 0 and abs(centres[j - 1] - predicted) > abs(centre - predicted):
            centres[j] = centres[j - 1]
            j -= 1
        centres[j] = centre
    return centres[:k]


@jit()
def find_sections(patch: NDArray[np.uint8], predicted: float, slant: float, width: float, look: Look) -> Array:
    """All cross-sections in a window that pass the gates of width and contrast, nearest to the prediction first.

    ``(k, 5)`` with k ≤ 4: u_0, w, c, residual, standard deviation of u_0 per gray, as in ``_fit_section``.

    Args:
        patch: gray values, rows × scan direction.
        predicted: where the line should be [px from the window's first pixel].
        slant: shift of the line along the scan from row to row.
        width: expected width along the scan [px].
        look: blur, polarity, least depth and tolerance of the width.
    """
    rows, columns = patch.shape
    sections = np.empty((MAX_CANDIDATES, 5))
    profile = np.zeros(columns)
    for j in range(columns):
        for r in range(rows):
            c = min(max(j + round(slant * (r - 0.5 * (rows - 1))), 0), columns - 1)
            profile[j] += look.polarity * patch[r, c] / rows
    # A box of the least contrast, blurred, is at least this steep at its edges.
    falling, rising = _edges(profile, 0.15 * look.min_contrast)
    centres = _centres(falling, rising, predicted, width, look.width_tolerance)
    n = 0
    for i in range(min(centres.size, 2 * MAX_CANDIDATES)):
        if n == MAX_CANDIDATES:
            break
        u0, w, c, residual, spread = _fit_section(patch, centres[i], slant, width, look.blur, look.polarity)
        if not (c >= look.min_contrast and abs(w - width) <= look.width_tolerance * width):
            continue
        new = True
        for j in range(n):
            new = new and abs(sections[j, 0] - u0) > 0.5
        if new:
            sections[n, 0], sections[n, 1], sections[n, 2], sections[n, 3], sections[n, 4] = u0, w, c, residual, spread
            n += 1
    return sections[:n]
