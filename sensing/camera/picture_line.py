"""The line in a whole picture of which nothing is known: width, colour, course and place are found, not given.

For pictures of a user's own cell, before anything moves (``ideal-robot detect``). Paths through the picture
(``line_paths``) are straightened and weighed (``line_evidence``); the one that is likeliest the line that is meant is
measured at full size. A picture has no scale: all lengths are pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sensing.camera.line_evidence import SECTIONS, Strip, evidence, straightened
from sensing.camera.line_paths import Path, lab_picture, paths

KINDS: dict[str, tuple[float, float]] = {
    "line": (0.0, 0.12), "tape": (0.02, 0.45), "laser": (0.0, 0.06), "seam": (0.0, 0.3), "edge": (0.0, 0.0)}
"""Kinds of lines, with least and largest width as shares of the picture's shorter side."""
ANY = (0.0, 0.45)
"""… of a line of any kind but an edge."""
LONGEST = 640
"""Longer side of the picture in which lines are looked for [px]; points are measured in the whole one."""
SLENDER = 3.0
"""What is not longer than so many times its width is no line."""
_CANDIDATES = 6
"""Paths that are straightened."""
_ABOUT = (0.4, 0.08)
"""Standard deviation of where a line is meant, about the middle and about a point that was told, as shares of the
shorter side."""
EXPECTED = 4.6
"""Log odds of a line about a point that was told, or where it was before: it is there in 99 of 100."""
TOLD_WITHIN = 0.02
"""Of the picture's shorter side, how exactly a pixel is told: ten pixels of a common camera."""
_REACH = 0.3
"""Share of the picture's shorter side beyond which a path is not about the place where the line is expected."""


@dataclass(frozen=True)
class PictureLine:
    """What was found in one picture.

    Attributes:
        size: width and height of the picture [px].
        strip: the line's points with widths, standard deviations and confidence, see ``Strip``; None where none is.
        evidence: logarithm of how much likelier a line is than none, of the line or of the likeliest candidate.
        others: further lines in the picture.
        reason: why there is no line, else empty.
    """

    size: tuple[int, int]
    strip: Strip | None
    evidence: float
    others: int
    reason: str

    @property
    def found(self) -> bool:
        """Whether there is a line."""
        return self.strip is not None

    @property
    def points(self) -> Array:
        """Points along the line ``(n, 2)`` [px]; empty where none was found."""
        return np.empty((0, 2)) if self.strip is None else self.strip.points

    @property
    def width(self) -> float:
        """Median width [px]; 0 of an edge, NaN where no line was found."""
        return float("nan") if self.strip is None else float(np.median(self.strip.widths))

    @property
    def dark(self) -> bool:
        """Whether the line is darker than its sides."""
        return self.strip is not None and bool(self.strip.color[0] < 0.0)

    @property
    def contrast(self) -> float:
        """By how much line and sides differ, lightness and colour together [gray]; NaN where no line was found."""
        return float("nan") if self.strip is None else float(np.linalg.norm(self.strip.color))

    @property
    def sigma(self) -> float:
        """Median standard deviation of a point across the line [px]; NaN where no line was found."""
        return float("nan") if self.strip is None else float(np.median(self.strip.sigmas))


def detect_in_picture(picture: NDArray[np.uint8], *, kind: str | None = None,
                      near: tuple[float, float] | None = None, points: int = 15) -> PictureLine:
    """Finds the line of a picture; of several the one that is clearest and nearest to where it is meant.

    Args:
        picture: gray ``(height, width)`` or BGR ``(height, width, 3)``.
        kind: of ``KINDS``; None for any but a single edge.
        near: pixel u, v that the line passes, or there is none; if None any, of several that about the middle.
        points: along the line.

    Raises:
        InputError: no picture of at least 32 × 32 pixels, no such kind, or fewer than five points asked for.
    """
    check_asked(picture, kind, points)
    small, scale = reduced(picture)
    value, strip, reason, others = likeliest(small, kind, None if near is None else np.array(near) * scale)
    full = None if strip is None else measured(picture, strip, scale, points)
    return PictureLine((picture.shape[1], picture.shape[0]), full, value, others, reason)


def check_asked(picture: NDArray[np.uint8], kind: str | None, points: int) -> None:
    """Raises the InputError of ``detect_in_picture`` for what it does not take.

    Args:
        picture, kind, points: as of ``detect_in_picture``.
    """
    if picture.ndim not in (2, 3) or picture.dtype != np.uint8 or min(picture.shape[:2]) < 32:
        raise InputError("expected a picture of 8 bits, gray or BGR, and at least 32 × 32 pixels", field="picture",
                         value=(picture.shape, str(picture.dtype)))
    if points < 5:
        raise InputError("five points are needed at least", field="points", value=points)
    if kind is not None and kind not in KINDS:
        raise InputError(f"expected one of {', '.join(KINDS)}", field="kind", value=kind)


def likeliest(picture: NDArray[np.uint8], kind: str | None, near: Array | None
              ) -> tuple[float, Strip | None, str, int]:
    """The line of a reduced picture: its log odds, it or the reason why none is, and how many others there are.

    Args:
        picture: of ``reduced``.
        kind: see ``detect_in_picture``.
        near: pixel ``(2,)`` that the line passes, or None.
    """
    middle = 0.5 * np.array(picture.shape[1::-1]) if near is None else near
    about = _ABOUT[near is not None] * min(picture.shape[:2])
    lines = find_lines(picture, kind=kind, about=None if near is None else near[None])
    if near is not None:
        # Whoever tells a point says that there is a line.
        lines = [(value + max(0.0, EXPECTED - 0.5 * (_distance(strip, middle) / about) ** 2), strip)
                 for value, strip in lines]
    accepted = [line for line in lines if line[0] > 0.0 and (near is None or _passes(line[1], near, picture))]
    if near is not None and not accepted and any(value > 0.0 for value, _ in lines):
        return max(value for value, _ in lines), None, "no line passes that pixel", 0
    if not accepted:
        best = max((value for value, _ in lines), default=-np.inf)
        return best, None, ("nothing crosses the picture between two edges" if not lines else
                            f"what is most like a line is likelier none (log odds {best:.1f})"), 0
    value, strip = max(accepted, key=lambda line: _meant(line[0], line[1], middle, about))
    return value, strip, "", len(accepted) - 1


def reduced(picture: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], float]:
    """A picture, gray or BGR, no larger than ``LONGEST``, and by what it is smaller."""
    scale = min(1.0, LONGEST / max(picture.shape[:2]))
    small = picture if scale == 1.0 else cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), scale


def measured(picture: NDArray[np.uint8], strip: Strip, scale: float, points: int) -> Strip:
    """A line of the reduced picture, measured in the whole one.

    Args:
        picture: the whole one.
        strip: the line.
        scale: of ``reduced``.
        points: how many along it.
    """
    if scale < 1.0 or points > len(strip.points):
        path = Path((strip.points + 0.5) / scale - 0.5, strip.widths / scale, 0.0)
        strip = straightened(lab_picture(picture), path, sections=max(SECTIONS, points))
    return strip.thinned(points)


def _meant(value: float, strip: Strip, middle: Array, about: float) -> float:
    """Logarithm of how likely it is that this is a line and the one that is meant, up to a constant.

    What is drawn to be seen has contrast; of two that are certainly lines neither is more of one.
    """
    contrast = float(np.log(np.linalg.norm(strip.color)))
    return -float(np.logaddexp(0.0, -value)) + 2.0 * contrast - 0.5 * (_distance(strip, middle) / about) ** 2


def _passes(strip: Strip, place: Array, picture: NDArray[np.uint8]) -> bool:
    """Whether a line covers a pixel, as exactly as one is told."""
    begin, along = strip.points[:-1], np.diff(strip.points, axis=0)
    share = np.einsum("nd,nd->n", place - begin, along) / np.maximum(np.einsum("nd,nd->n", along, along), 1e-12)
    away = np.linalg.norm(begin + np.clip(share, 0.0, 1.0)[:, None] * along - place, axis=1)
    half = 0.25 * (strip.widths[:-1] + strip.widths[1:])
    return bool(np.any(away < half + TOLD_WITHIN * min(picture.shape[:2])))


def _distance(strip: Strip, place: Array) -> float:
    return float(np.min(np.linalg.norm(strip.points - place, axis=1)))


def find_lines(picture: NDArray[np.uint8], *, kind: str | None = None, about: Array | None = None
               ) -> list[tuple[float, Strip]]:
    """Candidates for lines with the logarithm of their odds, each place of the picture once, the likeliest first.

    Args:
        picture: gray or BGR, no larger than ``LONGEST``.
        kind: see ``detect_in_picture``.
        about: points ``(m, 2)`` [px] about which they lie; anywhere if None.
    """
    lab = lab_picture(picture)
    least, widest = KINDS[kind] if kind else ANY
    size = min(picture.shape[:2])
    ranked = sorted(paths(lab, widest=widest), key=lambda path: -path.score)
    if about is not None:
        ranked = [path for path in ranked if np.linalg.norm(path.points[:, None] - about, axis=2).min() < _REACH * size]
    lines: list[tuple[float, Strip]] = []
    for path in ranked[:_CANDIDATES]:
        strip = straightened(lab, path)
        width = float(np.median(strip.widths))
        length = float(np.linalg.norm(np.diff(strip.points, axis=0), axis=1).sum())
        slender = least * size <= width <= min(widest * size, length / SLENDER)
        if not slender or (kind == "laser" and strip.color[0] < 0.0):
            continue
        lines.append((evidence(strip), strip))
    lines.sort(key=lambda line: -line[0])
    distinct: list[tuple[float, Strip]] = []
    for value, strip in lines:
        if all(_apart(strip, other) for _, other in distinct):
            distinct.append((value, strip))
    return distinct


def _apart(one: Strip, other: Strip) -> bool:
    """Whether most of a line lies beside another."""
    distance = np.linalg.norm(one.points[:, None] - other.points, axis=2).min(axis=1)
    return bool(np.mean(distance > np.maximum(2.0, 0.5 * float(np.median(other.widths)))) > 0.5)
