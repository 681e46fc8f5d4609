"""Line detection in pictures from files, videos and cameras, and the page about it."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from ideal_robot.bounded_values import kept_words
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.file_limits import PICTURE_PIXELS
from scenes.report.page import Report
from sensing.camera.camera_device import Gray
from sensing.camera.picture_line import PictureLine

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm")


def pictures(source: str, *, every: int = 1, most: int = 100) -> Iterator[tuple[str, Gray]]:
    """Names and gray pictures ``(height, width)`` of a source, one after the other.

    Args:
        source: path of a picture, a folder of pictures or a video; number of a camera; or an ``rtsp://``, ``http://``
            address that OpenCV can open.
        every: takes one of so many frames of a video or stream.
        most: ends after so many pictures.

    Raises:
        InputError: nothing of that name, nothing readable in it, or a picture that is too large.
    """
    path = Path(source)
    if os.path.isdir(path):
        found = sorted(one for one in path.iterdir() if one.suffix.lower() in PICTURES)
        if not found:
            raise InputError(f"no pictures in this folder; expected files ending in {', '.join(PICTURES)}", file=path)
        for one in found[:most]:
            yield one.name, _read(one)
    elif path.suffix.lower() in PICTURES:
        if not os.path.isfile(path):
            raise InputError("no such picture", file=path)
        yield path.name, _read(path)
    else:
        yield from _frames(source, every, most)


def _read(path: Path) -> Gray:
    _check_header(path)
    try:
        with kept_words():
            gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    except cv2.error as error:
        raise InputError(f"not a readable picture ({' '.join(str(error).split())[:120]})", file=path) from error
    if gray is None:
        raise InputError("not a readable picture", file=path)
    return _checked(np.asarray(gray, dtype=np.uint8), str(path))


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
    except Exception:  # not a picture of a kind known here: OpenCV says what is wrong with it
        return
    _check_size(width, height, str(path))


def _frames(source: str, every: int, most: int) -> Iterator[tuple[str, Gray]]:
    address = "://" in source
    if not (source.isdigit() or address or os.path.isfile(source)):
        raise InputError("no such file or folder, nor the number of a camera or an address such as rtsp://…",
                         field="source", value=source)
    with kept_words():
        capture = cv2.VideoCapture(int(source) if source.isdigit() else source)
    try:
        if not capture.isOpened():
            raise InputError("no picture, and no video or camera that can be opened; give a PNG or JPEG, a folder "
                             "of them, a video, or a camera that is connected", field="source", value=source)
        index = taken = 0
        while taken < most:
            with kept_words():
                there, frame = capture.read()
            if not there:
                break
            if index % every == 0:
                gray = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
                yield f"frame {index}", _checked(np.asarray(gray, dtype=np.uint8), source)
                taken += 1
            index += 1
        if index == 0:
            raise InputError("no picture can be read from it", field="source", value=source)
    finally:
        capture.release()


def _checked(gray: Gray, name: str) -> Gray:
    _check_size(gray.shape[1], gray.shape[0], name)
    return gray


def _check_size(width: int, height: int, name: str) -> None:
    if width * height > PICTURE_PIXELS.most or min(width, height) < 32:
        raise InputError(f"a picture of {width} × {height} pixels; expected 32 × 32 to 64 megapixels; scale it",
                         field="source", value=name)


_USED, _REFUSED, _CURVE = (30, 160, 30), (40, 40, 220), (0, 106, 224)
_WIDEST = 900
"""Pictures on the page are no wider [px]."""
_SHOWN = 24
"""Pictures on the page at most."""


def figures(name: str, found: PictureLine) -> dict[str, Any]:
    """What was found in one picture, as plain values for JSON; lengths in pixels, angles in degrees.

    Args:
        name: of the picture.
        found: what the detector says.
    """
    points = []
    if found.field is not None:
        for pixel, sigma, quality, used in zip(found.field.pixels, found.field.sigma, found.field.quality,
                                               found.field.used, strict=True):
            points.append({"u": float(pixel[0]), "v": float(pixel[1]), "sigma": float(sigma),
                           "quality": float(quality), "used": bool(used)})
    rough, polynomial = found.rough, found.polynomial
    return {
        "picture": name, "size": list(found.size), "found": found.found, "reason": found.reason or None,
        "width_px": None if rough is None else rough.width,
        "polarity": None if rough is None else ("dark" if rough.dark else "bright"),
        "contrast_gray": None if rough is None else rough.contrast,
        "sigma_px": found.sigma,
        "order": None if polynomial is None else len(polynomial.coefficients) - 1,
        "residual_sigmas": None if polynomial is None else polynomial.residual,
        "points": points, "curve": found.curve(25).tolist(),
    }


def drawn(gray: Gray, found: PictureLine) -> bytes:
    """The picture as PNG with points (green used, red refused) and polynomial (orange).

    Args:
        gray: the picture ``(height, width)``.
        found: what the detector says of it.

    Raises:
        IdealRobotError: the picture cannot be encoded.
    """
    scale = min(_WIDEST / gray.shape[1], 3.0)
    image = cv2.cvtColor(cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR),
                         cv2.COLOR_GRAY2BGR)
    curve = found.curve(200)
    if len(curve):
        at = np.rint((curve + 0.5) * scale - 0.5).astype(np.int32)
        cv2.polylines(image, [at.reshape(-1, 1, 2)], False, _CURVE, 2, cv2.LINE_AA)
    if found.field is not None:
        for pixel, used in zip(found.field.pixels, found.field.used, strict=True):
            if np.isfinite(pixel).all():
                centre = (round((pixel[0] + 0.5) * scale - 0.5), round((pixel[1] + 0.5) * scale - 0.5))
                cv2.drawMarker(image, centre, _USED if used else _REFUSED,
                               cv2.MARKER_CROSS if used else cv2.MARKER_TILTED_CROSS, 16, 2, cv2.LINE_AA)
    done, data = cv2.imencode(".png", image)
    if not done:
        raise IdealRobotError("the picture could not be encoded as PNG")
    return bytes(data)


def detection_page(source: str, detector: str, results: list[tuple[str, Gray, PictureLine]]) -> Report:
    """The page about all pictures of a source.

    Args:
        source: where they came from.
        detector: key of the detector.
        results: name, picture ``(height, width)`` and finding of each.
    """
    count = sum(found.found for _, _, found in results)
    sigmas = [found.sigma for _, _, found in results if found.found]
    sure = f"; the line's middle is known to {np.median(sigmas):.2f} px (median standard deviation)" if sigmas else ""
    report = Report("Line detection", f"A line was found in {count} of {len(results)} pictures of {source}{sure}.")
    report.table(*table(results), caption=f"Detector {detector}. σ is the standard deviation of the polynomial across "
                                          "the line in its middle.")
    for name, gray, found in results[:_SHOWN]:
        said = found.reason if not found.found else f"σ = {found.sigma:.2f} px"
        report.image(drawn(gray, found), f"{name}: {said}. Green: points used; red: points refused; orange: the "
                                         "polynomial through the points used.")
    if len(results) > _SHOWN:
        report.text(f"The first {_SHOWN} of {len(results)} pictures are shown; all are in the JSON file.")
    return report


def table(results: list[tuple[str, Gray, PictureLine]]) -> tuple[list[str], list[list[Any]]]:
    """One row a picture.

    Args:
        results: name, picture ``(height, width)`` and finding of each.
    """
    rows: list[list[Any]] = []
    for name, _, found in results:
        used = 0 if found.field is None else int(found.field.used.sum())
        asked = 0 if found.field is None else len(found.field.used)
        rows.append([name, found.found, f"{used} of {asked}", None if found.rough is None else found.rough.width,
                     None if found.rough is None else ("dark" if found.rough.dark else "bright"),
                     None if found.polynomial is None else len(found.polynomial.coefficients) - 1,
                     found.sigma if found.found else None, found.reason])
    return ["picture", "found", "points used", "width [px]", "polarity", "order", "σ [px]", "why not"], rows
