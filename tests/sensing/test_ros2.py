"""Pictures and wrenches of ROS 2, over the middleware itself; pictures also by their bytes alone."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from ideal_robot.errors import InputError
from sensing.camera.cameras import open_camera
from sensing.force.sensors import open_force
from sensing.ros2 import decompressed, gray


def image(values: np.ndarray, encoding: str, *, spare: int = 0, big: bool = False) -> Any:
    """A message as ROS has it, with bytes that are spare at the end of each row."""
    height, width = values.shape[:2]
    rows = values.reshape(height, -1).view(np.uint8)
    rows = np.hstack([rows, np.full((height, spare), 77, np.uint8)])
    return SimpleNamespace(encoding=encoding, height=height, width=width, step=rows.shape[1], is_bigendian=big,
                           data=rows.tobytes())


@pytest.mark.parametrize("seed", range(4))
def test_every_encoding_gives_the_gray_values_that_were_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanted = cv2.GaussianBlur(rng.integers(0, 256, (24, 32)).astype(np.uint8), (9, 9), 4)
    spare = int(rng.integers(0, 9))
    three, four = np.dstack([wanted] * 3), np.dstack([wanted] * 4)
    for encoding, values in (("mono8", wanted), ("8UC1", wanted), ("bgr8", three), ("rgb8", three), ("bgra8", four),
                             ("rgba8", four), *((f"bayer_{p}8", wanted) for p in ("rggb", "bggr", "gbrg", "grbg"))):
        found = gray(image(values, encoding, spare=spare))
        assert found is not None
        # A Bayer pattern of a gray picture is the picture, but for what interpolation smooths.
        np.testing.assert_allclose(found[2:-2, 2:-2], wanted[2:-2, 2:-2], atol=1 if "bayer" not in encoding else 12)
    for big in (False, True):
        wide = (wanted.astype(np.uint16) << 8 | 200).astype(">u2" if big else "<u2")
        np.testing.assert_array_equal(gray(image(wide, "mono16", spare=2 * spare, big=big)), wanted)


def test_colours_are_weighted_by_their_places() -> None:
    red = np.zeros((4, 4, 3), np.uint8)
    red[..., 0] = 200
    assert gray(image(red, "rgb8"))[0, 0] == pytest.approx(0.299 * 200, abs=1)
    assert gray(image(red, "bgr8"))[0, 0] == pytest.approx(0.114 * 200, abs=1)


def test_what_is_not_whole_is_none() -> None:
    sound = image(np.zeros((4, 4), np.uint8), "mono8")
    assert gray(SimpleNamespace(**{**vars(sound), "encoding": "yuv422"})) is None
    assert gray(SimpleNamespace(**{**vars(sound), "data": sound.data[:-1]})) is None
    assert gray(SimpleNamespace(**{**vars(sound), "step": 3})) is None
    assert gray(SimpleNamespace(**{**vars(sound), "height": 0})) is None
    assert decompressed(SimpleNamespace(data=b"")) is None
    assert decompressed(SimpleNamespace(data=b"no picture")) is None
    picture = np.tile(np.arange(32, dtype=np.uint8) * 8, (16, 1))
    coded = SimpleNamespace(data=cv2.imencode(".png", picture)[1].tobytes())
    np.testing.assert_array_equal(decompressed(coded), picture)


@pytest.mark.parametrize("opens", [open_camera, open_force])
def test_addresses_that_cannot_be(opens: Callable[[str], Any]) -> None:
    for address, says in (("ros2://", "expected a topic"), ("ros2:///x?rate=3", "expected sim_time, discovery")):
        with pytest.raises(InputError, match=says):
            opens(address)


@contextmanager
def published(kind: str, make: Callable[[int], Any]) -> Iterator[None]:
    """Somebody publishes a message every 20 ms on ``/sensor/data``."""
    import rclpy

    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("a_device", context=context, enable_rosout=False, start_parameter_services=False)
    module, name = kind.split("/")
    message = getattr(__import__(f"{module}.msg", fromlist=[name]), name)
    publisher, ended = node.create_publisher(message, "/sensor/data", 5), threading.Event()

    def publish() -> None:
        k = 0
        while not ended.wait(0.02):
            sent = message(**make(k))
            sent.header.stamp.sec, sent.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
            publisher.publish(sent)
            k += 1

    thread = threading.Thread(target=publish, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(5.0)
        node.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.slow
@pytest.mark.real_time
def test_pictures_and_wrenches_come_with_the_stamps_of_their_headers(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="a sourced ROS 2, or pip install 'ideal-robot[ros2]'")
    from geometry_msgs.msg import Vector3, Wrench

    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    picture = np.tile(np.arange(32, dtype=np.uint8) * 8, (16, 1))
    shown = {"encoding": "mono8", "height": 16, "width": 32, "step": 32, "data": picture.tobytes()}
    with published("sensor_msgs/Image", lambda k: shown):
        camera = open_camera("ros2:///sensor/data")
        frames = [frame for frame in (camera.read(2.0) for _ in range(10)) if frame is not None]
        camera.close()
    assert len(frames) > 5
    np.testing.assert_array_equal(frames[0].image, picture)
    assert all(b.stamp > a.stamp for a, b in pairwise(frames))
    pressed = {"wrench": Wrench(force=Vector3(x=1.0, y=-2.0, z=30.0), torque=Vector3(z=0.3))}
    with published("geometry_msgs/WrenchStamped", lambda k: pressed):
        force = open_force("ros2:///sensor/data")
        readings = [reading for _ in range(10) for reading in force.read(2.0)]
        force.close()
        with pytest.raises(InputError, match="sensor_msgs/msg/Image"):
            open_camera("ros2:///nothing")
    assert len(readings) > 5
    np.testing.assert_array_equal(readings[-1].wrench, [1.0, -2.0, 30.0, 0.0, 0.0, 0.3])
