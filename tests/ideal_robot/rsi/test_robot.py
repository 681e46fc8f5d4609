"""The link: what is lost, repeated, late, wrong or not from the controller."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiError, RsiRobot

ROBOT = Robot.load("kr6")
START = 2**32 - 24


class Controller:
    """Sends what a test wants and reads answers, nothing else."""

    def __init__(self, link: RsiRobot) -> None:
        self.link = link
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(5.0)
        self.address = link.address
        self.home = link.axes.angles(ROBOT.home)

    def send(self, cycle: float, *, late: int = 0, extra: str = "", offset: float = 0.0) -> None:
        axes = " ".join(f'A{i + 1}="{value + offset:.6f}"' for i, value in enumerate(self.home))
        stamp = round(START + 12 * cycle) % 2**32
        self.socket.sendto(f'<Rob Type="KUKA"><AIPos {axes}/>{extra}<Delay D="{late}"/><IPOC>{stamp}</IPOC></Rob>'
                           .encode(), self.address)

    def cycle(self, cycle: float, **said: Any) -> RobotState:
        """Sends, and is commanded home."""
        self.send(cycle, **said)
        return self.link.cycle(ROBOT.home)

    def answer(self) -> str:
        return self.socket.recv(4096).decode()

    def silent(self) -> bool:
        self.socket.settimeout(0.05)
        try:
            self.socket.recv(4096)
        except TimeoutError:
            return True
        return False


@pytest.fixture(params=[False, True], ids=["absolute", "relative"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[RsiRobot, Controller]]:
    with RsiRobot(ROBOT, port=0, relative=request.param, timeout=0.3) as link:
        controller = Controller(link)
        with controller.socket:
            controller.send(0)
            link.connect(5.0)
            yield link, controller


def moved(degrees: float) -> Array:
    """Home with the first axis, which counts against the URDF, turned by so many of the controller's degrees."""
    return ROBOT.home - np.radians(degrees) * np.eye(6)[0]


def test_corrections_are_absolute_or_relative_as_agreed(pair) -> None:
    link, controller = pair
    for k, degrees in enumerate((0.1, 0.2, 0.2)):
        controller.send(k + 1)
        link.cycle(moved(degrees))
        expected = (0.1, 0.1, 0.0)[k] if link.relative else degrees
        answer = controller.answer()
        assert f'A1="{expected:.6f}"' in answer
        assert f"<IPOC>{(START + 12 * k) % 2**32}</IPOC>" in answer


def test_time_goes_on_over_the_end_of_the_time_stamp(pair) -> None:
    _, controller = pair
    for k in range(1, 5):
        assert controller.cycle(k).t == pytest.approx(0.012 * k)


def test_a_repeated_packet_gets_the_same_answer_again(pair) -> None:
    link, controller = pair
    link.send(moved(0.1))
    first = controller.answer()
    controller.send(0)
    controller.send(1)
    assert link.receive().t == pytest.approx(0.012)
    assert controller.answer() == first
    assert link.counts.repeated == 1


def test_an_outdated_packet_gets_no_answer(pair) -> None:
    link, controller = pair
    controller.cycle(1)
    controller.answer()
    controller.send(0)
    controller.cycle(2)
    controller.answer()
    assert controller.silent()
    assert link.counts.outdated == 1


def test_lost_packets_cost_time_and_are_counted(pair) -> None:
    link, controller = pair
    controller.cycle(1)
    assert controller.cycle(4).t == pytest.approx(0.048)
    assert link.counts.lost == 2
    # One stamp far ahead is not believed, its like are.
    controller.send(99)
    assert controller.cycle(5).t == pytest.approx(0.060)
    for k in (20, 21, 22):
        controller.send(k)
    with pytest.raises(RsiError, match="packets in a row were lost, more than 9"):
        link.cycle(ROBOT.home)


def test_a_controller_with_a_shorter_cycle_is_refused_at_once(pair) -> None:
    link, controller = pair
    controller.send(1 / 3)
    with pytest.raises(RsiError, match=r"rose by 4 in a cycle; 12 \(ms\).*--cycle"):
        link.cycle(ROBOT.home)


def test_a_controller_with_a_longer_cycle_is_told_from_a_slow_start(pair) -> None:
    link, controller = pair
    for k in (2, 4):
        controller.cycle(k)
    controller.send(6)
    with pytest.raises(RsiError, match=r"rose by 24 in a cycle"):
        link.cycle(ROBOT.home)


def test_a_slow_start_is_no_loss_of_the_link(pair) -> None:
    _, controller = pair
    for k in (9, 10, 11):
        state = controller.cycle(k)
    assert state.t == pytest.approx(11 * ROBOT.t_ipo)


def test_of_packets_from_before_the_newest_is_the_first() -> None:
    with RsiRobot(ROBOT, port=0) as link:
        controller = Controller(link)
        with controller.socket:
            for k in range(100):
                controller.send(k)
            assert link.connect(5.0).t == 0.0
            link.send(ROBOT.home)
            assert f"<IPOC>{(START + 99 * 12) % 2**32}</IPOC>" in controller.answer()


def test_of_several_packets_the_newest_is_answered(pair) -> None:
    link, controller = pair
    controller.cycle(1)
    controller.answer()
    for k in (2, 3, 3, 2):
        controller.send(k)
    # All four are there before the first is read: loopback delivers within the call.
    assert link.cycle(ROBOT.home).t == pytest.approx(0.036)
    assert link.counts.lost == 1
    controller.answer()
    controller.cycle(4)
    assert f"<IPOC>{(START + 36) % 2**32}</IPOC>" in controller.answer()


def test_others_and_rubbish_are_not_answered_and_do_not_keep_the_link_alive(pair) -> None:
    link, controller = pair
    other = Controller(link)
    done = threading.Event()

    def disturb() -> None:
        while not done.wait(0.02):
            other.send(1, offset=30.0)
            controller.socket.sendto(b"<Rob>", link.address)

    noise = threading.Thread(target=disturb)
    noise.start()
    try:
        with pytest.raises(RsiError, match=r"no packet from .* within 0.3 s, which is 127.*refused.*not XML"):
            link.cycle(ROBOT.home)
    finally:
        done.set()
        noise.join()
    assert link.counts.foreign > 0
    assert link.counts.refused > 0
    assert other.silent()
    other.socket.close()


def test_torque_is_current_times_gain_and_nan_without(pair) -> None:
    _, controller = pair
    assert np.isnan(controller.cycle(1).tau).all()
    state = controller.cycle(2, extra='<MACur A1="2" A2="2" A3="2" A4="2" A5="2" A6="2"/>')
    np.testing.assert_allclose(state.tau, 2 * ROBOT.drive_gain * [-1, 1, 1, -1, 1, -1])


def test_nobody_there_and_nowhere_to_listen() -> None:
    with RsiRobot(ROBOT, port=0) as link:
        with pytest.raises(RsiError, match=r"no packet from the controller within 0.05 s"):
            link.connect(0.05)
        with pytest.raises(RsiError, match="connect"):
            link.cycle(ROBOT.home)
        with pytest.raises(InputError, match="cannot listen"):
            RsiRobot(ROBOT, port=link.address[1])


@pytest.mark.parametrize("table", [{"axis_sign": [1, 1]}, {"axis_sign": [2] * 6}, {"axis_zero": ["a"] * 6}])
def test_axes_that_cannot_be_are_refused(table) -> None:
    with pytest.raises(InputError, match=r"rsi\.axis_"):
        RsiRobot(replace(ROBOT, data={"rsi": table}), port=0)


def test_a_second_controller_before_the_first_answer_is_named() -> None:
    with RsiRobot(ROBOT, port=0, timeout=0.3) as link:
        first, second = Controller(link), Controller(link)
        with first.socket, second.socket:
            first.send(0)
            second.send(0)
            with pytest.raises(RsiError, match=r"two controllers send, 127\.0\.0\.1:\d+ and 127.*--controller"):
                link.connect(5.0)


def test_a_second_controller_a_restart_and_another_port_change_no_command(pair) -> None:
    """What they send is counted and named, and answered to nobody."""
    link, controller = pair
    again = Controller(link)
    with again.socket:
        for k in range(1, 5):
            # The same controller on another port, with time stamps of its own, in another posture.
            again.send(100 + k, offset=20.0)
            controller.send(k)
            state = link.cycle(moved(0.0))
            np.testing.assert_allclose(state.q, ROBOT.home, atol=1e-9)
            assert 'A1="0.000000"' in controller.answer()
        assert again.silent()
        assert link.counts.second == link.counts.foreign == 4
        assert link.counts.last_foreign == f"127.0.0.1:{again.socket.getsockname()[1]}"
        with pytest.raises(RsiError, match=r"4 packets from other senders.*second controller"):
            link.receive()


def test_time_stamps_that_begin_anew_end_the_session(pair) -> None:
    link, controller = pair
    for k in (1, 2, 3):
        controller.cycle(k)
    for k in range(-500, -480):
        controller.send(k)
    with pytest.raises(RsiError, match=r"begin anew.*started again"):
        link.receive()


def test_a_flood_does_not_displace_the_controllers_packets(pair) -> None:
    """The flood is larger than what the system keeps for a socket."""
    link, controller = pair
    size = link._link._door.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for k in range(1, 6):
            for _ in range(2 * size // 800):
                stranger.sendto(b"x" * 800, link.address)
            assert controller.cycle(k).t == pytest.approx(0.012 * k)
    assert link.counts.lost == 0
    assert link.counts.foreign > 0


def test_nobody_else_can_listen_there(pair) -> None:
    link, _ = pair
    with pytest.raises(InputError, match="cannot listen"):
        RsiRobot(ROBOT, port=link.address[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            thief.bind(link.address)
