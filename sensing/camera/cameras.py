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


def _genicam(rest: str, least_delay: float) -> FrameSource:
    producer, _, serial = rest.partition("#")
    return GenICamCamera.open(Path(producer), serial or None, least_delay)


def _stream(rest: str, least_delay: float) -> FrameSource:
    return StreamCamera(*host_and_port(rest, "camera"))


CAMERAS: Registry[Opener] = Registry("camera", "ideal_robot.cameras", {
    "usb": "sensing.camera.video_capture:opened_usb",
    "file": "sensing.camera.video_capture:opened_file",
    "rtsp": "sensing.camera.video_capture:opened_rtsp",
    "http": "sensing.camera.video_capture:opened_http",
    "genicam": "sensing.camera.cameras:_genicam",
    "stream": "sensing.camera.cameras:_stream",
})
"""How cameras are opened, by the scheme of their address."""


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
