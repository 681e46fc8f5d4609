"""A line in several pieces: where it steps aside, breaks and goes on.

A stripe of light over a joint, a groove or a box, a road's dashes. A path leaps over a step, so it is cut there; what
looks like the line and lies beyond one of its ends is a further piece of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from ideal_robot.arrays import Array
from sensing.camera.line_evidence import Strip, straightened
from sensing.camera.line_growth import continued
from sensing.camera.line_paths import Lab, Path

_TONE, _WIDTH = 0.75, 0.5
"""Pieces of one line differ in colour by less than this share of the contrast (it lies on several grounds), and in the
logarithm of their width by less than that."""
_OVERLAP = 0.25
"""Share of the shorter one by which two pieces may lie beside each other: more, and they are two lines."""
_TRIED = 4
"""Paths that are straightened in search of further pieces: each is looked at in the time of a candidate."""
_ACROSS = 6
"""Sections before and after a place whose courses are compared."""
_STEP = (1.0, 4.0)
"""A course steps where it goes on aside by more than so many widths and so many pixels …"""
_CORNER, _NEAR, _FAR = float(np.radians(30.0)), 3, 6
"""A corner is a turn within so many sections before and behind; it is compared with the turns as many further away."""
_PARALLEL = float(np.cos(np.radians(25.0)))
"""… in about the same direction: where that changes it is a corner, and the line goes on."""


def further_pieces(lab: Lab, parts: Sequence[Strip], paths: Iterable[Path]) -> list[Strip]:
    """Further segments of a line: paths in the picture that have its width and its appearance.

    Args:
        lab: of ``lab_picture``.
        parts: of the line, one at least.
        paths: candidates, of ``line_paths.paths``; a path within the line's width may be a part of it, such as the core
            of a stripe of light.
    """
    width = float(np.median(parts[0].widths))
    pieces: list[Strip] = []
    tried = 0
    for path in paths:
        known = (*parts, *pieces)
        if tried == _TRIED:
            break
        if not all(_beyond(one.points, path.points, width)
                   and share_on(path.points, one.points, float(np.median(one.widths))) < 0.5 for one in known):
            continue
        tried += 1
        piece = straightened(lab, Path(path.points, np.full(len(path.points), width), 0.0))
        if all(_alike(one, piece) for one in known):
            piece = continued(lab, piece, 1.0)
            if all(_beyond(one.points, piece.points, width) and apart(piece, one) for one in known):
                pieces.append(piece)
    return pieces


def _alike(one: Strip, other: Strip) -> bool:
    """Whether two pieces look like one line."""
    tone = float(np.linalg.norm(one.color - other.color) / max(np.linalg.norm(one.color), np.linalg.norm(other.color)))
    wider = abs(float(np.log((np.median(one.widths) + 1.0) / (np.median(other.widths) + 1.0))))
    return tone < _TONE and wider < _WIDTH


def _beyond(points: Array, others: Array, width: float) -> bool:
    """Whether other points ``(m, 2)`` lie beyond an end of a line's ``(n, 2)``, not beside it."""
    chord = points[-1] - points[0]
    along = chord / max(float(np.linalg.norm(chord)), 1e-9)
    (a, b), (c, d) = (np.sort((of @ along)[[0, -1]]) for of in (points, others))
    return bool(min(b, d) - max(a, c) - width < _OVERLAP * min(b - a, d - c))


def apart(one: Strip, other: Strip) -> bool:
    """Whether less than half of a line's points lie on another line."""
    return share_on(one.points, other.points, float(np.median(other.widths))) < 0.5


def share_on(points: Array, others: Array, width: float) -> float:
    """Share of points that lie on a line.

    Args:
        points: ``(n, 2)`` [px].
        others: points of the line ``(m, 2)`` [px].
        width: of the line [px].
    """
    distance = ((points[:, None] - others) ** 2).sum(axis=2).min(axis=1)
    return float(np.mean(distance <= max(2.0, 0.5 * width) ** 2))


def broken_at_steps(lab: Lab, strip: Strip) -> list[Strip]:
    """Segments of a line, cut where its path crosses a step, the longest first; the line itself without a step.

    Args:
        lab: of ``lab_picture``, of the picture in which it was found.
        strip: the line.
    """
    cuts = _steps(strip)
    if not cuts:
        return [strip]
    width = float(np.median(strip.widths))
    parts: list[Strip] = []
    for first, last in pairwise([-2, *cuts, len(strip.points) + 1]):
        points = strip.points[first + 2 : last - 1]
        if len(points) >= _ACROSS:
            parts.append(continued(lab, straightened(lab, Path(points, np.full(len(points), width), 0.0)), 1.0))
    distinct: list[Strip] = []
    for part in sorted(parts, key=lambda part: -part.length):
        # A sharp corner is no step: it is followed round from both sides, and the copies are dropped.
        if all(apart(part, other) for other in distinct):
            distinct.append(part)
    return distinct


def _steps(strip: Strip) -> list[int]:
    """Sections at which the course goes on aside, in order."""
    points = strip.points
    inner = np.arange(_ACROSS, len(points) - _ACROSS)
    before, after = ([points[inner + k] for k in steps]
                     for steps in (range(-_ACROSS, -1), range(2, _ACROSS + 1)))
    u, v = (way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
            for way in (before[-1] - before[0], after[-1] - after[0]))
    # On an arc the chord between the middles of both halves points between both directions.
    between, way = u + v, np.mean(after, axis=0) - np.mean(before, axis=0)
    aside = np.abs(between[:, 0] * way[:, 1] - between[:, 1] * way[:, 0]) / np.maximum(
        np.linalg.norm(between, axis=1), 1e-9)
    aside[np.sum(u * v, axis=1) <= _PARALLEL] = 0.0
    cuts: list[int] = []
    for k in np.argsort(-aside):
        if aside[k] < max(_STEP[0] * float(np.median(strip.widths)), _STEP[1]):
            break
        if all(abs(int(inner[k]) - cut) > 2 * _ACROSS for cut in cuts):
            cuts.append(int(inner[k]))
    return sorted(cuts)


def smooth_pieces(strip: Strip) -> list[Strip]:
    """Smooth segments of a line that is cut at its corners, in order; a bend is no corner, however far it turns."""
    cuts = _corners(strip.points)
    return [strip.part(first, last + 1) for first, last in pairwise([0, *cuts, len(strip.points) - 1])]


def _corners(points: Array) -> list[int]:
    """Sections at which a course turns by more than ``_CORNER``, twice as much as in those before and after."""
    way = np.diff(points, axis=0)
    course = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    course = np.pad(course, _FAR, "edge")
    k = np.arange(1, len(points) - 1)
    # The direction before section k is at index k + _FAR - 1, the one behind it at k + _FAR.
    outer, inner, behind, beyond = (course[k + _FAR + step]
                                    for step in (-_FAR, -_NEAR, _NEAR - 1, _FAR - 1))
    turn, beside = np.abs(behind - inner), np.abs(inner - outer) + np.abs(beyond - behind)
    turn[turn < np.maximum(_CORNER, 2.0 * beside)] = 0.0
    cuts: list[int] = []
    for i in np.argsort(-turn):
        if turn[i] == 0.0:
            break
        if all(abs(int(k[i]) - cut) > _NEAR for cut in cuts):
            cuts.append(int(k[i]))
    return sorted(cuts)


def in_order(pieces: Sequence[Strip]) -> tuple[Strip, ...]:
    """Segments of a line in their order along it: each is joined to the end that is nearest, from the first one on."""
    chain, rest = [pieces[0]], list(pieces[1:])
    while rest:
        begin, end = chain[0].points[0], chain[-1].points[-1]
        joins = [(float(np.linalg.norm(strip.points[k] - place)), i, k, behind)
                 for i, strip in enumerate(rest) for k in (0, -1) for behind, place in ((False, begin), (True, end))]
        _, i, k, behind = min(joins)
        piece = rest.pop(i)
        # A piece that joins the end runs away from it, and one that joins the beginning towards it.
        turned = piece if (k == 0) == behind else piece.reversed()
        chain.insert(len(chain) if behind else 0, turned)
    return tuple(chain)
