"""A camera behind our own stream, for machines that only have a socket."""

from __future__ import annotations

import struct
import time

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sensing.camera.frame_source import Frame
from sensing.stream.connection import StreamConnection
from sensing.stream.package import Package

_CAMERA = struct.Struct(">HHd14d")
_FIELD = struct.Struct(">IHH")


class StreamCamera:
    """A ``FrameSource`` over a stream; stamps are mid-exposures by the sender's clock, which is asked for.

    Args:
        host: address of the sender.
        port: TCP port.
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
        said = self._connection.described
        if said is None or len(said.payload) != _CAMERA.size:
            self.close()
            raise InputError("the device does not say that it is a camera", field="camera", value=f"{host}:{port}")
        self.width, self.height, self.rate, *numbers = _CAMERA.unpack(said.payload)
        self.K: Array = np.array(numbers[:9]).reshape(3, 3)
        self.distortion: Array = np.array(numbers[9:])

    def _described(self, patience: float) -> Package | None:
        """Waits until it is known what the device is; what came meanwhile."""
        end, found = time.perf_counter() + patience, None
        while self._connection.described is None and found is None and time.perf_counter() < end:
            found = self._connection.next(0.1)
        return found

    def read(self, timeout: float) -> Frame | None:
        """See ``FrameSource.read``; a sender that leaves is waited for."""
        found, self._first = self._first or self._connection.next(timeout), None
        arrived = time.perf_counter()
        if found is None:
            return None
        image = self._image(found.payload)
        if image is None or not np.isfinite(found.stamp) or not self.clock.known:
            self.refused += 1
            return None
        return Frame(_FIELD.unpack_from(found.payload)[0], found.stamp, arrived, image)

    def _image(self, payload: bytes) -> np.ndarray | None:
        """The picture of a field package; None where its size is another than the camera's."""
        if len(payload) < _FIELD.size:
            return None
        _, width, height = _FIELD.unpack_from(payload)
        if (width, height) != (self.width, self.height) or len(payload) != _FIELD.size + width * height:
            return None
        return np.frombuffer(payload, np.uint8, offset=_FIELD.size).reshape(height, width)

    def close(self) -> None:
        """See ``FrameSource.close``."""
        self._connection.close()
