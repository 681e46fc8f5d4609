"""Mutated packets on every parser of the wires, by the structure of each protocol, without a socket between."""

from __future__ import annotations

import math
import random
import signal
import struct
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any
from unittest import mock

import numpy as np
import typer

from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.rtde import RtdeRobot
from sensing.camera.cameras import StreamCamera
from sensing.force.sensors import NetFT, StreamForce
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rsi_controller import RsiController
from sim.devices.rtde_client import ClientError, RtdeClient, RtdeFaults
from sim.devices.rtde_controller import RtdeController
from sim.devices.stream_server import camera_description
from studies.report import head, resident, row
from studies.wires import EPISODE, Told, Wire, episode, fields, odd

HANG = 20
"""Time after which an episode counts as hanging [s]; a client waits a second at most."""
MOST_GROWTH = 20.0
"""[MiB]"""
LETTERS = b"VvMUOISP\0\xffXu"
ROBOT = Robot.load("kr6")


def _giving(wire: Wire) -> Callable[..., Wire]:
    """Whatever socket is asked for, it is this; without the cost of a mock for every connection."""
    def socket(*_: object) -> Wire:
        return wire

    return socket


def _at_once(_: float) -> None:
    """Nobody comes who would be waited for."""


def _rtde(letter: int, payload: bytes, size: int | None = None) -> bytes:
    return struct.pack(">HB", (3 + len(payload) if size is None else size) & 0xFFFF, letter) + payload


def _rtde_header(letter: int, payload: bytes, rng: random.Random) -> bytes:
    """With another letter or size."""
    if rng.random() < 0.5:
        return _rtde(rng.choice(LETTERS), payload)
    return _rtde(letter, payload, odd("H", 3 + len(payload), rng))


def rtde_client(told: Told, rng: random.Random) -> None:
    """Our client of a controller."""
    types = b"DOUBLE,VECTOR6D,VECTOR6D,VECTOR6D,UINT32,UINT32"
    begun = [_rtde(ord("V"), b"\1"), _rtde(ord("v"), struct.pack(">4I", 5, 11, 0, 0)), _rtde(ord("O"), b"\1" + types),
             _rtde(ord("I"), b"\1" + b",".join([b"DOUBLE"] * 6 + [b"INT32"])), _rtde(ord("S"), b"\1")]
    layout, home = "B" + 19 * "d" + "II", ROBOT.home.tolist()
    values = [[1, 100.0 + k * ROBOT.t_ipo, *home, *home, *([0.0] * 6), 2, 1] for k in range(EPISODE)]
    sound = [*begun, *(_rtde(ord("U"), struct.pack(f">{layout}", *row)) for row in values)]

    def changed(k: int) -> bytes:
        letter, payload = sound[k][2], sound[k][3:]
        if k >= len(begun) and rng.random() < 0.6:
            return _rtde(letter, fields(layout, values[k - len(begun)], rng))
        if rng.random() < 0.3:
            word = rng.choice((b"NOT_FOUND", b"IN_USE", b"VECTOR6D", b"", b","))
            return _rtde(letter, payload[:1] + word + payload[1:])
        if rng.random() < 0.3:
            return _rtde(ord("M"), bytes((rng.randrange(256),)) + rng.randbytes(rng.randrange(40)))
        return _rtde_header(letter, payload, rng)

    wire = Wire(episode(sound, changed, rng), told)
    with mock.patch("socket.create_connection", new=_giving(wire)):
        robot = RtdeRobot(ROBOT, timeout=1.0)
        try:
            robot.connect(0.0)
            while True:
                state = robot.cycle(ROBOT.home)
                told.taken += 1
                if not (np.isfinite(state.q).all() and np.isfinite(state.tau).all()):
                    raise SystemExit("a state that is none was taken")
        finally:
            robot.close()


def rtde_controller(told: Told, rng: random.Random, controller: RtdeController, state: RobotState) -> None:
    """Our controller of a client."""
    inputs = [f"input_double_register_{24 + i}" for i in range(6)] + ["input_int_register_24"]
    begun = [_rtde(ord("V"), b"\0\2"), _rtde(ord("v"), b""),
             _rtde(ord("O"), struct.pack(">d", 125.0) + b"timestamp,actual_q,joint_mode,robot_mode"),
             _rtde(ord("I"), ",".join(inputs).encode()), _rtde(ord("S"), b"")]
    layout = "B" + 6 * "d" + "i"
    values = [[1, *ROBOT.home.tolist(), k] for k in range(EPISODE)]
    sound = [*begun, *(_rtde(ord("U"), struct.pack(f">{layout}", *row)) for row in values)]

    def changed(k: int) -> bytes:
        letter, payload = sound[k][2], sound[k][3:]
        if k >= len(begun) and rng.random() < 0.6:
            return _rtde(letter, fields(layout, values[k - len(begun)], rng))
        if rng.random() < 0.4:
            names = rng.choices([*inputs, "timestamp", "no_such", "", "input_bit_register_64", "payload_cog"],
                                k=rng.randrange(300))
            rate = struct.pack(">d", odd("d", 125.0, rng)) if letter == ord("O") else b""
            return _rtde(rng.choice(b"OI"), rate + ",".join(names).encode())
        return _rtde_header(letter, payload, rng)

    wire = Wire(episode(sound, changed, rng), told)
    client = RtdeClient(wire, RtdeFaults(), lambda *_: False)  # type: ignore[arg-type]
    while True:
        for written in client.read():
            controller.inputs.update(written)
            told.taken += controller.commanded is not None
        if client.started and client.outputs:
            client.tell(controller._told(client.outputs, state, ROBOT.home, 1))


def _rob(ipoc: str, angles: Sequence[str], rest: str = '<Delay D="0"/>') -> bytes:
    axes = " ".join(f'A{i + 1}="{angle}"' for i, angle in enumerate(angles))
    return (f'<Rob Type="KUKA"><AIPos {axes}/><ASPos {axes}/><MACur {axes}/>{rest}<IPOC>{ipoc}</IPOC></Rob>').encode()


_ODD_WORDS = ("nan", "inf", "-inf", "1e308", "1e999", "", " ", "9" * 30, "-0", "0x1", "1,5", "\u0661", "1e-400", "+1",
              "--1", "1.2.3")
_ODD_XML = ("<", ">", "/>", "</Rob>", "<Rob>", "<a>" * 9, "<!--", "-->", "<![CDATA[", "<!DOCTYPE a [", "&amp;", "\0",
            '"', "=", '<Delay D="9"/>', "<IPOC>1</IPOC>", " " * 500)


def rsi_server(told: Told, rng: random.Random) -> None:
    """Our server of a controller."""
    wire: Any = Wire((), told, ("127.0.0.1", 5))
    with mock.patch("socket.socket", new=_giving(wire)), mock.patch("time.sleep", new=_at_once), RsiRobot(
            ROBOT, host="0.0.0.0", port=0, timeout=0.001) as robot:
        degrees = robot.axes.angles(ROBOT.home)
        words = [f"{angle:.6f}" for angle in degrees]
        sound = [_rob(str(1000 + 12 * k), words) for k in range(EPISODE)]

        def changed(k: int) -> bytes:
            kind, ipoc = rng.randrange(5), 1000 + 12 * k
            if kind == 0:
                near = str(ipoc + rng.randint(-50, 50))
                return _rob(rng.choice((*_ODD_WORDS, near, str(rng.getrandbits(70)))), words)
            if kind == 1:
                return _rob(str(ipoc), [rng.choice((*_ODD_WORDS, word, word, word)) for word in words])
            if kind == 2:
                return _rob(str(ipoc), words[: rng.randrange(9)] + words[: rng.randrange(3)])
            if kind == 3:
                return _rob(str(ipoc), words, rng.choice(_ODD_XML))
            packet, place = sound[k].decode(), rng.randrange(len(sound[k]))
            return (packet[:place] + rng.choice(_ODD_XML) + packet[place:]).encode()

        wire.pieces.extend(episode(sound, changed, rng))
        robot.connect(0.001)
        while True:
            state = robot.cycle(ROBOT.home)
            told.taken += 1
            if not np.isfinite(state.q).all():
                raise SystemExit("a state that is none was taken")


def rsi_controller(told: Told, rng: random.Random, controller: RsiController) -> None:
    """Our controller of a server."""
    def answer(ipoc: str, words: Sequence[str]) -> bytes:
        axes = " ".join(f'A{i + 1}="{word}"' for i, word in enumerate(words))
        return f'<Sen Type="ImFree"><AK {axes}/><IPOC>{ipoc}</IPOC></Sen>'.encode()

    words = ["0.1234"] * 6
    sound = [answer("77", words)] * EPISODE

    def changed(_: int) -> bytes:
        if rng.random() < 0.5:
            return answer(rng.choice((*_ODD_WORDS, "77", str(rng.getrandbits(70)))), words[: rng.randrange(8)])
        return answer("77", [rng.choice((*_ODD_WORDS, word, word, word)) for word in words])

    wire: Any = Wire(episode(sound, changed, rng), told, ("127.0.0.1", 5))
    while wire.pieces:
        correction = controller.answer(wire, 77, time.perf_counter() + 0.001)
        told.taken += correction is not None
        if correction is not None and not (correction.shape == (6,) and np.isfinite(correction).all()):
            raise SystemExit("a correction that is none was taken")


def netft(told: Told, rng: random.Random) -> None:
    """Our client of ATI's box."""
    layout = "III" + 6 * "i"
    values = [[k, 28 * k, 0, *range(6)] for k in range(EPISODE)]
    sound = [struct.pack(f">{layout}", *row) for row in values]

    def changed(k: int) -> bytes:
        return b"".join(fields(layout, values[k], rng) for _ in range(rng.choice((1, 1, 2, 40, 41))))

    wire = Wire(episode(sound, changed, rng), told)
    with mock.patch("socket.socket", new=_giving(wire)):
        device = NetFT("127.0.0.1")
    while wire.pieces:
        _readings(device.read(0.001), told)


def _package(kind: int, stamp: float, payload: bytes) -> bytes:
    return struct.pack(">2sBBId", b"IR", 1, kind, len(payload), stamp) + payload


def _stream(hello: bytes, kind: int, layout: str, rest: bytes, rng: random.Random) -> list[tuple[bytes, int]]:
    """What a device behind our own stream says: what it is, its clock, and packages of a kind."""
    begun = [hello, _package(6, 0.0, struct.pack(">d", time.perf_counter()))]
    values = [[k, 16, 16] if kind == 2 else [k, *range(6)] for k in range(EPISODE)]
    sound = [*begun, *(_package(kind, 0.02 * entry[0], struct.pack(f">{layout}", *entry) + rest) for entry in values)]

    def changed(k: int) -> bytes:
        if rng.random() < 0.4 or k < len(begun):
            return fields("BBBBId", [*b"IR", 1, sound[k][3], len(sound[k]) - 16, 0.02 * k], rng) + sound[k][16:]
        payload = fields(layout, values[k - len(begun)], rng)
        return _package(kind, odd("d", 0.02 * k, rng), payload + rest[: rng.choice((len(rest), rng.randrange(300)))])

    return episode(sound, changed, rng)


def stream_force(told: Told, rng: random.Random) -> None:
    """Our client of a force sensor behind our own stream."""
    wire = Wire(_stream(_package(3, 0.0, struct.pack(">d", 250.0)), 4, "Idddddd", b"", rng), told)
    with mock.patch("socket.create_connection", new=_giving(wire)), mock.patch("time.sleep", new=_at_once):
        device = StreamForce("127.0.0.1", 1, 0.002)
        while wire.pieces and device._connection._socket is not None:
            _readings(device.read(0.001), told)


def stream_camera(told: Told, rng: random.Random) -> None:
    """Our client of a camera behind our own stream."""
    wire = Wire(_stream(_package(1, 0.0, camera_description(16, 16, 50.0)), 2, "IHH", bytes(256), rng), told)
    with mock.patch("socket.create_connection", new=_giving(wire)), mock.patch("time.sleep", new=_at_once):
        device = StreamCamera("127.0.0.1", 1, 0.002)
        while wire.pieces and device._connection._socket is not None:
            frame = device.read(0.001)
            told.taken += frame is not None
            if frame is not None and not (frame.image.shape == (device.height, device.width)
                                          and math.isfinite(frame.stamp)):
                raise SystemExit("a picture that is none was taken")


def _readings(readings: Sequence[Any], told: Told) -> None:
    told.taken += len(readings)
    for reading in readings:
        if not (np.isfinite(reading.wrench).all() and math.isfinite(reading.stamp)):
            raise SystemExit("a reading that is none was taken")


@contextmanager
def watched(name: str, seed: int) -> Iterator[None]:
    """Ends the study where an episode hangs, with the seed of it."""
    def hangs(*_: object) -> None:
        raise SystemExit(f"{name}, seed {seed}: hangs")

    signal.signal(signal.SIGALRM, hangs)
    signal.alarm(HANG)
    try:
        yield
    finally:
        signal.alarm(0)


def mutations(count: int = 1_000_000, first: int = 0) -> None:
    """A million packets each, mutated by the structure of their protocol, on both sides of RTDE, RSI, NetFT and stream.

    Each episode is drawn from its seed alone: a sound connection of thirty packets, a part of them with odd values in
    their fields, other types, sizes and names, out of order, doubled or cut. Exit code 1 where anything but a refusal
    came of one, an episode hung, or the memory grew by more than 20 MiB after the first tenth.
    """
    warnings.simplefilter("ignore")
    grown = 0.0
    head("protocol", "mutated packets read", "of", "taken", "connections", "time", "memory grew")
    with SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(0)) as arm:
        rtde, rsi = RtdeController(arm), RsiController(arm, ("127.0.0.1", 1))
        state = arm.cycle(ROBOT.home)
        for name, play in (("RTDE, client", rtde_client),
                           ("RTDE, controller", lambda told, rng: rtde_controller(told, rng, rtde, state)),
                           ("RSI, server", rsi_server),
                           ("RSI, controller", lambda told, rng: rsi_controller(told, rng, rsi)),
                           ("NetFT", netft), ("stream, force", stream_force), ("stream, camera", stream_camera)):
            told, seed, begun, before = Told(), first, time.monotonic(), math.nan
            while told.mutated < count:
                with watched(name, seed):
                    _played(play, told, random.Random(seed))
                seed += 1
                if math.isnan(before) and told.mutated > count // 10:
                    before = resident()
            grown = max(grown, resident() - before)
            row(name, f"{told.mutated:,}", f"{told.packets:,}", f"{told.taken:,}", f"{seed - first:,}",
                f"{time.monotonic() - begun:.0f} s", f"{resident() - before:.1f} MiB")
        rtde.close()
    raise typer.Exit(grown > MOST_GROWTH)


def _played(play: Callable[[Told, random.Random], None], told: Told, rng: random.Random) -> None:
    """An episode; a refusal is what it may end with."""
    with suppress(IdealRobotError, ClientError):
        play(told, rng)
