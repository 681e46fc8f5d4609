"""Paths through a whole picture along which something lies between two edges, or along which there is one edge.

A picture is reduced to vectors of lightness and colour. In columns across a path, places where the vector changes most
are edges. Two of them, of any distance, are a pair where what lies between differs from the left and the right side in
like manner: with d_l and d_r, inside less left and less right,

    contrast = d_l · d_r / max(|d_l|, |d_r|)

is nothing at a single edge and negative on a slope. Dynamic programming links pairs of neighbouring columns: the score
of a link is the logarithm of how much likelier places, widths and colours of two pairs are if they belong to one line
than if they have nothing to do with each other. Long paths of that score are not chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit

Lab = NDArray[np.uint8]
Floats = NDArray[np.float32]
Integers = NDArray[np.int64]

REDUCED = (320, 128)
"""Longer sides of the reduced pictures [px]: fine lines, and wide or blurred ones."""
COLUMNS = 80
"""Columns across a path that are looked at."""
COLOR = np.array([1.0, 2.0, 2.0])
"""Weights of Lab in 8 bits: there lightness goes to 255, and in Lab itself to 100, a and b are the same in both."""
_EDGES, _PAIRS = 28, 48
"""Edges and pairs that are kept in a column."""
_MOST = 8
"""Paths of either direction and scale at most."""
_LEAST = 4.0
"""Contrast below which nothing is looked at [gray]."""
_GAP = 4
"""Columns that a link may leap over."""
# Columns of a pair of edges; three each for contrast and inside, one per colour.
_CENTRE, _WIDTH, _CONTRAST, _INSIDE, _CLEAR, _FIELDS = 0, 1, 2, 5, 8, 9


@dataclass(frozen=True)
class Path:
    """A path in a picture.

    Attributes:
        points: pixels along it ``(n, 2)``.
        widths: across it ``(n,)`` [px]; 0 at an edge.
        score: logarithm of how much likelier the path is than chance.
    """

    points: Array
    widths: Array
    score: float


def lab_picture(picture: NDArray[np.uint8]) -> Lab:
    """Lightness and colour ``(height, width, 3)`` of a gray or BGR picture, as OpenCV has Lab in 8 bits."""
    if picture.ndim == 3:
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2LAB), dtype=np.uint8)
    lab = np.full((*picture.shape, 3), 128, np.uint8)
    lab[..., 0] = picture
    return lab


def paths(lab: Lab, *, widest: float, through: Array | None = None, within: float = 0.0) -> list[Path]:
    """Paths with the highest scores, along the columns and along the rows of a picture.

    With a pixel to pass through, only paths through it are searched in the columns about it, however weak they are.

    Args:
        lab: of ``lab_picture``.
        widest: of the lines, as a share of the picture's shorter side; 0 for single edges in the place of pairs.
        through: pixel ``(2,)`` that they pass; anywhere if None.
        within: largest distance from it, in addition to half their width [px].
    """
    height, width = lab.shape[:2]
    edges = widest == 0.0
    candidates: list[Path] = []
    for reduced in REDUCED:
        scale = max(1.0, max(height, width) / reduced)
        for along in (0, 1):
            across_size, along_size = (height, width) if along == 0 else (width, height)
            size = (max(8, round(along_size / scale / 2)), max(8, round(across_size / scale)))
            small = cv2.resize(lab, size if along == 0 else size[::-1], interpolation=cv2.INTER_AREA)
            # Columns of the path first, then rows across it.
            small = small.transpose(1, 2, 0) if along == 0 else small.transpose(0, 2, 1)
            every = max(1, round(size[0] / COLUMNS))
            small = small[every // 2 :: every].astype(np.float32) * COLOR.astype(np.float32)[:, None]
            spacing = every * along_size / size[0] / (across_size / size[1])
            nodes, counts = _nodes(small, edges, widest * min(height, width) / scale)
            if through is not None:
                column = ((through[along] + 0.5) * size[0] / along_size - 0.5 - every // 2) / every
                row = (through[1 - along] + 0.5) * size[1] / across_size - 0.5
                # A link may leap over this many columns, so a weak pixel to pass through would otherwise be leapt over.
                for i in range(max(0, round(column) - _GAP // 2), min(len(nodes), round(column) + _GAP // 2 + 1)):
                    node = nodes[i, : counts[i]]
                    reach = within * size[1] / across_size + 0.5 * spacing * _GAP
                    reach += 0.0 if edges else 0.5 * np.exp(node[:, _WIDTH])
                    good = node[np.abs(node[:, _CENTRE] - row) < reach]
                    nodes[i, : len(good)], counts[i] = good, len(good)
            sums, came = _linked(nodes, counts, spacing)
            taken = np.zeros(sums.shape, np.bool_)
            for _ in range(_MOST):
                place, score = _traced(nodes, counts, sums, came, taken)
                if len(place) < 4:
                    continue
                node = nodes[place[:, 0], place[:, 1]]
                a = (place[:, 0] * every + every // 2 + 0.5) * along_size / size[0] - 0.5
                b = (node[:, _CENTRE] + 0.5) * across_size / size[1] - 0.5
                candidates.append(Path(np.column_stack([a, b] if along == 0 else [b, a]).astype(float),
                                       np.exp(node[:, _WIDTH].astype(float)) * across_size / size[1] if not edges
                                       else np.zeros(len(a)), float(score)))
    return candidates


@jit(fastmath=True)
def _edges(column: Floats, place: Array, strength: Array) -> int:
    """The strongest changes of ``column (3, rows)``; their places with fractions, in order. Returns how many."""
    rows = column.shape[1]
    change = np.zeros(rows)
    for j in range(1, rows - 1):
        for c in range(3):
            low, high = max(j - 2, 0), min(j + 2, rows - 1)
            d = 0.3 * (column[c, j + 1] - column[c, j - 1]) + 0.1 * (column[c, high] - column[c, low])
            change[j] += d * d
        change[j] = math.sqrt(change[j])
    n = 0
    for j in range(1, rows - 1):
        s = change[j]
        if s < 0.25 * _LEAST or s < change[j - 1] or s <= change[j + 1]:
            continue
        bend = change[j - 1] - 2.0 * s + change[j + 1]
        peak = j + (0.5 * (change[j - 1] - change[j + 1]) / bend if bend < 0.0 else 0.0)
        if n < place.size:
            place[n], strength[n] = peak, s
            n += 1
            continue
        weakest = 0
        for m in range(1, n):
            if strength[m] < strength[weakest]:
                weakest = m
        if strength[weakest] < s:
            for m in range(weakest, n - 1):
                place[m], strength[m] = place[m + 1], strength[m + 1]
            place[n - 1], strength[n - 1] = peak, s
    return n


@jit(fastmath=True)
def _nodes(columns: Floats, single: bool, widest: float) -> tuple[Floats, Integers]:
    """Pairs of edges, or edges, of ``columns (n, 3, rows)`` in order ``(n, pairs, fields)``, and how many ``(n,)``."""
    count, _, rows = columns.shape
    nodes = np.zeros((count, _PAIRS, _FIELDS), np.float32)
    counts = np.zeros(count, np.int64)
    place, strength = np.empty(_EDGES), np.empty(_EDGES)
    total = np.zeros((rows + 1, 3))
    square = np.zeros(rows + 1)
    node = np.empty(_FIELDS, np.float32)
    for i in range(count):
        for j in range(rows):
            square[j + 1] = square[j]
            for c in range(3):
                total[j + 1, c] = total[j, c] + columns[i, c, j]
                square[j + 1] += columns[i, c, j] ** 2
        n = _edges(columns[i], place, strength)
        for p in range(n):
            for q in range(p + (0 if single else 1), p + 1 if single else n):
                fits = single or 1.0 <= place[q] - place[p] <= widest
                if fits and _compared(total, square, place[p], place[q], node):
                    counts[i] = _kept(nodes[i], counts[i], node)
        _sorted(nodes[i], counts[i])
    return nodes, counts


@jit(fastmath=True)
def _compared(total: Array, square: Array, first: float, last: float, node: Floats) -> bool:
    """Whether the edges at ``first`` and ``last`` [px], or one if they are the same, have enough contrast.

    ``total (rows + 1, 3)`` and ``square (rows + 1,)`` are sums of the column and its squares; ``one`` gets the fields.
    """
    rows = square.size - 1
    w, single = last - first, first == last
    side = 5.0 if single else max(1.0, min(0.5 * w, 8.0))
    b0, b1 = int(max(first - 0.2 - side, 0.0)), int(first)
    c0, c1 = int(last + 2.0), min(int(last + 2.2 + side), rows)
    b1, c0 = max(b1, b0 + 1), min(c0, c1 - 1)
    a0, a1 = (c0, c1) if single else (int(first + 0.2 * w + 0.8), int(last - 0.2 * w + 1.2))
    if a1 <= a0:
        a0 = min(int(0.5 * (first + last) + 0.5), rows - 1)
        a1 = a0 + 1
    of_a, of_b, of_c = 1.0 / (a1 - a0), 1.0 / (b1 - b0), 1.0 / (c1 - c0)
    ll = rr = lr = spread_a = spread_b = spread_c = 0.0
    for c in range(3):
        left = (total[b1, c] - total[b0, c]) * of_b
        right = (total[c1, c] - total[c0, c]) * of_c
        inside = (total[a1, c] - total[a0, c]) * of_a
        dl = inside - left
        dr = dl if single else inside - right
        ll += dl * dl
        rr += dr * dr
        lr += dl * dr
        spread_a += inside * inside
        spread_b += left * left
        spread_c += right * right
        node[_CONTRAST + c] = 0.5 * (dl + dr)
        node[_INSIDE + c] = inside
    contrast = lr / (math.sqrt(max(ll, rr)) + 1e-3)
    if contrast < _LEAST:
        return False
    spread = math.sqrt(max((square[b1] - square[b0]) * of_b - spread_b, 0.0))
    spread += math.sqrt(max((square[c1] - square[c0]) * of_c - spread_c, 0.0))
    spread += 2.0 * math.sqrt(max((square[a1] - square[a0]) * of_a - spread_a, 0.0))
    node[_CENTRE], node[_WIDTH] = 0.5 * (first + last), 0.0 if single else math.log(w)
    node[_CLEAR] = contrast / (0.25 * spread + 2.0)
    return True


@jit()
def _kept(nodes: Floats, count: int, one: Floats) -> int:
    """Adds a pair, in the place of the least clear one where there are too many."""
    place = count
    if count == nodes.shape[0]:
        place = 0
        for m in range(1, count):
            if nodes[m, _CLEAR] < nodes[place, _CLEAR]:
                place = m
        if nodes[place, _CLEAR] >= one[_CLEAR]:
            return count
    for f in range(_FIELDS):
        nodes[place, f] = one[f]
    return max(count, place + 1)


@jit()
def _sorted(nodes: Floats, count: int) -> None:
    """Puts the first pairs in the order of their centres; they are few, and nearly in order."""
    for m in range(1, count):
        for c in range(m, 0, -1):
            if nodes[c - 1, _CENTRE] <= nodes[c, _CENTRE]:
                break
            for f in range(_FIELDS):
                nodes[c - 1, f], nodes[c, f] = nodes[c, f], nodes[c - 1, f]


@jit(fastmath=True)
def _linked(nodes: Floats, counts: Integers, spacing: float) -> tuple[Array, Integers]:
    """Greatest scores of paths that end at each node, and where each came from, column and node (-1: it begins)."""
    count = nodes.shape[0]
    sums = np.zeros((count, _PAIRS))
    slopes = np.zeros((count, _PAIRS))
    came = np.full((count, _PAIRS, 2), -1, np.int64)
    reach = 1.3 * spacing
    for i in range(count):
        for p in range(counts[i]):
            centre, width = nodes[i, p, _CENTRE], nodes[i, p, _WIDTH]
            wide = math.exp(width)
            own = min(math.log(nodes[i, p, _CLEAR] + 1e-3), 1.5) - 1.0
            best = 0.0
            for gap in range(1, min(i, _GAP) + 1):
                h = i - gap
                most = own + 3.0 - 1.5 * (gap - 1)
                sigma = 0.6 + 0.05 * wide + 0.1 * spacing * gap
                spread = 0.08 * gap + 0.8 / wide
                for q in range(counts[h]):
                    move = centre - nodes[h, q, _CENTRE]
                    if move < -reach * gap:
                        break
                    # Differences only lower the score, so links whose upper bound is too low are skipped.
                    if move > reach * gap or sums[h, q] + most <= best:
                        continue
                    off = (move - slopes[h, q] * gap) / sigma
                    broad = (width - nodes[h, q, _WIDTH]) / spread
                    gain = most - 0.5 * (off * off + broad * broad)
                    if sums[h, q] + gain <= best:
                        continue
                    size = change = 0.0
                    for c in range(_CONTRAST, _INSIDE):
                        size += nodes[i, p, c] ** 2 + nodes[h, q, c] ** 2
                    for c in range(_CONTRAST, _CLEAR):
                        change += (nodes[i, p, c] - nodes[h, q, c]) ** 2
                    gain -= 0.5 * change / (0.02 * size + 20.0)
                    if sums[h, q] + gain > best:
                        best = sums[h, q] + gain
                        came[i, p, 0], came[i, p, 1] = h, q
                        slopes[i, p] = move / gap if came[h, q, 0] < 0 else 0.6 * slopes[h, q] + 0.4 * move / gap
            sums[i, p] = best
    return sums, came


@jit()
def _traced(nodes: Floats, counts: Integers, sums: Array, came: Integers, taken: NDArray[np.bool_]
            ) -> tuple[Integers, float]:
    """The path of nodes that are not taken that scores most, column and node from first to last ``(n, 2)``.

    It is taken then, and what lies beside it. A path that branches off from one that is taken begins at the branch.
    """
    count = nodes.shape[0]
    begins = np.zeros(sums.shape)
    top, i, p = 0.0, -1, 0
    for a in range(count):
        for b in range(counts[a]):
            h, q = came[a, b, 0], came[a, b, 1]
            if h >= 0:
                begins[a, b] = sums[h, q] if taken[h, q] else begins[h, q]
            if sums[a, b] - begins[a, b] > top and not taken[a, b]:
                top, i, p = sums[a, b] - begins[a, b], a, b
    place = np.empty((count, 2), np.int64)
    n = count
    while i >= 0 and not taken[i, p]:
        n -= 1
        place[n, 0], place[n, 1] = i, p
        i, p = came[i, p, 0], came[i, p, 1]
    path = place[n:]
    for m in range(len(path)):
        a = path[m, 0]
        node = nodes[a, path[m, 1]]
        for b in range(counts[a]):
            near = abs(nodes[a, b, _CENTRE] - node[_CENTRE]) < max(1.5, 0.5 * math.exp(node[_WIDTH]))
            if near and abs(nodes[a, b, _WIDTH] - node[_WIDTH]) < 0.7:
                taken[a, b] = True
    return path, top
