"""Cameras that OpenCV reads: on USB, as a file, over RTSP or MJPEG."""

from __future__ import annotations

import math
import time
from pathlib import Path

import cv2
import numpy as np

from ideal_robot.bounded_values import kept_words
from ideal_robot.errors import InputError
from sensing import SensingError
from sensing.camera.cameras import Frame
from sensing.clock_relation import ClockRelation

_LARGEST = 4096
"""Columns or rows of a picture that are taken at most."""


class VideoCapture:
    """A ``FrameSource`` over ``cv2.VideoCapture``.

    Most drivers report when a picture was taken (``CAP_PROP_POS_MSEC``): V4L2 by the kernel's clock, RTSP by the
    sender's, a file by its beginning. Where those stamps do not rise, or there are none, the arrival is the stamp.
    Raises ``InputError`` where it cannot be opened.

    Args:
        source: number of a USB camera, path of a file, or URL.
        least_delay: from mid-exposure to the picture's arrival, at least [s].
        pace: whether a file is played at its own speed, as if it were a camera.
    """

    def __init__(self, source: int | str, least_delay: float = 0.0, *, pace: bool = False) -> None:
        self._source, self._pace = source, pace
        # Messages of OpenCV and FFmpeg about a broken film are suppressed; this program writes one line itself.
        with kept_words():
            self._capture = cv2.VideoCapture(source)
        # A short buffer, so that pictures are not old; not every driver obeys.
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if not self._capture.isOpened():
            raise InputError("OpenCV cannot open this camera, file or address", field="camera", value=source)
        self.width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if not (0 < self.width <= _LARGEST and 0 < self.height <= _LARGEST):
            self.close()
            raise InputError(f"expected pictures of 1 to {_LARGEST} pixels each way", field="camera",
                             value=(self.width, self.height))
        self.clock = ClockRelation(least_delay)
        self.stamps = "camera" if isinstance(source, int) else "stream"
        self._number, self._last, self._begun = 0, -math.inf, math.nan

    def read(self, timeout: float) -> Frame | None:
        """The next picture, see ``FrameSource.read``; the driver decides how long it waits, not ``timeout``."""
        success, image = self._capture.read()
        arrived = time.perf_counter()
        if not success or image is None:
            raise SensingError(f"no picture comes from camera {self._source} any more")
        stamp = 1e-3 * float(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        if self.stamps != "arrival" and not (math.isfinite(stamp) and stamp > self._last):
            # Arrival times are used from now on: two kinds of stamps must not be mixed.
            self.stamps, self.clock = "arrival", ClockRelation(self.clock.least_delay)
        if self.stamps == "arrival":
            stamp = arrived
        elif self._pace:
            self._begun = self._begun if math.isfinite(self._begun) else arrived - stamp
            time.sleep(max(self._begun + stamp - time.perf_counter(), 0.0))
            arrived = time.perf_counter()
        self._last = stamp
        if not self.clock.add(stamp, arrived):
            return None
        gray = np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        if gray.shape != (self.height, self.width):
            raise SensingError(f"camera {self._source} changed its picture size during the run; start again")
        self._number += 1
        return Frame(self._number, stamp, arrived, gray)

    def close(self) -> None:
        """Closes the camera and releases the device; see ``FrameSource.close``."""
        self._capture.release()


def camera_number(text: str) -> int | None:
    """The number of a camera that OpenCV can open; None where the text is none."""
    return int(text) if text.isdecimal() and len(text) < 10 else None


def opened_usb(rest: str, least_delay: float) -> VideoCapture:
    """Opens the camera of an address like ``usb:0``; raises InputError where it is no number or cannot be opened."""
    number = camera_number(rest)
    if number is None:
        raise InputError("expected the number of a camera, as in usb:0", field="camera", value=rest)
    return VideoCapture(number, least_delay)


def opened_file(rest: str, least_delay: float) -> VideoCapture:
    """Opens the film of ``file:film.mp4`` at its own rate; raises InputError where there is no such film."""
    if not Path(rest).is_file():
        raise InputError("no such film", field="camera", value=rest)
    return VideoCapture(rest, least_delay, pace=True)


def opened_rtsp(rest: str, least_delay: float) -> VideoCapture:
    """Opens the camera of ``rtsp://…``; raises InputError where it cannot be opened."""
    return VideoCapture(f"rtsp:{rest}", least_delay)


def opened_http(rest: str, least_delay: float) -> VideoCapture:
    """Opens the MJPEG camera of ``http://…``; raises InputError where it cannot be opened."""
    return VideoCapture(f"http:{rest}", least_delay)
