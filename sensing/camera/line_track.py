"""Tracks a line from picture to picture of a film by its place and its appearance in the picture before.

The line is looked for where it was, moved on as it moved; then in the whole picture, where distance from that place and
an unlike look count against a candidate. Only when it has been lost for long another line is taken, and that is said.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from sensing.camera.line_evidence import Strip, evidence, straightened
from sensing.camera.line_paths import Path, lab_picture
from sensing.camera.picture_line import (
    EXPECTED,
    Likeliest,
    PictureLine,
    check_asked,
    find_lines,
    likeliest,
    measured,
    reduced,
)

PATIENCE = 10
"""Pictures without the line until another one is taken."""
_MOVES = 0.08
"""Standard deviation of its motion from picture to picture, as a share of the picture's shorter side."""
_LONGER = 0.15
"""Share of its length by which it is looked for beyond its ends."""
_TONE, _WIDTH = 0.35, 0.25
"""Standard deviations of its colour, as a share of its contrast, and of the logarithm of its width."""
_ALIKE = -float(np.log(_TONE**3 * _WIDTH))
"""How much likelier the line has its three colours and its width than chance, whose deviations are 1, as a logarithm:
that it is a line was decided when it was found."""


@dataclass(frozen=True)
class Track:
    """State of a line that is tracked through a film.

    Attributes:
        line: in the last picture.
        state: ``found``, ``followed``, ``lost``, ``found again`` or ``another line``.
        known: the line as last seen, in the reduced picture; None before it was found.
        motion: of its points from picture to picture ``(2,)`` [px of the reduced picture].
        missed: pictures since it was seen.
    """

    line: PictureLine
    state: str
    known: Strip | None
    motion: Array
    missed: int = 0


def track(picture: NDArray[np.uint8], before: Track | None = None, *, kind: str | None = None,
          near: tuple[float, float] | None = None, points: int = 15) -> Track:
    """The line in the next picture of a film; raises as ``detect_in_picture``.

    Args:
        picture: gray or BGR, all of one size.
        before: of the picture before; None in the first one.
        kind: see ``detect_in_picture``.
        near: see ``detect_in_picture``; used until a line is found.
        points: along the line.
    """
    check_asked(picture, kind, points)
    small, scale = reduced(picture)
    known = None if before is None else before.known
    missed = 0 if before is None else before.missed
    again = None
    if before is not None and known is not None and missed < PATIENCE:
        place = known.points + before.motion
        again = _there(small, known, place, kind)
        # The prior alone does not keep the line at a place that is unlikely to show one: another candidate may win.
        if again is None or again[0] < 0.0:
            again = _elsewhere(small, known, place, kind, missed, again)
        if again is None:
            line = measured(picture, Likeliest([], -np.inf, 0, f"lost for {missed + 1} pictures"), scale, points)
            return Track(line, "lost", known, np.zeros(2), missed + 1)
    if again is not None and known is not None:
        value, strip = again
        line = measured(picture, Likeliest([strip], value, 0, ""), scale, points)
        return Track(line, "found again" if missed else "followed", strip,
                     np.zeros(2) if missed else _motion(known, strip))
    best = likeliest(small, kind, None if near is None or known is not None else (np.array(near) + 0.5) * scale - 0.5)
    line = measured(picture, best, scale, points)
    if not best.strips:
        return Track(line, "lost", known, np.zeros(2), missed + 1)
    return Track(line, "found" if known is None else "another line", best.strips[0], np.zeros(2))


def _there(picture: NDArray[np.uint8], known: Strip, place: Array, kind: str | None) -> tuple[float, Strip] | None:
    """The line about the place where it is expected, with its log odds; None where it does not show there."""
    count = max(2, round(_LONGER * len(place)))
    step = np.arange(1, count + 1)[:, None]
    first = place[0] + step[::-1] * (place[0] - place[4]) / 4.0
    last = place[-1] + step * (place[-1] - place[-5]) / 4.0
    points = np.concatenate([first, place, last])
    inside = (points >= 0.0).all(axis=1) & (points <= [picture.shape[1] - 1, picture.shape[0] - 1]).all(axis=1)
    if inside.sum() < len(place) // 2:
        return None
    widths = np.pad(known.widths, count, "edge")[inside]
    strip = straightened(lab_picture(picture), Path(points[inside], widths, 0.0), sections=len(place))
    value = evidence(strip, joint=kind == "seam")
    return (value, strip) if _same(value, strip, known) > 0.0 else None


def _elsewhere(picture: NDArray[np.uint8], known: Strip, place: Array, kind: str | None, missed: int,
               there: tuple[float, Strip] | None) -> tuple[float, Strip] | None:
    """The candidate of the whole picture, or the one at its place, that is likeliest the same line; None where none."""
    moves = _MOVES * min(picture.shape[:2]) * np.sqrt(1.0 + missed)
    lines = [(_same(value, strip, known) - 0.5 * (_distance(strip, place) / moves) ** 2, value, strip)
             for value, strip in [*find_lines(picture, kind=kind, about=place), *([there] if there else [])]]
    best = max(lines, key=lambda candidate: candidate[0], default=None)
    return best[1:] if best is not None and best[0] > 0.0 else None


def _same(value: float, strip: Strip, known: Strip) -> float:
    """Log odds that a line is the one that is known, wherever it lies; being surely a line does not make it that."""
    tone = float(np.linalg.norm(strip.color - known.color) / np.linalg.norm(known.color))
    wider = float(np.log((np.median(strip.widths) + 1.0) / (np.median(known.widths) + 1.0)))
    return min(value + _ALIKE, 0.0) + EXPECTED - 0.5 * ((tone / _TONE) ** 2 + (wider / _WIDTH) ** 2)


def _distance(strip: Strip, place: Array) -> float:
    """Median distance of a line's points from a place [px]."""
    return float(np.median(np.linalg.norm(strip.points[:, None] - place, axis=2).min(axis=1)))


def _motion(known: Strip, strip: Strip) -> Array:
    """How far a line has moved across itself, the median of its points ``(2,)`` [px]."""
    nearest = np.linalg.norm(known.points[:, None] - strip.points, axis=2).argmin(axis=1)
    across = np.einsum("nd,nd->n", strip.points[nearest] - known.points, known.normals)
    return np.asarray(np.median(across[:, None] * known.normals, axis=0))
