"""Mutated, cut, replayed and foreign packets on every socket of the program."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np
import typer

from ideal_robot.deadline import Deadline
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.rtde.wire import Kind, Recipe, RtdeConnection, RtdeError
from ideal_robot.rtde.wire import package as rtde_package
from scenes.rsi.server import RsiServer
from sensing import SensingError
from sensing.camera.cameras import StreamCamera
from sensing.force.sensors import NetFT, StreamForce
from sensing.stream import Reader, StreamError
from sim.devices.stream_server import NetFTServer, StreamServer, camera_description
from studies.report import resident
from tests.sim.devices.controllers import LaggingController, playing
from tests.sim.devices.controllers import mutated as mutated_rsi

BURST = 60
"""Packets between two cycles of RSI: what fits into a socket's buffer beside the controller's own."""
MOST_GROWTH = 20.0
"""[MiB]"""
HEADER = struct.Struct(">2sBBId")


def rsi_packets(packets: int = 1_000_000) -> None:
    """A million hostile packets on the RSI server's port while it leads an arm.

    Prints what was counted, whether one command differs from those of the path, and how the memory grew. Exit code 1
    where a command changed.
    """
    robot, rng = Robot.load("kr6"), np.random.default_rng(0)
    cycles = packets // BURST + 1
    t = robot.t_ipo * np.arange(cycles)
    path = robot.home + 0.1 * (1 - np.cos(t))[:, None] * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    grown, old = list[float](), [b""]
    with (RsiRobot(robot, port=0, timeout=20.0) as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger):

        def beside(k: int, packet: bytes) -> list[bytes]:
            if k in (cycles // 10, cycles - 2):
                grown.append(resident())
            for _ in range(BURST - 2 if k else 0):
                stranger.sendto(mutated_rsi(packet, rng), link.address)
            again, old[0] = old[0], packet
            return [packet[: int(rng.integers(1, 300))], again] if k else []

        controller = LaggingController(link.axes.angles(robot.home), beside=beside)
        server = RsiServer(link, PassThrough(robot.t_ipo), path, 1)
        with playing(controller, link.address):
            run = server.play(patience=20.0)
    q_c = run.recording.joints("q_c")
    off = float(np.abs(q_c - path[: len(q_c)]).max())
    print(f"{run.counts['foreign']} foreign, {run.counts['refused']} refused, {run.counts['outdated']} outdated in "
          f"{len(q_c)} of {cycles} cycles; largest change of a command: {off:.1e} rad; ended: "
          f"{run.failure or 'path complete'}; memory after a tenth and at the end: "
          f"{', '.join(f'{mib:.1f}' for mib in grown)} MiB")
    raise typer.Exit(run.failure is not None or off > 1e-9)


def packets(count: int = 1_000_000) -> None:
    """A million hostile packets each on the sockets of cameras, force sensors, RTDE and the served devices.

    Prints what became of them and how the memory went. Exit code 1 where anything but a refusal came of one, or the
    memory grew by more than 20 MiB.
    """
    rng, grown = np.random.default_rng(1), 0.0
    hello = _package(1, 0.0, camera_description(16, 16, 50.0))
    force_hello = _package(3, 0.0, struct.pack(">d", 250.0))
    for name, play in (("rtde", lambda n: _rtde(n, rng)), ("stream, parser", lambda n: _parser(n, rng)),
                       ("stream, camera", lambda n: _over_tcp(_field, hello, _camera, n, rng)),
                       ("stream, force", lambda n: _over_tcp(_wrench, force_hello, _force, n, rng)),
                       ("netft", lambda n: _netft(n, rng)), ("servers", lambda n: _servers(n, rng))):
        try:
            play(max(count // 10, 100))
            before = resident()
            result = play(count)
        except SensingError as error:
            raise SystemExit(f"{name}: {error}") from error
        grown = max(grown, resident() - before)
        print(f"{name}: {result}; memory {before:.0f} MiB after a tenth, {resident():.0f} MiB at the end", flush=True)
    raise typer.Exit(grown > MOST_GROWTH)


def _package(kind: int, stamp: float, payload: bytes) -> bytes:
    return HEADER.pack(b"IR", 1, kind, len(payload), stamp) + payload


def _wrench(k: int) -> bytes:
    return _package(4, 0.004 * k, struct.pack(">I6d", k, *range(6)))


def _field(k: int) -> bytes:
    return _package(2, 0.02 * k, struct.pack(">IHH", k, 16, 16) + bytes(256))


def _mutated(sound: Callable[[int], bytes], count: int, rng: np.random.Generator) -> Iterator[bytes]:
    """Packets with a few bytes changed, cut short, or as they were."""
    for k in range(count):
        packet = bytearray(sound(k))
        for place in rng.integers(0, len(packet), rng.integers(0, 4)):
            packet[place] = rng.integers(0, 256)
        yield bytes(packet[: rng.integers(1, len(packet) + 1)] if rng.random() < 0.2 else packet)


def _parser(count: int, rng: np.random.Generator) -> str:
    """The stream's parser, without a socket."""
    refused = packages = 0
    reader = Reader()
    for packet in _mutated(_wrench, count, rng):
        try:
            packages += len(list(reader.feed(packet)))
        except StreamError:
            refused, reader = refused + 1, Reader()
        if len(reader._waiting) > 5 << 20:
            raise SystemExit("the parser holds more than one package")
    return f"{packages} packages, {refused} streams refused"


def _over_tcp(sound: Callable[[int], bytes], hello: bytes, read: Callable[[str, int], Callable[[], object]],
              count: int, rng: np.random.Generator) -> str:
    """A client whose device is hostile: connection after connection."""
    sent = connections = taken = 0
    stopped = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.2)

    def serve() -> None:
        nonlocal sent, connections
        while sent < count and not stopped.is_set():
            try:
                client, _ = listener.accept()
            except TimeoutError:
                continue
            connections += 1
            client.settimeout(2.0)
            try:
                # Its clock is told at once, so that what follows is taken as far as it is sound.
                client.sendall(hello + _package(6, 0.0, struct.pack(">d", time.perf_counter())))
                for packet in _mutated(sound, 400, rng):
                    client.sendall(packet)
                    sent += 1
            except OSError:
                sent += 1
            client.close()
        stopped.set()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    take = read(*listener.getsockname())
    while not stopped.is_set():
        taken += take() is not None
    thread.join(5.0)
    listener.close()
    return f"{sent} sent in {connections} connections, {taken} taken"


def _camera(host: str, port: int) -> Callable[[], object]:
    device = StreamCamera(host, port)

    def take() -> object:
        device._connection._tried = 0.0
        frame = device.read(0.05)
        if frame is not None and frame.image.shape != (16, 16):
            raise SystemExit("a picture of another size was taken")
        return frame

    return take


def _force(host: str, port: int) -> Callable[[], object]:
    device = StreamForce(host, port)

    def take() -> object:
        device._connection._tried = 0.0
        readings = device.read(0.05)
        if readings and not np.isfinite(readings[0].wrench).all():
            raise SystemExit("a wrench that is none was taken")
        return readings or None

    return take


def _netft(count: int, rng: np.random.Generator) -> str:
    """NetFT's socket: mutated records of the sensor's own address, and as many of another."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link, socket.socket(
            socket.AF_INET, socket.SOCK_DGRAM) as foreign:
        link.bind(("127.0.0.1", 0))
        device = NetFT(*link.getsockname())
        client = link.recvfrom(64)[1]
        taken = 0
        for packet in _mutated(lambda k: struct.pack(">IIIiiiiii", k, 28 * k, 0, *range(6)), count, rng):
            link.sendto(packet, client)
            foreign.sendto(packet, client)
            for reading in device.read(0.001):
                taken += 1
                if not (np.isfinite(reading.wrench).all() and np.isfinite(reading.stamp)):
                    raise SystemExit("a reading that is none was taken")
        device.close()
    return f"{taken} readings taken, counts {device.counts}"


def _rtde(count: int, rng: np.random.Generator) -> str:
    """A client of RTDE whose controller agrees to everything and then sends mutated data packages."""
    fields, codes = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D"}, b"\1DOUBLE,VECTOR6D"
    agreed = [rtde_package(Kind.VERSION, b"\1"), rtde_package(Kind.CONTROLLER, struct.pack(">4I", 5, 11, 0, 0)),
              rtde_package(Kind.OUTPUTS, codes), rtde_package(Kind.START, b"\1")]
    recipe = Recipe.agreed(fields, codes)
    packets = _mutated(lambda k: recipe.packed(0.008 * k, *range(6)), count, rng)
    connections = taken = 0
    with socket.create_server(("127.0.0.1", 0)) as listener:
        while some := list(islice(packets, 50)):
            link = RtdeConnection("127.0.0.1", listener.getsockname()[1], 2.0)
            connections += 1
            with listener.accept()[0] as controller:
                controller.sendall(b"".join([*agreed, *some]))
                # Nothing more comes: what is not whole by then is not waited for.
                controller.shutdown(socket.SHUT_WR)
                try:
                    link.agree()
                    outputs = link.outputs(fields, 125.0)
                    link.start()
                    while True:
                        data, _ = link.newest(outputs, Deadline.within(2.0))
                        taken += 1
                        if set(data) != set(fields):
                            raise SystemExit("data that are none were taken")
                except RtdeError:
                    link.close()
    return f"{connections} connections, {taken} packages taken"


def _servers(count: int, rng: np.random.Generator) -> str:
    """The simulated devices' own sockets."""
    stream = StreamServer("127.0.0.1", 0, lambda: 0.0, 1, camera_description(16, 16, 50.0))
    box, ended = NetFTServer("127.0.0.1", 0), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        client: socket.socket | None = None
        for packet in _mutated(lambda k: _package(5, 0.0, struct.pack(">d", float(k))), count, rng):
            link.sendto(packet[:64], box.address)
            try:
                if client is None:
                    client = socket.create_connection(stream.address, 2.0)
                    client.settimeout(0.5)
                client.sendall(packet)
                client.setblocking(False)
                while client.recv(65536):
                    pass
                raise ConnectionError
            except BlockingIOError:
                if client is not None:
                    client.settimeout(0.5)
            except OSError:
                ended += 1
                if client is not None:
                    client.close()
                client = None
    stream.close()
    box.close()
    return f"{ended} connections were ended by the server"
