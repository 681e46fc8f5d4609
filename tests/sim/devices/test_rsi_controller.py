"""Our RSI controller: only a sound answer to the very cycle moves the arm, and nobody holds up its clock."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rsi_controller import RsiController

ROBOT = Robot.load("kr6")


class Link:
    """Brings the same datagram whenever it is asked, up to ``most`` times."""

    def __init__(self, packet: bytes, most: float = 1) -> None:
        self._packet, self._left = packet, most

    def settimeout(self, _: float) -> None:
        """Is not needed."""

    def recvmsg(self, *_: int) -> tuple[bytes, list[Any], int, Any]:
        """The datagram, as if it had come just now."""
        self._left -= 1
        if self._left < 0:
            raise BlockingIOError
        return self._packet, [], 0, ("127.0.0.1", 5)


def answered(axes: str, ipoc: str = "77", most: float = 1) -> Any:
    with SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm:
        packet = f'<Sen Type="ImFree"><AK{axes}/><IPOC>{ipoc}</IPOC></Sen>'.encode()
        link: Any = Link(packet, most)
        return RsiController(arm, ("127.0.0.1", 1)).answer(link, 77, time.perf_counter() + 0.05)


SOUND = "".join(f' A{i}="{0.1 * i:.4f}"' for i in range(1, 7))


def test_a_sound_answer_counts() -> None:
    np.testing.assert_allclose(answered(SOUND), 0.1 * np.arange(1, 7))


@pytest.mark.parametrize("axes", [
    ' A1="0.1"', SOUND + ' A7="0.1"', SOUND.replace("A2", "A3"), SOUND.replace("0.1000", "1.2.3"),
    SOUND.replace("0.1000", "--1"), SOUND.replace("0.1000", "9" * 30), SOUND.replace("0.1000", ".")])
def test_an_answer_that_is_none_moves_nothing(axes: str) -> None:
    assert answered(axes) is None


@pytest.mark.parametrize("ipoc", ["78", "077777", "9" * 4000])
def test_an_answer_to_another_cycle_moves_nothing(ipoc: str) -> None:
    assert answered(SOUND, ipoc) is None


def test_who_floods_the_port_does_not_hold_up_the_clock() -> None:
    assert answered(SOUND, "78", most=float("inf")) is None
