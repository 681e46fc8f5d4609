"""Our controllers: whatever a client says, the others are served on and the arm is moved by sound commands alone."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from ideal_robot.robots.robot import Robot
from ideal_robot.rsi.message import RsiError, RsiFormat
from ideal_robot.rsi.robot import RsiRobot
from ideal_robot.rtde import RtdeRobot
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rsi_controller import RsiController
from sim.devices.rtde_controller import RtdeController
from sim.devices.served_arm import ServedArm, ServedRtde, Session
from sim.devices.stream_server import Unkindness
from tests.sim.devices.controllers import PATIENCE, controlled, serving
from tests.sources import free_port

ROBOT = Robot.load("kr6")
REGISTERS = ",".join([*(f"input_double_register_{24 + i}" for i in range(6)), "input_int_register_24"]).encode()


def package(letter: str, payload: bytes = b"") -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(letter)) + payload


def command(*values: float, recipe: int = 1, number: int = 1) -> bytes:
    return package("U", struct.pack(">B6di", recipe, *values, number))


VERSION, START = package("V", b"\0\2"), package("S")
OUTPUTS = package("O", struct.pack(">d", 125.0) + b"timestamp,actual_q")
AGREED = VERSION + OUTPUTS + package("I", REGISTERS) + START


@contextmanager
def playing(cell: ServedArm) -> Iterator[list[Session]]:
    """A cell in a thread; sessions in which the arm has moved."""
    sessions: list[Session] = []
    thread = threading.Thread(target=cell.sessions, args=(0, sessions.append))
    thread.start()
    try:
        yield sessions
    finally:
        cell.stop()
        thread.join(20.0)
        assert not thread.is_alive()


@contextmanager
def served() -> Iterator[tuple[ServedRtde, list[Session]]]:
    """A cell behind RTDE, and its sessions."""
    with SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm:
        cell = ServedRtde(arm, ("127.0.0.1", 0), relative=False, unkind=Unkindness(drift=0.0),
                          rng=np.random.default_rng(2), carried=(), sign=np.ones(6))
        with playing(cell) as sessions:
            yield cell, sessions


def ended(address: tuple[str, int], said: bytes) -> bool:
    """Whether the other side ends the connection, whatever it answers before."""
    with socket.create_connection(address, 10.0) as client:
        try:
            client.sendall(said)
            while client.recv(4096):
                pass
        except TimeoutError:
            return False
        except ConnectionError:
            return True
    return True


@pytest.mark.parametrize("said", [
    b"\0\0V", b"\0\2V", package("V", b"\2"), package("V", b""), package("X", b"1"), package("O", b"12"),
    package("O", struct.pack(">d", np.nan) + b"timestamp"), package("O", struct.pack(">d", -1.0) + b"timestamp"),
    package("O", struct.pack(">d", 0.0) + b"timestamp"), package("O", struct.pack(">d", 125.0) + b"\xff\xfe"),
    package("O", struct.pack(">d", 125.0) + b"actual_q," * 2), package("I", b"\x80" * 20),
    package("O", struct.pack(">d", 125.0) + ",".join(map(str, range(9000))).encode()),
    package("U", b""), package("U", b"\1" + bytes(52)),
    AGREED + command(*ROBOT.home, recipe=2), AGREED + command(*ROBOT.home, recipe=0),
    AGREED + package("U", b"\1" + bytes(20)), AGREED + package("U", b"\1"),
    package("O", struct.pack(">d", 125.0) + ",".join(
        f"{side}_double_register_{i}" for side in ("input", "output") for i in range(48)).encode()) * 300 + b"\0\0\0",
    package("I", b"input_int_register_0") * 300])
def test_a_client_that_cannot_be_understood_is_let_go_and_the_others_are_served(said: bytes) -> None:
    with served() as (cell, sessions):
        address = cell.address
        assert ended(address, said)
        with RtdeRobot(ROBOT, *address[:1], port=address[1], timeout=5.0) as robot:
            robot.connect(5.0)
            assert ended(address, said)
            for k in range(8):
                robot.cycle(ROBOT.home + 0.001 * k)
        while not sessions:
            time.sleep(0.01)
        assert sessions[0].ended == "the client has left"


@pytest.mark.parametrize("wanted", [
    [np.nan] * 6, [np.inf, 0, 0, 0, 0, 0], [1e300] * 6, list(ROBOT.home + 1.0), [0.0] * 5 + [-np.inf]])
def test_a_command_that_cannot_be_ends_the_session_at_rest(wanted: list[float]) -> None:
    with served() as (cell, sessions), socket.create_connection(cell.address, 10.0) as client:
        client.sendall(AGREED + command(*(ROBOT.home + 1e-4)))
        while cell.arm.t == 0.0:
            time.sleep(0.001)
        client.sendall(command(*wanted, number=2))
        while not sessions:
            time.sleep(0.01)
    assert "the controller refuses" in sessions[0].ended
    np.testing.assert_allclose(sessions[0].commands[-1], ROBOT.home + 1e-4, atol=0.01)
    assert np.abs(np.diff(sessions[0].commands[-3:], axis=0)).max() < 1e-9


def test_a_client_that_falls_silent_is_braked_and_let_go() -> None:
    with served() as (cell, sessions), socket.create_connection(cell.address, 10.0) as client:
        client.sendall(AGREED + command(*(ROBOT.home + 1e-4)))
        while not sessions:
            client.recv(4096)
        ended_at = cell.arm.t
    assert sessions[0].ended == "no command for 100 ms"
    # Who stops it does not wait until the next session could begin.
    assert ended_at <= cell.arm.t < ended_at + 1.0


def test_who_only_looks_neither_leads_nor_holds_the_clock_up() -> None:
    with served() as (cell, sessions), socket.create_connection(cell.address, 10.0) as client:
        client.sendall(VERSION + OUTPUTS + START)
        begun, received = time.perf_counter(), b""
        while time.perf_counter() < begun + 1.0:
            received += client.recv(4096)
        took = time.perf_counter() - begun
    data = [received[i + 4 : i + 60] for i in range(len(received) - 59) if received[i : i + 4] == b"\0<U\1"]
    stamps = [struct.unpack_from(">d", payload)[0] for payload in data]
    assert not sessions
    # Its own clock stands still where this computer does; without commands to wait for it is never behind for long.
    assert stamps[-1] - stamps[0] > 0.7 * (took - 0.2)


def test_registers_belong_to_one_client_until_it_leaves() -> None:
    with (SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm,
          serving(RtdeController(arm, timeout=0.02)) as controller,
          socket.create_connection(controller.address, 10.0) as first,
          socket.create_connection(controller.address, 10.0) as second):
        first.sendall(AGREED)
        while not controller.led:
            time.sleep(0.01)
        second.sendall(VERSION + package("I", REGISTERS))
        answer = b""
        while answer.count(b"IN_USE") < 7:
            answer += second.recv(4096)


def test_every_published_field_has_a_type_and_a_value() -> None:
    """What ``ur_rtde`` asks for by itself, beside fields that no controller has."""
    names = b"timestamp,joint_mode,actual_digital_input_bits,payload_cog,output_int_register_2,input_double_register_7,"
    with served() as (cell, _), socket.create_connection(cell.address, 10.0) as client:
        client.sendall(VERSION + package("O", struct.pack(">d", 500.0) + names) + START)
        answer = b""
        while answer.count(b"\0PU\1") < 3:
            answer += client.recv(4096)
        assert b"O\1DOUBLE,VECTOR6INT32,UINT64,VECTOR3D,INT32,DOUBLE" in answer
        client.sendall(package("O", struct.pack(">d", 500.0) + b"timestamp,output_int_register_48,no_such"))
        while b"O\1DOUBLE,NOT_FOUND,NOT_FOUND" not in answer:
            answer += client.recv(4096)


# Our RSI controller: only a sound answer to the very cycle moves the arm, and nobody holds up its clock.

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


def play(arm: RsiRobot, commands: list[Any]) -> None:
    for q in commands:
        arm.cycle(q)


def test_a_session_that_has_ended_is_not_gone_on_with() -> None:
    """Who was silent and answers again is not led on from the start, somewhere else than where it believes the arm."""
    with RsiRobot(ROBOT, port=0, relative=True, form=RsiFormat(hold_on=True), bridge=1.0) as follower, \
            SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm:
        cell = ServedArm(arm, follower.address, relative=True, unkind=Unkindness(), rng=np.random.default_rng(1),
                         carried=(), sign=np.ones(6))
        with playing(cell) as sessions:
            q = follower.connect().q
            play(follower, [q] * 5)
            time.sleep(0.3)
            with pytest.raises(RsiError, match="no packet"):
                play(follower, [q] * 500)
    assert [session.ended for session in sessions] == ["no answer for 100 ms"]


def test_a_controller_in_lockstep_waits_for_a_program_that_opens_its_port_later() -> None:
    port = free_port(socket.SOCK_DGRAM)
    with (SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm, controlled(arm, port)):
        time.sleep(0.2)
        with RsiRobot(ROBOT, port=port, timeout=PATIENCE) as link:
            np.testing.assert_allclose(link.connect(PATIENCE / 4.0).q, ROBOT.home, atol=1e-3)
