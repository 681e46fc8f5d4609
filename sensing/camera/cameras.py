"""Cameras by address, as one gives it on the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ideal_robot.errors import InputError
from ideal_robot.registry import Registry
from sensing.camera.frame_source import FrameSource
from sensing.camera.genicam import GenICamCamera
from sensing.camera.stream_camera import StreamCamera
from sensing.stream.address import host_and_port

Opener = Callable[[str, float], FrameSource]
"""Opens a camera: what stands behind its scheme, and the least delay from mid-exposure to arrival [s]."""


def _usb(rest: str, least_delay: float) -> FrameSource:
    if not rest.isdigit():
        raise InputError("expected the number of a camera, as in usb:0", field="camera", value=rest)
    return _captured(int(rest), least_delay)


def _file(rest: str, least_delay: float) -> FrameSource:
    if not Path(rest).is_file():
        raise InputError("no such film", field="camera", value=rest)
    return _captured(rest, least_delay, pace=True)


def _genicam(rest: str, least_delay: float) -> FrameSource:
    producer, _, serial = rest.partition("#")
    return GenICamCamera.open(Path(producer), serial or None, least_delay)


def _stream(rest: str, least_delay: float) -> FrameSource:
    return StreamCamera(*host_and_port(rest, "camera"))


def _address(scheme: str) -> Opener:
    return lambda rest, least_delay: _captured(f"{scheme}:{rest}", least_delay)


def _captured(source: int | str, least_delay: float, pace: bool = False) -> FrameSource:
    """By OpenCV, which is loaded where it is needed."""
    from sensing.camera.video_capture import VideoCapture

    return VideoCapture(source, least_delay, pace=pace)


CAMERAS: Registry[Opener] = Registry("camera", "ideal_robot.cameras", {
    "usb": "sensing.camera.cameras:_usb",
    "file": "sensing.camera.cameras:_file",
    "rtsp": "sensing.camera.cameras:RTSP",
    "http": "sensing.camera.cameras:HTTP",
    "genicam": "sensing.camera.cameras:_genicam",
    "stream": "sensing.camera.cameras:_stream",
})
"""How cameras are opened, by the scheme of their address."""
RTSP, HTTP = _address("rtsp"), _address("http")


def open_camera(address: str, least_delay: float = 0.0) -> FrameSource:
    """Opens a camera by its address.

    ``usb:0``, ``file:film.mp4``, ``rtsp://…``, ``http://…`` (MJPEG), ``genicam:producer.cti#serial``,
    ``stream://host:port``.

    Args:
        address: as above.
        least_delay: from mid-exposure to the picture's arrival, at least [s]; not needed for ``stream``.

    Raises:
        InputError: no such scheme, or the camera cannot be opened.
    """
    scheme, colon, rest = address.partition(":")
    if not colon or scheme not in CAMERAS.names():
        raise InputError(f"expected an address that begins with {', '.join(name + ':' for name in CAMERAS.names())}",
                         field="camera", value=address[:80])
    return CAMERAS.get(scheme)(rest, least_delay)
