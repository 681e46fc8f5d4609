"""Finds the line in a whole picture without prior knowledge: its width, colour, course and place.

For pictures of a user's own cell, before anything moves (``ideal-robot detect``). Paths through the picture
(``line_paths``) are straightened and weighed (``line_evidence``); the one that is likeliest the line that is meant is
measured at full size. A picture has no scale: all lengths are pixels.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from ideal_robot.arrays import Array, interpolated
from ideal_robot.errors import InputError
from sensing.camera.line_evidence import SECTIONS, Strip, evidence, measured_again, straightened
from sensing.camera.line_growth import continued
from sensing.camera.line_paths import Lab, Path, lab_picture, paths
from sensing.camera.line_pieces import apart, broken_at_steps, further_pieces, in_order, share_on, smooth_pieces

KINDS: dict[str, tuple[float, float]] = {
    "line": (0.0, 0.12), "tape": (0.02, 0.45), "laser": (0.0, 0.06), "seam": (0.0, 0.3), "edge": (0.0, 0.0)}
"""Kinds of lines, with least and largest width as shares of the picture's shorter side."""
ANY = (0.0, 0.45)
"""… of a line of any kind but an edge."""
LONGEST = 640
"""Longer side of the picture in which lines are looked for [px]; points are measured in the whole one."""
SURE = 0.65
"""Probability from which on a line is reported: the least at which, of photographs whose source took no part in the
weights' fit, at most 3 % show another thing than the line and at most 3 % of those without one show one
(``python -m studies line-weights``)."""
_CANDIDATES = 6
"""Paths that are straightened: in 97 of 99 photographs the line is among them; two more find none of the others."""
_HOPELESS = -5.0
"""Log odds below which a path is not followed on beyond its ends: of photographs' lines none begins with less."""
_SAME = 0.8
"""Share of a path that lies on another one, of about its width, from which on they are one."""
_WIDER = 1.4
"""Ratio of widths up to which two paths may be one."""
TOLD_WITHIN = 0.02
"""Of the picture's shorter side, how exactly a pixel is told: ten pixels of a common camera."""
TOLD = 3.6
"""Log odds by which a line through a pixel that a person tells is likelier: in photographs, what passes a marked pixel
and what passes one beside a line, or one of a picture without, are equally frequent at so much below even odds."""
EXPECTED = 4.6
"""Log odds of a line where it was before, or beyond its end: it is there in 99 of 100."""
_REACH = 0.3
"""Share of the picture's shorter side beyond which a path is not about the place where the line is expected."""


@dataclass(frozen=True)
class PictureLine:
    """The line found in one picture, or the reason why none was.

    Attributes:
        size: width and height of the picture [px].
        strip: the line's points with widths, standard deviations and confidence, see ``Strip``; None where none is.
        evidence: log odds that what was found is a line, or of the likeliest candidate where none was.
        others: further lines in the picture that are no part of it.
        reason: why there is no line, else empty.
        whole: all pieces of a line that breaks, in all their sections, the one of ``strip`` first; empty without one.
    """

    size: tuple[int, int]
    strip: Strip | None
    evidence: float
    others: int
    reason: str
    whole: tuple[Strip, ...] = ()

    @property
    def probability(self) -> float:
        """Probability that what was found is a line; of the likeliest candidate where none was."""
        return float(expit(self.evidence))

    @property
    def curve(self) -> Array:
        """Polygon of all sections of the line ``(k, 2)`` [px]; finer than ``points``, which cut its bends."""
        return self.whole[0].points if self.whole else np.empty((0, 2))

    @property
    def pieces(self) -> tuple[Strip, ...]:
        """All smooth pieces of the line in their order along it; it breaks between them, or has a corner."""
        return tuple(piece for strip in in_order(self.whole) for piece in smooth_pieces(strip)) if self.whole else ()

    @property
    def breaks(self) -> tuple[tuple[Array, Array], ...]:
        """Gaps of the line: last point of a segment and first of the next ``(2,)`` [px]; at a corner the same point."""
        return tuple((one.points[-1], other.points[0]) for one, other in pairwise(self.pieces))

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
        """Difference of line and sides in lightness and colour together [gray]; NaN where no line was found."""
        return float("nan") if self.strip is None else float(np.linalg.norm(self.strip.color))

    @property
    def sigma(self) -> float:
        """Median standard deviation of a point across the line [px]; NaN where no line was found."""
        return float("nan") if self.strip is None else float(np.median(self.strip.sigmas))


def detect_in_picture(picture: NDArray[np.uint8], *, kind: str | None = None,
                      near: tuple[float, float] | None = None, points: int = 15) -> PictureLine:
    """Finds the line of a picture; where there are several, the likeliest.

    Args:
        picture: gray ``(height, width)`` or BGR ``(height, width, 3)``.
        kind: of ``KINDS``; None for any but a single edge.
        near: pixel u, v that the line passes, or there is none; if None any.
        points: along the line.

    Raises:
        InputError: no picture of at least 32 × 32 pixels, no such kind, or fewer than five points asked for.
    """
    check_asked(picture, kind, points)
    small, scale = reduced(picture)
    return measured(picture, likeliest(small, kind, None if near is None else (np.array(near) + 0.5) * scale - 0.5),
                    scale, points)


def check_asked(picture: NDArray[np.uint8], kind: str | None, points: int) -> None:
    """Raises the InputError of ``detect_in_picture`` for a picture, a kind or a number of points that it refuses.

    Args:
        picture, kind, points: as in ``detect_in_picture``.
    """
    if picture.ndim not in (2, 3) or picture.dtype != np.uint8 or min(picture.shape[:2]) < 32:
        raise InputError("expected a picture of 8 bits, gray or BGR, and at least 32 × 32 pixels", field="picture",
                         value=(picture.shape, str(picture.dtype)))
    if points < 5:
        raise InputError("five points are needed at least", field="points", value=points)
    if kind is not None and kind not in KINDS:
        raise InputError(f"expected one of {', '.join(KINDS)}", field="kind", value=kind)


class Likeliest(NamedTuple):
    """The likeliest line in a reduced picture, with its log odds, or the reason why there is none."""

    strips: list[Strip]
    evidence: float
    others: int
    reason: str


def likeliest(picture: NDArray[np.uint8], kind: str | None, near: Array | None) -> Likeliest:
    """Finds the likeliest line in a reduced picture.

    Args:
        picture: of ``reduced``.
        kind: see ``detect_in_picture``.
        near: pixel ``(2,)`` that the line passes, or None.
    """
    lab = lab_picture(picture)
    sure = float(logit(SURE))
    ranked = _ranked(lab, kind)
    every = _weighed(lab, ranked, kind)
    lines = every if near is None else _through(lab, every, kind, near)
    accepted = [line for line in lines if line[0] > sure]
    if not accepted:
        best = max((value for value, _ in lines), default=-np.inf)
        where = "" if near is None else " through this pixel"
        return Likeliest([], best, 0, f"nothing{where} crosses the picture between two edges" if not lines else
                         f"what is most like a line{where} is one with a probability of {expit(best):.2f} only")
    value, strip = accepted[0]
    parts = broken_at_steps(lab, strip)
    if near is not None:
        parts.sort(key=lambda part: float(np.linalg.norm(part.points - near, axis=1).min()))
    # The prior odds that a line continues beyond its end equal the odds that it is where it was.
    pieces = [piece for piece in further_pieces(lab, parts, ranked)
              if evidence(piece, joint=kind == "seam") + EXPECTED > sure]
    rest = [other for odds, other in _distinct_lines(every) if odds > sure]
    others = sum(all(apart(other, piece) for piece in (strip, *pieces)) for other in rest)
    return Likeliest([*parts, *pieces], value, others, "")


def _through(lab: Lab, every: list[tuple[float, Strip]], kind: str | None, pixel: Array) -> list[tuple[float, Strip]]:
    """Candidates that pass a given pixel, at which a line is known to be, the likeliest first.

    Where none of all candidates passes it that is surely a line, paths are sought that have to pass it.
    """
    found = _passing(every, pixel, lab)
    if found and found[0][0] > logit(SURE):
        return found
    sought = _weighed(lab, _ranked(lab, kind, through=pixel), kind)
    return _passing(sorted([*every, *sought], key=lambda line: -line[0]), pixel, lab)


def _passing(lines: Iterable[tuple[float, Strip]], pixel: Array, lab: Lab) -> list[tuple[float, Strip]]:
    """Those of candidates that pass a pixel; what surrounds or lies on a likelier line is not another one."""
    within = TOLD_WITHIN * min(lab.shape[:2])
    return [(value + TOLD, strip) for value, strip in _distinct_lines(lines)
            if _passes(strip.points, strip.widths, pixel, within)]


def reduced(picture: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], float]:
    """A gray or BGR picture reduced to ``LONGEST`` pixels at most, and the factor by which it was reduced."""
    scale = min(1.0, LONGEST / max(picture.shape[:2]))
    small = picture if scale == 1.0 else cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), scale


def measured(picture: NDArray[np.uint8], found: Likeliest, scale: float, points: int) -> PictureLine:
    """The line found in the reduced picture, measured at full resolution.

    Args:
        picture: the whole one.
        found: in the reduced one.
        scale: of ``reduced``.
        points: number of points along the line.
    """
    lab = lab_picture(picture) if found.strips and (scale < 1.0 or points > SECTIONS) else None
    whole = tuple(strip if lab is None else _finer(lab, strip, scale, points) for strip in found.strips)
    return PictureLine((picture.shape[1], picture.shape[0]), whole[0].thinned(points) if whole else None,
                       found.evidence, found.others, found.reason, whole)


def _finer(lab: Lab, strip: Strip, scale: float, points: int) -> Strip:
    """A line of the reduced picture in the whole one, at least at so many points."""
    # As many sections per pixel as before, from a path that is smoothed over pixels, not over sections: otherwise a
    # cable's bend would be cut off by more than the range in which edges are searched.
    finer = max(round(len(strip.points) / scale), points)
    even, own = np.linspace(0.0, 1.0, 4 * finer), np.linspace(0.0, 1.0, len(strip.points))
    path = Path((interpolated(even, own, strip.points) + 0.5) / scale - 0.5, np.interp(even, own, strip.widths) / scale,
                0.0)
    return measured_again(lab, strip, path, finer)


def find_lines(picture: NDArray[np.uint8], *, kind: str | None = None, about: Array | None = None
               ) -> list[tuple[float, Strip]]:
    """Candidates for lines with their log odds, the likeliest first, without duplicates of the same place.

    Args:
        picture: gray or BGR, no larger than ``LONGEST``.
        kind: see ``detect_in_picture``.
        about: points ``(m, 2)`` [px] about which they lie; anywhere if None.
    """
    lab = lab_picture(picture)
    return _distinct_lines(_weighed(lab, _ranked(lab, kind, about=about), kind))


def _distinct_lines(lines: Iterable[tuple[float, Strip]]) -> list[tuple[float, Strip]]:
    distinct: list[tuple[float, Strip]] = []
    for value, strip in lines:
        if all(apart(strip, other) and apart(other, strip) for _, other in distinct):
            distinct.append((value, strip))
    return distinct


def candidates(picture: NDArray[np.uint8], kind: str | None = None) -> list[Strip]:
    """Candidates for lines, straightened, the likeliest first; the same place may occur several times.

    Args:
        picture, kind: see ``find_lines``.
    """
    lab = lab_picture(picture)
    return [strip for _, strip in _weighed(lab, _ranked(lab, kind), kind)]


def _ranked(lab: Lab, kind: str | None, *, about: Array | None = None, through: Array | None = None) -> list[Path]:
    """Paths that may be a line's, those that stand out most first; see ``find_lines``.

    With a pixel ``through (2,)`` they have to pass it.
    """
    size, widest = min(lab.shape[:2]), (KINDS[kind] if kind else ANY)[1]
    ranked = sorted(paths(lab, widest=widest, through=through, within=TOLD_WITHIN * size),
                    key=lambda path: -path.score)
    if about is not None:
        ranked = [path for path in ranked if np.linalg.norm(path.points[:, None] - about, axis=2).min() < _REACH * size]
    if through is not None:
        ranked = [path for path in ranked if _passes(path.points, path.widths, through, 2.0 * TOLD_WITHIN * size)]
    return ranked


def _weighed(lab: Lab, ranked: Sequence[Path], kind: str | None) -> list[tuple[float, Strip]]:
    """The first of the paths straightened, with the log odds that it is the line, the likeliest first."""
    least, widest = (share * min(lab.shape[:2]) for share in (KINDS[kind] if kind else ANY))
    lines = [(evidence(strip, joint=kind == "seam"), strip) for path in _distinct_paths(ranked)
             for strip in _with_continued(lab, straightened(lab, path))
             if least <= float(np.median(strip.widths)) <= widest and not (kind == "laser" and _darkens(strip))]
    return sorted(lines, key=lambda line: -line[0])


def _darkens(strip: Strip) -> bool:
    """Whether a line is darker than its sides rather than of another colour: light adds to a ground, or tints it."""
    return bool(strip.color[0] < -np.linalg.norm(strip.color[1:]))


def _distinct_paths(ranked: Sequence[Path]) -> list[Path]:
    """The first paths that do not lie on one before them, ``_CANDIDATES`` at most."""
    kept: list[tuple[Path, float]] = []
    for path in ranked:
        width = max(float(np.median(path.widths)), 0.5)
        if not any(max(width, broad) < _WIDER * min(width, broad)
                   and share_on(path.points, other.points, width) > _SAME for other, broad in kept):
            kept.append((path, width))
        if len(kept) == _CANDIDATES:
            break
    return [path for path, _ in kept]


def _with_continued(lab: Lab, strip: Strip) -> list[Strip]:
    """The line, and beside it the longer one with what continues it."""
    if not strip.widths.any() or evidence(strip) < _HOPELESS:
        return [strip]
    longer = continued(lab, strip)
    return [strip] if longer is strip else [strip, longer]


def _passes(points: Array, widths: Array, pixel: Array, within: float) -> bool:
    """Whether a line ``(n, 2)`` of widths ``(n,)`` covers a pixel, or comes ``within`` so much of it [px]."""
    begin, along = points[:-1], np.diff(points, axis=0)
    share = np.einsum("nd,nd->n", pixel - begin, along) / np.maximum(np.einsum("nd,nd->n", along, along), 1e-12)
    away = np.linalg.norm(begin + np.clip(share, 0.0, 1.0)[:, None] * along - pixel, axis=1)
    return bool(np.any(away < 0.25 * (widths[:-1] + widths[1:]) + within))
