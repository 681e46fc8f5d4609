"""Line detection in pictures from files, videos and cameras, and the page about it."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ideal_robot.bounded_values import PICTURE_PIXELS, kept_words
from ideal_robot.errors import IdealRobotError, InputError
from scenes.report.page import Report
from sensing.camera.line_evidence import Strip
from sensing.camera.line_track import track
from sensing.camera.picture_line import PictureLine, detect_in_picture
from sensing.camera.video_capture import camera_number

Picture = NDArray[np.uint8]
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm")


class Detected(NamedTuple):
    """Name, picture and detected line; in a film also the state of tracking, see ``Track.state``."""

    name: str
    picture: Picture
    found: PictureLine
    state: str | None = None


class Unreadable(NamedTuple):
    """Name of a file that is no readable picture, and the error."""

    name: str
    error: InputError


def pictures(source: str, *, every: int = 1, most: int = 100) -> Iterator[tuple[str, Picture | InputError]]:
    """Names and pictures, gray ``(height, width)`` or BGR ``(height, width, 3)``, of a source, one after the other.

    In a folder the error of a file that is not readable, or too large, comes in the place of its picture; else it is
    raised, as an InputError is for nothing of that name and for a folder without pictures.

    Args:
        source: path of a picture, a folder of pictures or a video; number of a camera; or an ``rtsp://``, ``http://``
            address that OpenCV can open.
        every: takes one of so many frames of a video or stream.
        most: ends after so many pictures.
    """
    path = Path(source)
    if os.path.isdir(path):
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURES)
        if not files:
            raise InputError(f"no pictures in this folder; expected files ending in {', '.join(PICTURES)}", file=path)
        for file in files[:most]:
            yield file.name, _read_or_error(file)
    elif path.suffix.lower() in PICTURES:
        yield path.name, read_picture(path)
    else:
        yield from _frames(source, every, most)


def detected(sources: Sequence[str], *, every: int, most: int, kind: str | None, near: tuple[float, float] | None,
             points: int) -> Iterator[Detected | Unreadable]:
    """The lines detected in each picture of all sources; in a film the line is tracked from picture to picture.

    Unreadable files give an ``Unreadable``; InputError where no file is readable.

    Args:
        sources: see ``pictures``.
        every, most: see ``pictures``; ``most`` of all sources together.
        kind, near, points: see ``detect_in_picture``; errors as of it.
    """
    count, first = 0, None
    for source in sources:
        # Pictures of a video, a camera or a stream follow each other.
        film = not os.path.isdir(source) and Path(source).suffix.lower() not in PICTURES
        last = None
        for name, picture in _of_one(source, every, most - count):
            if isinstance(picture, InputError):
                first = first or picture
                yield Unreadable(name, picture)
                continue
            count += 1
            if film:
                last = track(picture, last, kind=kind, near=near, points=points)
                yield Detected(name, picture, last.line, last.state)
            else:
                yield Detected(name, picture, detect_in_picture(picture, kind=kind, near=near, points=points))
        if count >= most:
            break
    if not count and first is not None:
        raise first


def _of_one(source: str, every: int, most: int) -> Iterator[tuple[str, Picture | InputError]]:
    """See ``pictures``. Its error in the place of a picture."""
    try:
        yield from pictures(source, every=every, most=most)
    except InputError as error:
        yield Path(source).name, error


def pixel(words: str) -> tuple[float, float]:
    """``320,240`` as two numbers; InputError for anything else."""
    try:
        u, v = (float(word) for word in words.split(","))
    except ValueError as error:
        raise InputError("expected a pixel as two numbers with a comma, e.g. 320,240", field="--near",
                         value=words) from error
    return u, v


def _read_or_error(path: Path) -> Picture | InputError:
    try:
        return read_picture(path)
    except InputError as error:
        return error


def read_picture(path: Path) -> Picture:
    """The picture of a file, gray or BGR; InputError where it is none, not readable or too large."""
    if not os.path.isfile(path):
        raise InputError("no such picture", file=path)
    _check_header(path)
    try:
        with kept_words():
            picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise InputError(f"not a readable picture ({' '.join(str(error).split())[:120]})", file=path) from error
    if picture is None:
        raise InputError("not a readable picture", file=path)
    return _checked(np.asarray(picture, dtype=np.uint8), str(path))


def _check_header(path: Path) -> None:
    """Refuses a picture whose header says that it is too large: unpacked, a small file may take gigabytes."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path) as header:
                width, height = header.size
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise InputError(f"larger than {PICTURE_PIXELS.most // 1_000_000} megapixels; make it smaller",
                         file=path) from error
    except Exception:  # not a known kind of picture: OpenCV reports the error
        return
    _check_size(width, height, str(path))


def _frames(source: str, every: int, most: int) -> Iterator[tuple[str, Picture]]:
    address = "://" in source
    camera = camera_number(source)
    if not (camera is not None or address or os.path.isfile(source)):
        raise InputError("no such file or folder, nor the number of a camera or an address such as rtsp://…",
                         field="source", value=source)
    with kept_words():
        capture = cv2.VideoCapture(source if camera is None else camera)
    try:
        if not capture.isOpened():
            raise InputError("no picture, and no video or camera that can be opened; give a PNG or JPEG, a folder "
                             "of them, a video, or a camera that is connected", field="source", value=source)
        index = count = 0
        while count < most:
            with kept_words():
                ok, frame = capture.read()
            if not ok:
                break
            if index % every == 0:
                yield f"frame {index}", _checked(np.asarray(frame, dtype=np.uint8), source)
                count += 1
            index += 1
        if index == 0:
            raise InputError("no picture can be read from it", field="source", value=source)
    finally:
        capture.release()


def _checked(picture: Picture, name: str) -> Picture:
    _check_size(picture.shape[1], picture.shape[0], name)
    return picture


def _check_size(width: int, height: int, name: str) -> None:
    if width * height > PICTURE_PIXELS.most or min(width, height) < 32:
        raise InputError(f"a picture of {width} × {height} pixels; expected 32 × 32 to 64 megapixels; scale it",
                         field="source", value=name)


_SURE, _UNSURE, _EDGE = (30, 160, 30), (40, 40, 220), (0, 106, 224)  # blue, green, red
_WIDEST = 900
"""Pictures on the page are no wider [px]."""
_SHOWN = 24
"""Pictures on the page at most."""
_CONFIDENT = 0.5
"""Share of the line's usual contrast from which on a point is drawn as sure."""


def figures(one: Detected | Unreadable) -> dict[str, Any]:
    """A detected line as plain values for JSON; lengths in pixels."""
    if isinstance(one, Unreadable):
        return {"picture": one.name, "found": False, "reason": str(one.error), "points": [], "pieces": [],
                "breaks": []}
    line = one.found
    return {"picture": one.name, "state": one.state, "size": list(line.size), "found": line.found,
            "probability": line.probability, "reason": line.reason or None,
            "width_px": line.width, "polarity": ("dark" if line.dark else "bright") if line.found else None,
            "contrast_gray": line.contrast, "sigma_px": line.sigma, "log_odds": line.evidence,
            "others": line.others, "points": [] if line.strip is None else _points(line.strip),
            "curve": line.curve.tolist(),
            "pieces": [_points(piece.thinned(len(line.points))) for piece in line.pieces],
            "breaks": [{"from": end.tolist(), "to": begin.tolist()} for end, begin in line.breaks]}


def _points(strip: Strip) -> list[dict[str, float]]:
    return [{"u": float(u), "v": float(v), "width": float(width), "sigma": float(sigma), "confidence": float(sure)}
            for (u, v), width, sigma, sure in zip(strip.points, strip.widths, strip.sigmas, strip.confidence,
                                                  strict=True)]


def drawn(picture: Picture, found: PictureLine) -> bytes:
    """The picture, gray or BGR, as PNG with the line's edges (orange) and points (green, red where it hardly shows).

    All segments are drawn, with an arrow over each gap.
    """
    scale = min(_WIDEST / picture.shape[1], 3.0)
    image = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    for piece in found.pieces:
        half = 0.5 * piece.widths[:, None] * piece.normals
        for side in (-half, half):
            edge = np.rint((piece.points + side + 0.5) * scale - 0.5).astype(np.int32)
            cv2.polylines(image, [edge.reshape(-1, 1, 2)], False, _EDGE, 2, cv2.LINE_AA)
        few = piece.thinned(len(found.points))
        for (u, v), sure in zip((few.points + 0.5) * scale - 0.5, few.confidence, strict=True):
            cv2.drawMarker(image, (round(u), round(v)), _SURE if sure >= _CONFIDENT else _UNSURE,
                           cv2.MARKER_CROSS if sure >= _CONFIDENT else cv2.MARKER_TILTED_CROSS, 16, 2, cv2.LINE_AA)
    for ends in found.breaks:
        end, begin = (tuple(np.rint((place + 0.5) * scale - 0.5).astype(int).tolist()) for place in ends)
        cv2.arrowedLine(image, end, begin, _UNSURE, 2, cv2.LINE_AA)
    done, data = cv2.imencode(".png", image)
    if not done:
        raise IdealRobotError("the picture could not be encoded as PNG")
    return bytes(data)


def detection_page(sources: Sequence[str], kind: str | None, results: Sequence[Detected | Unreadable]) -> Report:
    """The page about all pictures of all sources.

    Args:
        sources, kind: the pictures' sources, and the kind of line.
        results: of each picture.
    """
    shown = [result for result in results if isinstance(result, Detected)]
    count = sum(result.found.found for result in shown)
    sigmas = [result.found.sigma for result in shown if result.found.found]
    unreadable = len(results) - len(shown)
    sure = f"; its points are known to {np.median(sigmas):.2f} px (median standard deviation)" if sigmas else ""
    report = Report("Line detection", f"A {kind or 'line'} was found in {count} of {len(shown)} pictures, from "
                                      f"{', '.join(sources)}{sure}."
                                      + f" {unreadable} could not be read." * bool(unreadable))
    # Pictures with a line come first; a film keeps its order in time.
    if not any(result.state for result in shown):
        shown.sort(key=lambda one: not one.found.found)
    report.next(*next_steps(sources[0], count))
    for name, picture, line, state in shown[:_SHOWN]:
        notes = [state] * bool(state) + [f"σ = {line.sigma:.2f} px" if line.found else line.reason]
        breaks = ""
        if line.breaks:
            notes.append(f"{len(line.pieces)} pieces")
            breaks = "; arrows: where it breaks"
        colours = f" Orange: edges of the line; green: points; red: points where it hardly shows{breaks}."
        report.image(drawn(picture, line), f"{name}: {', '.join(map(str, notes))}." + colours * bool(len(line.points)))
    if len(shown) > _SHOWN:
        report.text(f"The first {_SHOWN} of {len(shown)} pictures are shown; all are in the JSON file.")
    report.heading("All pictures", folded=count == len(results))
    report.table(*table(results), caption="Probability: that what was found, or is most like a line, is one. Pieces: "
                                          "of the line, where it breaks. σ: standard deviation of a point across it.")
    return report


def next_steps(source: str, found: int) -> list[tuple[str, str]]:
    """The next steps that a report proposes, each a sentence and its command.

    Args:
        source: the first picture or folder searched.
        found: number of pictures with a line.
    """
    if found:
        return [("Calibrate the camera, from pictures of a checkerboard.",
                 "ideal-robot calibrate poses.csv --board 9x6 --square 20"),
                ("Write a scene of your own line.", "ideal-robot new my_line --robot my_arm.urdf")]
    return [("Say where the line is in the picture, as a pixel on it.",
             f"ideal-robot detect {source} --near 320,240")]


def table(results: Sequence[Detected | Unreadable]) -> tuple[list[str], list[list[Any]]]:
    """The detections as a table: titles, and one row per picture."""
    return ["picture", "found", "probability", "width [px]", "polarity", "contrast", "σ [px]", "pieces", "other lines",
            "why not"], list(map(_row, results))


def _row(result: Detected | Unreadable) -> list[Any]:
    if isinstance(result, Unreadable):
        return [result.name, "not readable", *[None] * 7, str(result.error)]
    name, _, line, state = result
    return [name, state or line.found, line.probability,
            *([line.width, "dark" if line.dark else "bright", line.contrast, line.sigma, len(line.pieces), line.others,
               None] if line.found else [None] * 6 + [line.reason])]
