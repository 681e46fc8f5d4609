"""RTDE against our emulator: what is agreed on, what is refused, and what a stopped or silent controller leads to."""

from __future__ import annotations

import importlib.util
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.robots.address import Address
from ideal_robot.robots.robot import Robot
from ideal_robot.rtde import RtdeError, RtdeRobot
from ideal_robot.rtde.reader import reader
from ideal_robot.rtde.wire import MAX_PACKAGE, Kind, Reader, Recipe, RtdeConnection, package, said
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rtde_controller import RtdeController, RtdeFaults
from tests.sim.devices.controllers import serving

ROBOT = Robot.load("kr6")


@contextmanager
def connected(timeout: float = 5.0, patience: float = 5.0, register: int = 24,
              **faults) -> Iterator[tuple[RtdeRobot, RtdeController]]:
    with (SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm,
          serving(RtdeController(arm, RtdeFaults(**faults), register=register, timeout=timeout)) as controller,
          RtdeRobot(ROBOT, controller.address[0], port=controller.address[1], timeout=patience) as link):
        link.connect(patience=0.5)
        yield link, controller


def ramp(k: int) -> Array:
    share = min(k / 60.0, 1.0)
    return np.asarray(ROBOT.home + 0.2 * share**2 * (3 - 2 * share))


def until(link: RtdeRobot, end: Callable[[int], bool] = lambda k: k == 100) -> None:
    for k in range(1, 1000):
        link.cycle(ramp(k))
        if end(k):
            return


def test_states_are_read_beside_who_leads_the_arm() -> None:
    # Without an answer a cycle ends well before the reader's patience does.
    with connected(timeout=1.0) as (link, controller):
        address = Address.parse("rtde://{}:{}".format(*controller.address))
        with reader(address, ROBOT, 5.0) as beside:
            read, led = [], []
            for k in range(1, 40):
                led.append(link.cycle(ramp(k)).q)
                read += beside.read(1.0)
            found = np.abs(np.array([state.q for state in read])[:, None] - np.array(led)[5:]).max(axis=2)
            assert np.all(found.min(axis=0) < 1e-9)
            assert len({state.t for state in read}) == len(read) >= 39
            np.testing.assert_allclose(np.diff([state.t for state in read]), ROBOT.t_ipo, atol=1e-6)
            assert beside.read(0.05) == []
        # It has written nothing, and its leaving changes nothing.
        assert controller.inputs["input_int_register_24"] == (39,)
        link.cycle(ramp(40))
    with pytest.raises(InputError, match="6 joints"):
        reader(address, SimpleNamespace(n=7, name="fr3"), 1.0)  # type: ignore[arg-type]


def test_what_is_agreed_on_is_what_was_asked_for() -> None:
    with connected() as (link, controller):
        assert link.version == (5, 11, 0, 0)
        np.testing.assert_allclose(link.commanded, ROBOT.home, atol=1e-12)
        for k in (1, 2, 3):
            link.cycle(ramp(k))
        assert controller.inputs["input_int_register_24"] == (3,)
        np.testing.assert_array_equal(controller.commanded, ramp(3))


def test_a_program_may_be_started_after_the_connection() -> None:
    with connected(program_begins=20) as (link, controller):
        until(link)
        assert controller.faults.program_begins < len(controller.commands)
        np.testing.assert_allclose(controller.commands[20], ROBOT.home, atol=1e-12)


@pytest.mark.parametrize(("faults", "says"), [
    ({"protocols": (1,)}, "does not know version 2"),
    ({"program_begins": 10**6}, "program was not started within 0.5 s"),
    ({"unknown": ("actual_current",)}, "actual_current: the controller does not know it"),
    ({"in_use": ("input_double_register_26",)}, "input_double_register_26: another client writes it"),
    ({"protective_stop": 0, "says": "C153A0 collision"}, "protective stop, stopped by safety; it says: C153A0"),
    ({"disconnects": 0}, "closed the connection|is gone"),
])
def test_a_controller_that_cannot_be_used_is_refused_and_the_reason_named(faults, says: str) -> None:
    with pytest.raises(RtdeError, match=says), connected(**faults):
        pass


@pytest.mark.parametrize(("faults", "says"), [
    ({"protective_stop": 30}, "has stopped the arm: protective stop"),
    ({"program_ends": 30}, "program does not run any more"),
    ({"disconnects": 30}, "closed the connection|is gone"),
    ({"skips": tuple(range(30, 60))}, "30 data packages in a row were lost"),
])
def test_what_ends_a_run_is_named(faults, says: str) -> None:
    with connected(**faults) as (link, controller):
        with pytest.raises(RtdeError, match=says):
            until(link)
        assert 25 <= link.counts.cycles <= 33
        # Stopped, the arm gets no further command.
        np.testing.assert_array_equal(controller.commands[-1], link.commanded if "skips" in faults else
                                      controller.commands[-1])


def test_time_stamps_that_stand_still_end_the_run() -> None:
    """A controller goes on sending, whether it gets commands or not."""
    with connected(timeout=0.02, patience=1.0, clock_stands=30) as (link, _):
        with pytest.raises(RtdeError, match=r"time stamps do not go on \(100.36. s after 100.36. s\)"):
            until(link)
        assert link.counts.outdated > 10


def test_missed_cycles_are_made_good_within_the_limits() -> None:
    with connected(skips=(20, 21, 22, 35)) as (link, controller):
        until(link)
        assert link.counts.lost == 4
        commands = np.array(controller.commands)
    np.testing.assert_allclose(commands[-1], ramp(100), atol=1e-5)
    speed = np.diff(commands, axis=0) / ROBOT.t_ipo
    bend = np.abs(np.diff(speed, axis=0)) / ROBOT.t_ipo
    # That the arm is held in a missed cycle is the controller's own doing.
    assert np.all((bend * (np.abs(speed[1:]) > 1e-12)).max(axis=0) <= ROBOT.a_max)


def test_an_arm_that_does_not_move_is_noticed() -> None:
    """The controller's program reads other registers than those that are written."""
    with connected(register=30) as (link, _):
        until(link, lambda k: link.fault is not None)
        assert "does not move" in str(link.fault)


CLIENT = """
import time
from rtde_receive import RTDEReceiveInterface
arm = RTDEReceiveInterface("127.0.0.1", 125.0, ["timestamp", "actual_q", "target_q"])
before = arm.getTimestamp()
time.sleep(0.5)
print(*arm.getActualQ(), arm.getTimestamp() - before)
arm.disconnect()
"""


def test_a_public_client_understands_our_controller() -> None:
    """``ur_rtde`` in a process of its own: it holds Python's lock while it waits."""
    if importlib.util.find_spec("rtde_receive") is None:
        pytest.skip("the package ur-rtde is not installed")
    with SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm:
        try:
            controller = RtdeController(arm, timeout=0.01, address=("127.0.0.1", 30004))
        except OSError:
            pytest.skip("something else listens on RTDE's port 30004")
        with serving(controller):
            words = [sys.executable, "-c", CLIENT]
            answer = subprocess.run(words, capture_output=True, text=True, timeout=30.0, check=True).stdout.split()
    np.testing.assert_allclose([float(value) for value in answer[:6]], ROBOT.home, atol=1e-4)
    assert float(answer[6]) > 0.0


def test_arms_and_registers_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="0 to 42"):
        RtdeRobot(ROBOT, register=43)
    with pytest.raises(InputError, match="6 joints"):
        RtdeRobot(SimpleNamespace(n=2, name="two"))  # type: ignore[arg-type]
    with pytest.raises(RtdeError, match="no controller at"):
        RtdeRobot(ROBOT, port=9, timeout=0.5).connect()


def test_packages_are_found_in_whatever_pieces_they_come() -> None:
    stream = package(Kind.TEXT, b"\2hi\4RTDE\3") + package(Kind.START, b"\1")
    assert stream[:3] == struct.pack(">HB", 3 + 9, ord("M"))
    for size in range(1, len(stream) + 1):
        reader, packets = Reader(), []
        for start in range(0, len(stream), size):
            reader.feed(stream[start : start + size])
            while (packet := reader.next()) is not None:
                packets.append(packet)
        assert packets == [(ord("M"), b"\2hi\4RTDE\3"), (ord("S"), b"\1")]
    assert said(b"\2hi\4RTDE\3") == "hi"
    assert said(b"\3\x1b[m") == " [m"


@pytest.mark.parametrize("size", [0, 2, MAX_PACKAGE + 1])
def test_a_size_that_cannot_be_ends_the_connection(size: int) -> None:
    reader = Reader()
    reader.feed(struct.pack(">HB", size, ord("U")))
    with pytest.raises(RtdeError, match="does not speak RTDE"):
        reader.next()


FIELDS = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "safety_mode": "INT32"}
AGREED = b"\7DOUBLE,VECTOR6D,INT32"


def test_a_recipe_takes_what_fits_it_and_nothing_else() -> None:
    recipe = Recipe.agreed(FIELDS, AGREED)
    data = recipe.packed(1.5, 1, 2, 3, 4, 5, 6, -1)
    assert data[:4] == struct.pack(">HBB", 4 + 60, ord("U"), 7)
    assert recipe.unpacked(data[3:]) == {"timestamp": (1.5,), "actual_q": (1, 2, 3, 4, 5, 6), "safety_mode": (-1,)}
    for wrong in (data[3:-1], data[3:] + b"\0", b"\6" + data[4:], b""):
        with pytest.raises(RtdeError, match="does not fit"):
            recipe.unpacked(wrong)
    for answer in (b"", b"\0DOUBLE", b"\1DOUBLE,DOUBLE"):
        with pytest.raises(RtdeError, match="cannot be used"):
            Recipe.agreed({"timestamp": "DOUBLE"}, answer)


@pytest.mark.parametrize("told", ["VECTOR6D", "FLOAT", "", "double"])
def test_a_field_of_another_type_is_refused_before_a_number_is_sent(told: str) -> None:
    with pytest.raises(RtdeError, match="input_double_register_24: DOUBLE is expected, the controller says"):
        Recipe.agreed({"input_double_register_24": "DOUBLE"}, b"\1" + told.encode())


def test_a_flood_of_other_packages_does_not_hold_up_what_waits_for_an_answer() -> None:
    """Each read waits as long as it is told to, whatever comes meanwhile."""
    stopped = threading.Event()

    def flood(controller: socket.socket) -> None:
        with suppress(OSError):
            while not stopped.is_set():
                controller.sendall(package(Kind.TEXT, b"\2hi\4RTDE\3") * 100)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        link = RtdeConnection(*listener.getsockname(), 0.3)
        controller, _ = listener.accept()
        thread = threading.Thread(target=flood, args=(controller,))
        thread.start()
        try:
            with pytest.raises(RtdeError, match=r"within 0.3 s; it says: hi"):
                link.agree()
            with pytest.raises(RtdeError, match=r"within 0.2 s; it says: hi"):
                link.newest(Recipe.agreed(FIELDS, AGREED), Deadline.within(0.2))
        finally:
            stopped.set()
            link.close()
            controller.close()
            thread.join()


def test_mutated_answers_end_the_connection_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    stream = package(Kind.OUTPUTS, AGREED) + Recipe.agreed(FIELDS, AGREED).packed(1.0, *range(7))
    for _ in range(20_000):
        data = bytearray(stream)
        for _ in range(int(rng.integers(1, 4))):
            data[int(rng.integers(0, len(data)))] = int(rng.integers(0, 256))
        reader = Reader()
        reader.feed(bytes(data))
        try:
            recipe = Recipe.agreed(FIELDS, AGREED)
            while (packet := reader.next()) is not None:
                if packet[0] == Kind.OUTPUTS:
                    recipe = Recipe.agreed(FIELDS, packet[1])
                elif packet[0] == Kind.DATA:
                    assert set(recipe.unpacked(packet[1])) == set(FIELDS)
        except RtdeError:
            continue
