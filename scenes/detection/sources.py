"""Pictures from where a user has them: a file, a folder, a video, a camera or the address of a stream."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from ideal_robot.captured_stderr import kept_words
from ideal_robot.errors import InputError
from sensing.camera.field import Gray

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm")
MAX_PIXELS = 64_000_000
"""A larger picture is refused."""


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
        raise InputError(f"larger than {MAX_PIXELS // 1_000_000} megapixels; make it smaller", file=path) from error
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
    if width * height > MAX_PIXELS or min(width, height) < 32:
        raise InputError(f"a picture of {width} × {height} pixels; expected 32 × 32 to 64 megapixels; scale it",
                         field="source", value=name)
