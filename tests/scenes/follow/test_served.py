"""What a served cell does while nobody looks, and cycles that no controller has."""

from __future__ import annotations

import socket
import time
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from scenes.online.devices import Devices
from scenes.online.run import follow, load_cell
from scenes.serve.carried import CameraDevice, ServedCamera
from sensing.camera.camera_model import CameraModel, default_mount
from sensing.camera.cameras import StreamCamera
from sim.camera.camera import CameraSettings
from sim.camera.live_camera import NOTHING, LiveCamera
from sim.camera.surface import DrawnLine
from sim.devices.stream_server import DeviceClock, Unkindness


@pytest.mark.parametrize("cycle", [0.0, -0.004, 0.0045, 1.0, float("nan")])
def test_a_cycle_that_no_controller_has_is_refused(cycle: float) -> None:
    with pytest.raises(InputError, match="whole milliseconds"):
        follow(load_cell("line"), Devices("rsi:", camera="stream://127.0.0.1:1", cycle=cycle))


def camera_device() -> CameraDevice:
    points = np.column_stack([np.linspace(0.0, 0.3, 200), np.zeros((200, 2))])
    eye = LiveCamera(CameraModel(120, 80, np.array([[300.0, 0.0, 60.0], [0.0, 300.0, 40.0], [0.0, 0.0, 1.0]]),
                                 np.zeros(5), default_mount()), DrawnLine(points, pin.SE3.Identity()),
                     CameraSettings(), np.random.default_rng(0))
    return CameraDevice(eye, 100.0, ("127.0.0.1", 0), DeviceClock(100.0, 0.0), Unkindness(), np.random.default_rng(1))


def test_pictures_come_from_a_process_of_their_own_which_may_end() -> None:
    """Without a camera's process the cell goes on, and nobody waits for it."""
    tool = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.1, 0.0, 0.0]))
    camera = ServedCamera(camera_device(), CameraSettings(), lambda t: tool, lambda t: NOTHING,
                          np.random.default_rng(1))
    seen = StreamCamera(*camera.address)
    frames, begun = [], time.perf_counter()
    while len(frames) < 5 and time.perf_counter() < begun + 20.0:
        camera.carry(0.0, 0.01, time.perf_counter())
        if (frame := seen.read(0.01)) is not None:
            frames.append(frame)
    assert len(frames) == 5
    assert np.ptp(frames[-1].image) > 50.0
    numbers = [frame.number for frame in frames]
    assert numbers == sorted(set(numbers))
    camera._process.kill()
    camera._process.join()
    for _ in range(20):
        camera.carry(0.0, 0.01, time.perf_counter())
    seen.close()
    camera.close()


def test_a_port_that_is_taken_is_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        device = replace(camera_device(), address=taken.getsockname())
        with pytest.raises(OSError, match="in use"):
            ServedCamera(device, CameraSettings(), lambda t: pin.SE3.Identity(), lambda t: NOTHING,
                         np.random.default_rng(1))
