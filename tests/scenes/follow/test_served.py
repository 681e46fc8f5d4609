"""What a served cell does while nobody looks, and cycles that no controller has."""

from __future__ import annotations

import time

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from scenes.online.devices import Devices
from scenes.online.run import follow, load_cell
from scenes.serve.carried import ServedCamera
from sim.camera.camera import CameraSettings
from sim.devices.stream_server import DeviceClock, Outbox, Unkindness


@pytest.mark.parametrize("cycle", [0.0, -0.004, 0.0045, 1.0, float("nan")])
def test_a_cycle_that_no_controller_has_is_refused(cycle: float) -> None:
    with pytest.raises(InputError, match="whole milliseconds"):
        follow(load_cell("line"), Devices("rsi:", camera="stream://127.0.0.1:1", cycle=cycle))


class Eye:
    """Draws, and sends, to nobody or to somebody."""

    def __init__(self) -> None:
        self.watched, self.drawn, self.sent = False, 0, 0

    def picture(self, *_: object) -> np.ndarray:
        self.drawn += 1
        return np.zeros((2, 2), dtype=np.uint8)

    def send(self, *_: object) -> None:
        self.sent += 1


def test_no_picture_is_drawn_that_nobody_gets() -> None:
    eye, outbox, clock = Eye(), Outbox(Unkindness(), np.random.default_rng(0)), DeviceClock(0.0, 0.0)
    camera = ServedCamera(eye, CameraSettings(), lambda t: pin.SE3.Identity(), lambda t: (np.empty(0), np.empty(0)),  # type: ignore[arg-type]
                          clock, eye, outbox, np.random.default_rng(1))  # type: ignore[arg-type]
    for k in range(200):
        eye.watched = k >= 100
        camera.carry(0.0, 0.01, time.perf_counter() + 0.01 * k)
        if k == 99:
            assert eye.drawn == 0
        while not camera._due.empty():
            time.sleep(0.001)
    camera.close()
    outbox.close()
    assert eye.drawn > 10
