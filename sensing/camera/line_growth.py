"""Extends a path in the picture plane beyond both of its ends, as long as the same cross-section goes on.

Paths of ``line_paths`` are functions of the column or of the row, so a line that turns back ends where it turns. From
an end the line is followed step by step: of several turns and sidesteps the one is taken whose cross-section shows most
of the contrast that the line has, and whose turn is least. Where the contrast ends the line may have a corner: it goes
on along the ray that shows most of it. It ends where no ray does, at the picture's border, and where it meets itself.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from sensing.camera.line_evidence import SECTIONS, Strip, straightened
from sensing.camera.line_paths import COLOR, Lab, Path

Floats = NDArray[np.float32]

_SPACING, _MOST_SECTIONS = 8.0, 120
"""Distance of the sections of a line that was continued [px], and how many it has at most."""
_STEPS = 600
"""Steps from an end at most: with half a width a step more than any line in a reduced picture has."""
_TURNS, _ASIDE = 7, 3
"""Turns and sidesteps that are tried at each step."""
_TIGHTEST = 1.5
"""Least radius of a turn, in widths: a cable or a tape that is bent more folds."""
_TURN_COST = 0.15
"""Share of the contrast that the tightest turn costs: of two that show the same the straighter one is taken."""
_SEEN = 0.4
"""Share of the usual contrast from which on a section shows the line; one of the inverse shows something else."""
_LOOK_BACK = 3
"""Steps without the line that are leapt over."""
_RAYS, _ALONG_RAY = 25, 6
"""Directions about a corner that are tried, and steps along each that have to show the line."""
_SHARPEST = math.radians(120.0)
"""Turn of a corner at most."""


def continued(lab: Lab, strip: Strip, longer: float = 1.08) -> Strip:
    """A line extended at both ends and straightened anew; the line itself where it can hardly be extended.

    Args:
        lab: of ``lab_picture``.
        strip: the line.
        longer: least ratio of the extended length to the old one at which it is straightened anew.
    """
    width = float(np.median(strip.widths))
    points = grown(lab, strip.points, width, strip.direction)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    if length <= longer * strip.length:
        return strip
    sections = int(np.clip(length / _SPACING, SECTIONS, _MOST_SECTIONS))
    return straightened(lab, Path(points, np.full(len(points), width), 0.0), sections=sections)


def grown(lab: Lab, points: Array, width: float, direction: Array) -> Array:
    """Points ``(m, 2)`` [px] of a path extended at both ends; the path itself where it cannot be extended.

    Args:
        lab: of ``lab_picture``.
        points: of the path ``(n, 2)`` [px], at equal distances, ``n`` at least 8.
        width: of the line [px].
        direction: in colour space, scaled so that the contrast between line and background is 1 along it ``(3,)``.
    """
    image = np.asarray(cv2.transform(lab.astype(np.float32), (COLOR * direction)[None].astype(np.float32)),
                       dtype=np.float32)
    half = max(0.5 * width, 0.75)
    ends = [_followed(image, np.ascontiguousarray(way), half) for way in (points[::-1], points)]
    return np.concatenate([ends[0][::-1], points, ends[1]])


@jit()
def _at(image: Floats, x: float, y: float) -> float:
    """Value between pixels, of the nearest pixel beyond the border."""
    rows, columns = image.shape
    x, y = min(max(x, 0.0), columns - 1.001), min(max(y, 0.0), rows - 1.001)
    j, i = int(x), int(y)
    a, b = x - j, y - i
    return ((1.0 - b) * ((1.0 - a) * image[i, j] + a * image[i, j + 1])
            + b * ((1.0 - a) * image[i + 1, j] + a * image[i + 1, j + 1]))


@jit()
def _contrast(image: Floats, x: float, y: float, angle: float, half: float) -> float:
    """Inside less the nearer side of a cross-section; ``angle`` is the tangent's, 1 the line's usual contrast."""
    outer = min(max(0.6 * half, 2.0), 12.0)
    c, s = math.cos(angle), math.sin(angle)
    inside = left = right = 0.0
    for k in range(-1, 2):
        u, v = x + k * 0.5 * c, y + k * 0.5 * s
        for m in range(3):
            a, b = 0.5 * half * (m - 1), half + (0.25 + 0.3 * m) * outer + 0.5
            inside += _at(image, u - a * s, v + a * c)
            left += _at(image, u - b * s, v + b * c)
            right += _at(image, u + b * s, v - b * c)
    return (inside - max(left, right)) / 9.0


@jit()
def _corner(image: Floats, x: float, y: float, angle: float, half: float, step: float) -> tuple[float, float, float]:
    """Where a line goes on behind a corner about ``x, y``, and in which direction; a direction of NaN where nowhere."""
    rows, columns = image.shape
    best, bx, by, direction = 0.0, x, y, math.nan
    for r in range(_RAYS):
        turn = _SHARPEST * (2.0 * r / (_RAYS - 1) - 1.0)
        phi = angle + turn
        for back in range(-2, 3):
            # The mean over the line's width about the last point, where both branches meet.
            u, v = x + 0.5 * back * half * math.cos(angle), y + 0.5 * back * half * math.sin(angle)
            least = total = 1.0
            for k in range(_ALONG_RAY):
                far = 1.5 * half + (k + 1.0) * step
                px, py = u + far * math.cos(phi), v + far * math.sin(phi)
                shown = 0.0
                if 0.0 <= px <= columns - 1 and 0.0 <= py <= rows - 1:
                    shown = min(_contrast(image, px, py, phi, half), 1.0)
                least = min(least, shown)
                total += shown
            if least > _SEEN and total > best:
                best, direction = total, phi
                bx, by = u + 1.5 * half * math.cos(phi), v + 1.5 * half * math.sin(phi)
    return bx, by, direction


@jit()
def _followed(image: Floats, way: Array, half: float) -> Array:
    """Points beyond the last of ``way (n, 2)``, ``(m, 2)``."""
    rows, columns = image.shape
    n = way.shape[0]
    x, y = way[n - 1, 0], way[n - 1, 1]
    angle = math.atan2(y - way[n - 6, 1], x - way[n - 6, 0])
    step = max(1.5, 0.5 * half)
    turn_most = step / (2.0 * half * _TIGHTEST + 1.0)
    found = np.empty((_STEPS, 2))
    count = good = missed = 0
    before, cornered = angle, -1
    # The line does not meet itself within this distance back along it.
    away = 4.0 * half + 4.0
    while count < _STEPS:
        if missed > _LOOK_BACK:
            if good == cornered:
                break
            cornered = good
            if good > 0:
                x, y = found[good - 1, 0], found[good - 1, 1]
            else:
                x, y = way[n - 1, 0], way[n - 1, 1]
            x, y, angle = _corner(image, x, y, before, half, step)
            if math.isnan(angle):
                break
            count, missed = good, 0
        best, bx, by, turned, shown = -1e9, 0.0, 0.0, 0.0, 0.0
        for a in range(_TURNS):
            turn = turn_most * (2.0 * a / (_TURNS - 1) - 1.0)
            phi = angle + turn
            for b in range(_ASIDE):
                aside = (b - 1) * 0.25 * step
                u = x + step * math.cos(phi) - aside * math.sin(phi)
                v = y + step * math.sin(phi) + aside * math.cos(phi)
                here = _contrast(image, u, v, phi, half)
                value = min(here, 1.0) - _TURN_COST * (turn / turn_most) ** 2 - 0.02 * abs(b - 1)
                if value > best:
                    best, bx, by, turned, shown = value, u, v, turn, here
        if not (0.0 <= bx <= columns - 1 and 0.0 <= by <= rows - 1):
            break
        met = False
        length = 0.0
        for k in range(count - 1, -1, -1):
            length += step
            if length > away and (found[k, 0] - bx) ** 2 + (found[k, 1] - by) ** 2 < half * half:
                met = True
                break
        px, py = way[n - 1, 0], way[n - 1, 1]
        for k in range(n - 2, -1, -1):
            if met:
                break
            length += math.sqrt((way[k, 0] - px) ** 2 + (way[k, 1] - py) ** 2)
            px, py = way[k, 0], way[k, 1]
            met = length > away and (px - bx) ** 2 + (py - by) ** 2 < half * half
        if met:
            break
        x, y, angle = bx, by, angle + turned
        found[count, 0], found[count, 1] = x, y
        count += 1
        if _SEEN < shown < 1.0 / _SEEN:
            good, missed, before = count, 0, angle
        else:
            missed += 1
    return found[:good].copy()
