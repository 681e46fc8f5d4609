"""Opens cameras by their addresses, as the command line takes them."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.registry import Registry
from sensing import SensingError
from sensing.camera.camera_device import Gray
from sensing.clock_relation import ClockRelation
from sensing.stream import Package, StreamConnection, host_and_port


@dataclass(frozen=True)
class Frame:
    """A whole picture.

    Attributes:
        number: counts the pictures of its camera.
        stamp: mid-exposure by the camera's clock, or whatever its stamps mean; see ``FrameSource.stamps``  [s].
        arrived: time at which it was read, by ``time.perf_counter`` [s].
        image: gray values ``(height, width)``, uint8.
    """

    number: int
    stamp: float
    arrived: float
    image: Gray


class FrameSource(Protocol):
    """A camera that delivers whole pictures, as long as it is open.

    Attributes:
        width, height: size of a picture [px].
        stamps: whose clock the stamps are of: ``camera`` (its own), ``stream`` (of the recording or the sender) or
            ``arrival`` (there is none but this computer's: the stamp is when the picture was read).
        clock: how that clock relates to this computer's; ``read`` adds to it.
    """

    width: int
    height: int
    stamps: str
    clock: ClockRelation

    def read(self, timeout: float) -> Frame | None:
        """The next picture; None if none comes within ``timeout`` [s], or what came could not be used.

        Raises ``SensingError`` where the camera is gone, or its stream has ended.
        """
        ...

    def close(self) -> None:
        """Closes the camera and releases the device."""
        ...


_CAMERA = struct.Struct(">HHd14d")
_FIELD = struct.Struct(">IHH")


class StreamCamera:
    """A ``FrameSource`` over a TCP stream; stamps are mid-exposures by the sender's clock, which is requested over it.

    Args:
        host, port: address of the sender, and TCP port.
        patience: how long the sender and its description are waited for [s].

    Raises:
        InputError: no camera there.

    Attributes:
        rate: pictures a second as the sender says; NaN where it does not.
        K: camera matrix ``(3, 3)`` as the sender says, NaN where it does not.
        distortion: k1, k2, p1, p2, k3, NaN where not known ``(5,)``.
        refused: pictures that could not be used.
    """

    stamps = "camera"

    def __init__(self, host: str, port: int, patience: float = 5.0) -> None:
        self._connection = StreamConnection(host, port, patience)
        self.clock, self.refused = self._connection.clock, 0
        self._first = self._described(patience)
        description = self._connection.described
        if description is None or len(description.payload) != _CAMERA.size:
            self.close()
            raise InputError("the device at this address is no camera of this stream format", field="camera",
                             value=f"{host}:{port}")
        self.width, self.height, self.rate, *numbers = _CAMERA.unpack(description.payload)
        self.K: Array = np.array(numbers[:9]).reshape(3, 3)
        self.distortion: Array = np.array(numbers[9:])

    def _described(self, patience: float) -> Package | None:
        """Waits until it is known what the device is; what came meanwhile."""
        deadline, package = Deadline.within(patience), None
        while self._connection.described is None and package is None and not deadline.passed:
            package = self._connection.next(min(deadline.left, 0.1))
        return package

    def read(self, timeout: float) -> Frame | None:
        """The next picture, see ``FrameSource.read``; waits for a sender that disconnects to come back."""
        package, self._first = self._first or self._connection.next(timeout), None
        arrived = time.perf_counter()
        if package is None:
            return None
        image = self._image(package.payload)
        if image is None or not np.isfinite(package.stamp) or not self.clock.known:
            self.refused += 1
            return None
        return Frame(_FIELD.unpack_from(package.payload)[0], package.stamp, arrived, image)

    def _image(self, payload: bytes) -> np.ndarray | None:
        """The picture of a field package; None where its size is another than the camera's."""
        if len(payload) < _FIELD.size:
            return None
        _, width, height = _FIELD.unpack_from(payload)
        if (width, height) != (self.width, self.height) or len(payload) != _FIELD.size + width * height:
            return None
        return np.frombuffer(payload, np.uint8, offset=_FIELD.size).reshape(height, width)

    def close(self) -> None:
        """Disconnects from the sender; see ``FrameSource.close``."""
        self._connection.close()


_GRAY_OF = {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono14": 14, "Mono16": 16}
"""Formats that are taken, with the bits that count. Packed and coloured ones are not: set ``PixelFormat``."""


class GenICamCamera:
    """A ``FrameSource`` over the image acquirer of the library harvesters; stamps are of the camera's own clock.

    Args:
        acquirer: an ``ImageAcquirer`` of harvesters, or whatever has its ``start``, ``fetch``, ``stop``, ``destroy``.
        least_delay: from the camera's stamp (begin of exposure with most) to the picture's arrival, at least [s].
        library: the library object that made the acquirer; it is reset at the end.

    Raises:
        InputError: a pixel format that is not taken.
    """

    def __init__(self, acquirer: Any, least_delay: float = 0.0, library: Any = None) -> None:
        self._acquirer, self._library = acquirer, library
        self.clock, self.stamps = ClockRelation(least_delay), "camera"
        self._number = 0
        with ExitStack() as given_back:
            given_back.callback(self.close)
            acquirer.start()
            first = self._fetched(5.0)
            if first is None:
                raise InputError("the camera is connected but sends no picture; is it triggered?", field="camera")
            self.height, self.width = first[1].shape
            given_back.pop_all()

    @classmethod
    def open(cls, producer: Path, serial: str | None = None, least_delay: float = 0.0) -> GenICamCamera:
        """Opens a camera by its GenTL producer file; raises ``InputError`` without harvesters, such a file or a camera.

        Args:
            producer: the ``.cti`` file that came with the camera.
            serial: number of the camera; the first one found if None.
            least_delay: see the class.
        """
        try:
            from harvesters.core import Harvester
        except ImportError as error:
            raise InputError("GenICam cameras need the package harvesters: pip install 'ideal-robot[genicam]'",
                             field="camera") from error
        if not producer.is_file():
            raise InputError("no such GenTL producer (.cti), which the camera's maker supplies", field="camera",
                             value=str(producer))
        library = Harvester()
        library.add_file(str(producer))
        library.update()
        if not library.device_info_list:
            library.reset()
            raise InputError("the producer finds no camera", field="camera", value=str(producer))
        return cls(library.create(0 if serial is None else {"serial_number": serial}), least_delay, library)

    def read(self, timeout: float) -> Frame | None:
        """The next picture; None if none comes within ``timeout`` [s]; see ``FrameSource.read``."""
        stamped_image = self._fetched(timeout)
        if stamped_image is None:
            return None
        stamp, image = stamped_image
        if image.shape != (self.height, self.width):
            raise SensingError("the camera changed its picture size during the run; start again")
        arrived = time.perf_counter()
        if not self.clock.add(stamp, arrived):
            return None
        self._number += 1
        return Frame(self._number, stamp, arrived, image)

    def close(self) -> None:
        """Closes the camera and releases the device; see ``FrameSource.close``."""
        self._acquirer.stop()
        self._acquirer.destroy()
        if self._library is not None:
            self._library.reset()

    def _fetched(self, timeout: float) -> tuple[float, Gray] | None:
        buffer = self._acquirer.try_fetch(timeout=timeout)
        if buffer is None:
            return None
        with buffer:
            parts = buffer.payload.components
            if not parts:
                return None
            part = parts[0]
            bits = _GRAY_OF.get(part.data_format)
            if bits is None:
                raise InputError(f"expected a pixel format of {', '.join(_GRAY_OF)}; set it with the camera's own tool",
                                 field="camera", value=part.data_format)
            # Copied: the buffer goes back to the camera.
            gray = np.array(part.data, copy=True).reshape(part.height, part.width)
            stamp = 1e-9 * float(buffer.timestamp_ns)
        return stamp, gray if bits == 8 else (gray >> (bits - 8)).astype(np.uint8)


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
    "ros2": "sensing.ros2:opened_camera",
})
"""How cameras are opened, by the scheme of their address."""


def open_camera(address: str, least_delay: float = 0.0) -> FrameSource:
    """Opens a camera by its address.

    ``usb:0``, ``file:film.mp4``, ``rtsp://…``, ``http://…`` (MJPEG), ``genicam:producer.cti#serial``,
    ``stream://host:port``, ``ros2:///topic``. The least delay from mid-exposure to the picture's arrival [s] is not
    needed for ``stream``.
    Raises ``InputError`` where there is no such scheme, or the camera cannot be opened.
    """
    scheme, colon, rest = address.partition(":")
    if not colon or scheme not in CAMERAS.names():
        raise InputError(f"expected an address that begins with {', '.join(name + ':' for name in CAMERAS.names())}",
                         field="camera", value=address[:80])
    return CAMERAS.get(scheme)(rest, least_delay)
