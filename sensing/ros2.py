"""Cameras and force sensors behind ROS 2: ``ros2:///camera/image_raw``, ``ros2:///ft_sensor/wrench``."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.robots.address import Address
from ideal_robot.ros2.node import Node, Ros2Error, full_name, seconds
from sensing import SensingError
from sensing.camera.camera_device import Gray
from sensing.camera.cameras import Frame
from sensing.clock_relation import ClockRelation
from sensing.force.sensors import Reading, ReadingCounts

PATIENCE = 5.0
"""How long the first message is waited for [s]."""
_COLOURS = {"bgr8": cv2.COLOR_BGR2GRAY, "rgb8": cv2.COLOR_RGB2GRAY, "bgra8": cv2.COLOR_BGRA2GRAY,
            "rgba8": cv2.COLOR_RGBA2GRAY,
            # OpenCV names a pattern by its second row, ROS by its first.
            "bayer_rggb8": cv2.COLOR_BayerBG2GRAY, "bayer_bggr8": cv2.COLOR_BayerRG2GRAY,
            "bayer_gbrg8": cv2.COLOR_BayerGR2GRAY, "bayer_grbg8": cv2.COLOR_BayerGB2GRAY}
_CHANNELS = {"bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4}
ENCODINGS = ("mono8", "8UC1", "mono16", "16UC1", *_COLOURS)
"""Encodings of ``sensor_msgs/Image`` that are taken."""


class _Topic:
    """The messages of a topic, in order, each with its arrival by ``time.perf_counter`` [s]."""

    def __init__(self, address: Address, kind: Any, name: str, depth: int) -> None:
        self.name, self._waiting = full_name("", address.host + address.path), list[tuple[Any, float]]()
        self._node = Node(sim_time=bool(address.number("sim_time", 0, 0, 1)),
                          subnet=address.options.get("discovery") == "subnet")
        try:
            self._node.listen(kind, self.name, self._take, depth)
            self._node.require_publisher(name, self.name, Deadline.within(PATIENCE))
        except Ros2Error as error:
            self._node.close()
            raise InputError(str(error), field=address.option, value=address.text[:80]) from error

    def next(self, timeout: float) -> tuple[Any, float] | None:
        """The next message and its arrival; None if none comes within ``timeout`` [s]."""
        deadline = Deadline.within(timeout)
        while not self._waiting:
            self._node.spin(min(deadline.left, 0.1))
            if deadline.passed and not self._waiting:
                return None
        return self._waiting.pop(0)

    def close(self) -> None:
        self._node.close()

    def _take(self, message: Any) -> None:
        self._waiting.append((message, time.perf_counter()))


class Ros2Camera:
    """A ``FrameSource`` of ``sensor_msgs/Image`` or ``CompressedImage``; stamps are those of the headers.

    Args:
        address: of the topic; one that ends in ``compressed`` has compressed pictures.
        least_delay: from the header's stamp to the picture's arrival, at least [s].

    Raises:
        InputError: nobody publishes there, or pictures of an encoding that is not taken.

    Attributes:
        refused: pictures that could not be used.
    """

    stamps = "camera"

    def __init__(self, address: Address, least_delay: float = 0.0) -> None:
        from sensor_msgs.msg import CompressedImage, Image

        compressed = address.path.endswith("compressed")
        self._decoded: Callable[[Any], Gray | None] = decompressed if compressed else gray
        self.clock, self.refused, self._number = ClockRelation(least_delay), 0, 0
        self._topic = _Topic(address, CompressedImage if compressed else Image,
                             f"sensor_msgs/msg/{'CompressedImage' if compressed else 'Image'}", 2)
        first = self._topic.next(PATIENCE)
        image = None if first is None else self._decoded(first[0])
        if first is None or image is None:
            self.close()
            told = "no picture comes" if first is None else (
                f"expected an encoding of {', '.join(ENCODINGS)}, or JPEG or PNG where it is compressed")
            raise InputError(f"{self._topic.name}: {told}", field=address.option,
                             value=None if first is None else getattr(first[0], "encoding", "compressed"))
        self.height, self.width = image.shape

    def read(self, timeout: float) -> Frame | None:
        """The next picture; None if none comes within ``timeout`` [s]; see ``FrameSource.read``."""
        taken = self._topic.next(timeout)
        if taken is None:
            return None
        message, arrived = taken
        image = self._decoded(message)
        if image is not None and image.shape != (self.height, self.width):
            raise SensingError("the camera changed its picture size during the run; start again")
        stamp = seconds(message.header.stamp)
        if image is None or not self.clock.add(stamp, arrived):
            self.refused += 1
            return None
        self._number += 1
        return Frame(self._number, stamp, arrived, image)

    def close(self) -> None:
        """Closes the camera and releases the device; see ``FrameSource.close``."""
        self._topic.close()


def gray(message: Any) -> Gray | None:
    """The gray values ``(height, width)`` of a ``sensor_msgs/Image``; None for an unknown encoding or a short one."""
    wide, channels = message.encoding in ("mono16", "16UC1"), _CHANNELS.get(message.encoding, 1)
    kind = np.dtype(">u2" if message.is_bigendian else "<u2") if wide else np.dtype(np.uint8)
    used = message.width * channels * kind.itemsize
    if message.encoding not in ENCODINGS or not 0 < used <= message.step or (
            len(message.data) < message.step * message.height) or message.height == 0:
        return None
    rows = np.frombuffer(message.data, np.uint8)[: message.step * message.height].reshape(message.height, message.step)
    values = np.ascontiguousarray(rows[:, :used]).view(kind).reshape(message.height, message.width, channels)
    if message.encoding in _COLOURS:
        return np.asarray(cv2.cvtColor(values, _COLOURS[message.encoding]), dtype=np.uint8)
    return (values[..., 0] >> 8).astype(np.uint8) if wide else values[..., 0].copy()


def decompressed(message: Any) -> Gray | None:
    """The gray values ``(height, width)`` of a ``sensor_msgs/CompressedImage``; None where it cannot be read."""
    data = np.frombuffer(message.data, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    return None if image is None else np.asarray(image, dtype=np.uint8)


class Ros2Force:
    """A ``WrenchSource`` of ``geometry_msgs/WrenchStamped``; stamps are those of the headers.

    Args:
        address: of the topic.
        least_delay: from the header's stamp to the arrival, at least [s].

    Raises:
        InputError: nobody publishes there.

    Attributes:
        frame: of the wrench, as the last header says.
    """

    def __init__(self, address: Address, least_delay: float = 0.0) -> None:
        from geometry_msgs.msg import WrenchStamped

        self.clock, self.counts, self.frame = ClockRelation(least_delay), ReadingCounts(), ""
        self._last = -np.inf
        self._topic = _Topic(address, WrenchStamped, "geometry_msgs/msg/WrenchStamped", 50)

    def read(self, timeout: float) -> list[Reading]:
        """The readings of the next packet, none if none comes within ``timeout`` [s]; see ``WrenchSource.read``."""
        taken = self._topic.next(timeout)
        if taken is None:
            return []
        message, arrived = taken
        stamp, wrench = seconds(message.header.stamp), message.wrench
        values = np.array([getattr(part, axis) for part in (wrench.force, wrench.torque) for axis in "xyz"])
        if stamp <= self._last:
            self.counts.outdated += 1
            return []
        if not np.isfinite(values).all() or not self.clock.add(stamp, arrived):
            self.counts.refused += 1
            return []
        self._last, self.frame = stamp, message.header.frame_id
        self.counts.readings += 1
        return [Reading(stamp, values)]

    def close(self) -> None:
        """Closes the sensor and releases the device; see ``WrenchSource.close``."""
        self._topic.close()


def opened_camera(rest: str, least_delay: float) -> Ros2Camera:
    """Opens ``ros2:///topic``; ``rest`` is the address without scheme, the least delay in [s]; raises InputError."""
    return Ros2Camera(_address(rest, "camera"), least_delay)


def opened_force(rest: str, least_delay: float) -> Ros2Force:
    """Opens ``ros2:///topic``; ``rest`` is the address without scheme, the least delay in [s]; raises InputError."""
    return Ros2Force(_address(rest, "force"), least_delay)


def _address(rest: str, option: str) -> Address:
    address = Address.parse(f"ros2:{rest}", option, "ros2:///camera/image_raw")
    address.knows("sim_time", "discovery")
    if not (address.host + address.path).strip("/"):
        raise InputError("expected a topic such as ros2:///camera/image_raw", field=option, value=address.text[:80])
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise InputError(f"ROS 2 needs rclpy ({error}); source its installation, or pip install 'ideal-robot[ros2]'",
                         field=option) from error
    return address
