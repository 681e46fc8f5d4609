"""What a path in a picture looks like when it is straightened, and whether that is a line.

Sections across the path are laid beside each other, so that the edges of a line stand still: its inside at -1 … 1, its
sides beyond. The direction of colour that separates inside and sides best (Fisher's) makes one number of every pixel, 1
inside and 0 beside in the mean. From it follow the edges of each section to fractions of a pixel, and what tells
lines from all else that is long: how much of the picture it crosses, how clear it is, how smooth, how evenly wide; that
it lies on one ground: rims, folds and shores have another thing on their other side; and that it lies there alone:
beside rods, steps, slats, stripes and lines of a text run others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array, arc_lengths
from ideal_robot.jit import jit
from sensing.camera.line_paths import COLOR, REDUCED, Lab, Path

SECTIONS = 48
"""Sections across a line in which it is looked at."""
_ALONG = 3
"""Places of which the mean is taken in each section."""
# Places across the line, its edges at ±1; those in it and beside it leave the blurred edges out.
_T = np.linspace(-2.0, 2.0, 41)
_INSIDE, _LEFT, _RIGHT = np.abs(_T) < 0.65, _T < -1.25, _T > 1.25
_NOISE = 2.0
"""Least noise that is assumed [gray]."""
_SEEN = 0.4
"""Share of the usual contrast from which on a section shows the line; one of the inverse shows something else."""
_EDGE_SIDE = 5.0
"""Reach to both sides of a single edge [px]."""
_BESIDE = np.arange(1.0, 61.0, 2.0)
"""Distances from its edges at which is looked for what runs beside a line [px]: to a tenth of the largest picture."""
_COURSE = 6
"""Degree of the polynomials that lines follow: what is left of things that are none is larger."""
_FINEST = 1.0 / REDUCED[0]
"""What a course leaves, over its length, is not told from nothing below a pixel of the picture that was linked."""
_NARROWEST = 0.5
"""Step in which edges are looked for [px]; what a taper leaves is not told from nothing below it."""


@dataclass(frozen=True)
class Strip:
    """A line straightened out.

    Attributes:
        points: middle of each section ``(n, 2)`` [px].
        normals: unit vectors across the line ``(n, 2)``.
        widths: ``(n,)`` [px]; 0 at an edge.
        sigmas: standard deviations of the points across the line ``(n,)`` [px].
        shown: share of the usual contrast that each section shows ``(n,)``, on the weaker side.
        color: inside less sides, lightness and weighted colour ``(3,)``.
        direction: of colour that separates them, scaled to 1 for ``color`` ``(3,)``.
        features: what the decision goes by, see ``FEATURES``.
    """

    points: Array
    normals: Array
    widths: Array
    sigmas: Array
    shown: Array
    color: Array
    direction: Array
    features: Array

    @property
    def confidence(self) -> Array:
        """How sure each point is, 0 … 1 ``(n,)``: by how much of the usual contrast it shows."""
        return np.clip(self.shown, 0.0, 1.0)

    def thinned(self, count: int) -> Strip:
        """The same with so many of its sections, first and last among them."""
        k = np.linspace(0, len(self.points) - 1, count).round().astype(int)
        return replace(self, points=self.points[k], normals=self.normals[k], widths=self.widths[k],
                       sigmas=self.sigmas[k], shown=self.shown[k])


FEATURES = ("length", "clarity", "course", "taper", "sides", "alone")
"""What lines have more of: logarithms of the length over the picture's shorter side, of the contrast over the scatter
within inside and sides, of how little a polynomial leaves of its course, over its length, and how little a linear taper
of its width [px]; less the difference of both sides over the contrast, and less the logarithm of 1 and what runs
beside it over the contrast."""
WEIGHTS = np.array([5.703, 0.4875, 0.6958, 2.053, 7.248, 5.661, 1.406])
"""Of the features, and an offset: `python -m studies line-weights`."""


def evidence(strip: Strip) -> float:
    """Logarithm of how much likelier a candidate is a line than not."""
    return float(np.r_[strip.features, 1.0] @ WEIGHTS)


def straightened(lab: Lab, path: Path, sections: int = SECTIONS) -> Strip:
    """A path's sections, its edges found anew in each.

    Args:
        lab: of ``lab_picture``.
        path: of ``paths`` for the same picture.
        sections: how many, at equal distances.
    """
    edge = not path.widths.any()
    points, halves = _even(path.points, 0.5 * path.widths, sections)
    strip, clarity, sides = _measured(lab, points, halves, edge)
    first, end = _best_run((strip.shown > _SEEN) & (strip.shown < 1.0 / _SEEN))
    if end - first >= 5:
        points, halves = _even(strip.points[first:end], 0.5 * strip.widths[first:end], sections)
        strip, clarity, sides = _measured(lab, points, halves, edge)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    wiggle, uneven = (float(np.sqrt(np.mean(_rest(of, degree) ** 2)))
                      for of, degree in ((strip.points, _COURSE), (strip.widths, 1)))
    return replace(strip, features=np.array([np.log(length / min(lab.shape[:2])), np.log(clarity),
                                             -np.log(_FINEST + wiggle / length), -np.log(_NARROWEST + uneven), -sides,
                                             -np.log1p(_beside(lab, strip))]))


def _beside(lab: Lab, strip: Strip) -> float:
    """What runs along a line beside it, in units of its contrast.

    Of the mean section only what is parallel to the line is left; half of the total variation of its two wings is the
    sum of all the heights of what stands there.
    """
    along = _fine(strip.points, strip.normals)
    away = 0.5 * strip.widths[:, None] + _BESIDE
    wings = (_sampled(lab, along, side * away).mean(axis=0) @ strip.direction for side in (-1.0, 1.0))
    return 0.5 * sum(float(np.abs(np.diff(wing)).sum()) for wing in wings)


def _best_run(good: NDArray[np.bool_]) -> tuple[int, int]:
    """First and end of the run in which good sections outweigh others most, each of those worth two."""
    total = np.concatenate([[0.0], np.cumsum(np.where(good, 1.0, -2.0))])
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    return int(np.argmin(total[: end + 1])), end


def _even(points: Array, halves: Array, sections: int) -> tuple[Array, Array]:
    """The path smoothed, at equal distances ``(n, 2)``, ``(n,)``."""
    points, halves = _smooth(points, 5), _smooth(halves, 7)
    s = arc_lengths(points)
    even = np.linspace(0.0, s[-1], sections)
    return (np.column_stack([np.interp(even, s, points[:, 0]), np.interp(even, s, points[:, 1])]),
            np.maximum(np.interp(even, s, halves), 0.5))


def _smooth(values: Array, width: int) -> Array:
    """Medians of five, then means of ``width``, along the first axis; beyond the ends values go on as they came."""
    flat = np.ascontiguousarray(values.reshape(len(values), -1))
    return _smoothed(flat, width // 2).reshape(values.shape)


@jit()
def _smoothed(values: Array, half: int) -> Array:
    n, channels = values.shape
    reach = half + 2
    out = np.empty_like(values)
    long, middle, five = np.empty(n + 2 * reach), np.empty(n + 2 * half), np.empty(5)
    for c in range(channels):
        for i in range(-reach, n + reach):
            # Reflected about the end values, so that slopes stay.
            if i < 0:
                long[i + reach] = 2.0 * values[0, c] - values[min(-i, n - 1), c]
            elif i >= n:
                long[i + reach] = 2.0 * values[n - 1, c] - values[max(2 * n - 2 - i, 0), c]
            else:
                long[i + reach] = values[i, c]
        for i in range(n + 2 * half):
            # The median of five, by insertion: numpy's sort takes seconds to compile.
            for j in range(5):
                k = j
                while k > 0 and five[k - 1] > long[i + j]:
                    five[k] = five[k - 1]
                    k -= 1
                five[k] = long[i + j]
            middle[i] = five[2]
        for i in range(n):
            out[i, c] = np.mean(middle[i : i + 2 * half + 1])
    return out


def _sampled(lab: Lab, along: tuple[Array, Array], offsets: Array) -> Array:
    """Vectors ``(n, m, 3)`` at offsets ``(n, m)`` [px] across the places of ``_fine``, the mean over neighbours."""
    off = np.repeat(offsets, _ALONG, axis=0)
    u, v = ((place[:, None] + off * across[:, None]).astype(np.float32) for place, across in zip(*along, strict=True))
    values = cv2.remap(lab, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = values.reshape(len(offsets), _ALONG, offsets.shape[1], 3)
    return np.asarray(values.sum(axis=1, dtype=np.int32) * (COLOR / _ALONG))


def _fine(points: Array, normals: Array) -> tuple[Array, Array]:
    """``_ALONG`` places about each section and the normals there, both ``(2, n * _ALONG)``."""
    k = np.arange(len(points))
    fine = (np.arange(len(points) * _ALONG) - 0.5 * (_ALONG - 1)) / _ALONG
    return np.array([np.interp(fine, k, c) for c in points.T]), np.repeat(normals.T, _ALONG, axis=1)


def _measured(lab: Lab, points: Array, halves: Array, edge: bool) -> tuple[Strip, float, float]:
    """Sections across a line of these half widths ``(n,)``, without features.

    Beside them contrast over scatter, and the difference of the sides over the contrast, 0 of an edge.
    """
    steps = np.diff(points, axis=0)
    tangents = _smooth(0.5 * (np.concatenate([steps[:1], steps]) + np.concatenate([steps, steps[-1:]])), 5)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-9)
    normals = np.column_stack([-tangents[:, 1], tangents[:, 0]])
    along = _fine(points, normals)
    inner = np.zeros_like(halves) if edge else halves
    half = float(_median(halves))
    outer = _EDGE_SIDE if edge else min(max(0.6 * half, 2.0), 12.0)
    offsets = np.clip(_T, -1.0, 1.0) * inner[:, None] + np.sign(_T) * np.maximum(np.abs(_T) - 1.0, 0.0) * outer
    X = _sampled(lab, along, offsets)
    groups = [X[:, _LEFT], X[:, _RIGHT]] if edge else [X[:, _LEFT], X[:, _RIGHT], X[:, _INSIDE]]
    means = [group.mean(axis=1) for group in groups]
    left, right, inside = means[0], means[1], means[-1]
    color = _median(inside - (left if edge else 0.5 * (left + right)))
    direction, clarity = _separating(groups, means, color)
    shown = (inside - left) @ direction
    shown = shown if edge else np.minimum(shown, (inside - right) @ direction)
    about = np.zeros((len(halves), 1)) if edge else np.column_stack([-inner, inner])
    edges, steep = _edges(lab, along, about, direction, min(max(0.7 * half, 2.0), 6.0))
    sigmas = float(np.linalg.norm(direction)) * _NOISE / np.sqrt(_ALONG) / steep
    middle, sigma = edges.mean(axis=1), np.linalg.norm(sigmas, axis=1) / edges.shape[1]
    widths = np.zeros_like(middle) if edge else np.maximum(edges[:, 1] - edges[:, 0], 0.5)
    centres = points + middle[:, None] * normals
    sides = 0.0 if edge else float(np.linalg.norm(_median(left - right)) / np.linalg.norm(color))
    return Strip(centres, normals, widths, sigma, shown, color, direction, np.empty(0)), clarity, sides


def _median(values: Array) -> Array:
    """Median along the first axis: of few values a third of the time that NumPy's takes."""
    values = np.sort(values, axis=0)
    return np.asarray(0.5 * (values[(len(values) - 1) // 2] + values[len(values) // 2]))


def _separating(groups: list[Array], means: list[Array], color: Array) -> tuple[Array, float]:
    """Fisher's direction for a difference of colours, scaled to 1 for it, and that difference over the scatter."""
    scatter = _NOISE**2 * np.eye(3)
    for group, mean in zip(groups, means, strict=True):
        rest = (group - mean[:, None]).reshape(-1, 3)
        scatter += rest.T @ rest / (len(rest) * len(groups))
    direction = np.asarray(np.linalg.solve(scatter, color), dtype=float)
    square = max(float(color @ direction), 1e-6)
    return direction / square, float(np.sqrt(square))


def _rest(values: Array, degree: int) -> Array:
    """What a polynomial leaves of values along a line."""
    basis = _orthonormal(len(values), degree)
    return np.asarray(values - basis @ (basis.T @ values))


@cache
def _orthonormal(count: int, degree: int) -> Array:
    """Polynomials up to a degree at so many places, orthonormal ``(count, degree + 1)``."""
    return np.asarray(np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, count), degree))[0])


def _edges(lab: Lab, along: tuple[Array, Array], about: Array, direction: Array, reach: float) -> tuple[Array, Array]:
    """Where ``direction`` rises most about the first of the offsets ``(n, k)`` [px], and falls most about a second one.

    Beside these offsets how steep it is there [1/px].
    """
    step = _NARROWEST
    offsets = np.arange(-reach - 1.0, reach + 1.0 + step, step)
    n, count = about.shape
    values = _sampled(lab, along, (about[:, :, None] + offsets).reshape(n, -1)) @ direction
    values = values.reshape(n, count, -1) * np.array([1.0, -1.0])[:count, None]
    slope = np.zeros_like(values)
    slope[..., 2:-2] = values[..., 3:-1] - values[..., 1:-3] + 0.5 * (values[..., 4:] - values[..., :-4])
    slope /= 4.0 * step
    k = 2 + slope[..., 2:-2].argmax(axis=2)
    row, edge = np.ogrid[:n, :count]
    before, top, after = (slope[row, edge, k + d] for d in (-1, 0, 1))
    shift = 0.5 * (before - after) / np.minimum(before - 2.0 * top + after, -1e-9)
    return about + offsets[k] + step * np.clip(shift, -0.5, 0.5), np.maximum(top, 1e-3)
