"""The device side of the project's own stream (docs/follow.md), for simulated cameras and force sensors.

Written from the table of the wire format alone, without the code that parses on the other side.
"""

from __future__ import annotations

import heapq
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError

_HEADER = struct.Struct(">2sBBId")
_CAMERA, _FIELD, _SENSOR, _WRENCH, _ASK, _TOLD = 1, 2, 3, 4, 5, 6  # kinds of packages
_MOST = 8
"""Clients at a time."""
_QUESTION = _HEADER.size + 8  # bytes of a clock request


def camera_description(width: int, height: int, rate: float) -> bytes:
    """Payload of the package that describes the camera, without its lens.

    Args:
        width: columns [px].
        height: rows [px].
        rate: pictures a second [Hz].
    """
    return struct.pack(">HHd14d", width, height, rate, *([float("nan")] * 14))


def field_payload(number: int, width: int, height: int, gray: bytes) -> bytes:
    """Payload of a picture.

    Args:
        number: running number of the picture.
        width: columns [px].
        height: rows [px].
        gray: gray values row by row.
    """
    return struct.pack(">IHH", number % 2**32, width, height) + gray


class StreamServer:
    """Sends packages to every connected client, and answers their clock requests.

    Args:
        host, port: address of ours to listen on, and TCP port; 0 for any free one.
        clock: function that returns the time that the device's clock shows now [s].
        kind, description: 1 for a camera, 3 for a sensor, and payload of the package that says so.
    """

    def __init__(self, host: str, port: int, clock: Callable[[], float], kind: int, description: bytes) -> None:
        self._clock, self._hello = clock, _HEADER.pack(b"IR", 1, kind, len(description), 0.0) + description
        self._listener = socket.create_server((host, port))
        self._listener.settimeout(0.2)
        self._clients: dict[socket.socket, threading.Lock] = {}
        self._closed = False
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which it listens."""
        host, port = self._listener.getsockname()
        return str(host), int(port)

    @property
    def watched(self) -> bool:
        """Whether a client is connected."""
        return bool(self._clients)

    def send(self, kind: int, stamp: float, payload: bytes) -> None:
        """Sends one package to every client; a client that blocks for a tenth of a second is disconnected.

        Args:
            kind: 2 for a field, 4 for a wrench.
            stamp: by the device's clock [s].
            payload: of that kind.
        """
        package = _HEADER.pack(b"IR", 1, kind, len(payload), stamp) + payload
        for client, lock in list(self._clients.items()):
            try:
                with lock:
                    client.sendall(package)
            except OSError:
                self._leave(client)

    def close(self) -> None:
        """Stops listening and disconnects every client."""
        self._closed = True
        self._listener.close()
        for client in list(self._clients):
            self._leave(client)

    def _accept(self) -> None:
        while not self._closed:
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            if len(self._clients) >= _MOST:
                client.close()
                continue
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # Sending waits this long for a slow client; reading its requests sets its own time again.
            client.settimeout(0.1)
            with suppress(OSError):
                client.sendall(self._hello)
                self._clients[client] = threading.Lock()
                threading.Thread(target=self._answer, args=(client,), daemon=True).start()

    def _answer(self, client: socket.socket) -> None:
        waiting = b""
        while not self._closed and client in self._clients:
            try:
                piece = client.recv(1024)
            except TimeoutError:
                continue
            except OSError:
                break
            if not piece:
                break
            waiting += piece
            while len(waiting) >= _QUESTION:
                magic, version, kind, size, _ = _HEADER.unpack_from(waiting)
                if (magic, version, kind, size) != (b"IR", 1, _ASK, 8):
                    self._leave(client)
                    return
                echo, waiting = waiting[_HEADER.size : _QUESTION], waiting[_QUESTION:]
                lock = self._clients.get(client)
                if lock is None:
                    return
                with suppress(OSError), lock:
                    client.sendall(_HEADER.pack(b"IR", 1, _TOLD, 8, self._clock()) + echo)
        self._leave(client)

    def _leave(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        client.close()


# The sensor's side of ATI's raw data transfer, for a simulated force sensor; from the manual's tables alone.

COUNTS_FORCE, COUNTS_TORQUE = 1_000_000, 1_000_000
"""Counts per newton and per newton metre."""
_MAX = 2**31 - 1  # largest count, an int32


class NetFTServer:
    """Streams records to the client with the last request; port 0 chooses a free one."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self._socket.settimeout(0.2)
        self._client: tuple[str, int] | None = None
        self._number, self._closed = 0, False
        threading.Thread(target=self._listen, daemon=True).start()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which it listens."""
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def record(self, sample: int, wrench: Array) -> bytes:
        """Encodes the next record: number of the sensor's sample, force [N] and moment [N m] ``(6,)``."""
        self._number += 1
        scales = (COUNTS_FORCE,) * 3 + (COUNTS_TORQUE,) * 3
        counts = (max(-_MAX, min(_MAX, round(float(w) * scale))) for w, scale in zip(wrench, scales, strict=True))
        return struct.pack(">IIIiiiiii", self._number % 2**32, sample % 2**32, 0, *counts)

    def send(self, record: bytes) -> None:
        """Sends one record, if a client has requested the stream."""
        client = self._client
        if client is not None and not self._closed:
            try:
                self._socket.sendto(record, client)
            except OSError:
                return

    def close(self) -> None:
        """Stops the stream and closes the socket."""
        self._closed = True
        self._socket.close()

    def _listen(self) -> None:
        while not self._closed:
            try:
                request, client = self._socket.recvfrom(64)
            except TimeoutError:
                continue
            except OSError:
                if self._closed:
                    return
                continue
            if len(request) == 8 and request[:2] == b"\x12\x34":
                command = struct.unpack(">H", request[2:4])[0]
                self._client = client if command == 2 else None if client == self._client else self._client


# Simulated faults of clocks and networks: offset and drift, packets that are late, lost and doubled.

def now() -> float:
    """Time of this computer's clock ``time.perf_counter``, used for all of these devices [s]."""
    return time.perf_counter()


@dataclass(frozen=True)
class Unkindness:
    """Sizes of the simulated faults of clocks and network.

    Attributes:
        drift: by how much each device's clock runs fast, with a sign of its own (relative).
        offset: between the clocks, with a sign of its own [s].
        loss, doubled: probabilities that a packet is lost, and that it comes twice.
        late, late_share: how much later a packet comes that is late [s], and probability of that.
    """

    drift: float = 2e-5
    offset: float = 0.03
    loss: float = 0.0
    doubled: float = 0.0
    late: float = 0.03
    late_share: float = 0.0

    def __post_init__(self) -> None:
        for name in ("loss", "doubled", "late_share"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise InputError("expected a probability from 0 to below 1", field=name, value=getattr(self, name))
        if not (abs(self.drift) <= 1e-3 and self.offset >= 0.0 and 0.0 <= self.late <= 5.0):
            raise InputError("expected a drift of at most 1e-3, and an offset and a delay from 0 to 5 s",
                             field="drift, offset, late", value=(self.drift, self.offset, self.late))


class DeviceClock:
    """A clock of its own: shows ``offset`` [s] at ``begun``, and runs fast by ``drift`` (relative).

    Args:
        offset: time that it shows first [s].
        drift: by how much it runs fast (relative).
        begun: time of the start, by ``time.perf_counter`` [s]; now if None.
    """

    def __init__(self, offset: float, drift: float, begun: float | None = None) -> None:
        self._begun, self._offset, self.drift = time.perf_counter() if begun is None else begun, offset, drift

    def shows(self, host: float) -> float:
        """Reading of the device's clock [s] at ``host`` of this computer's ``time.perf_counter``."""
        return self._offset + (1.0 + self.drift) * (host - self._begun)


class Outbox:
    """Sends data at their due times from a thread of its own; ``rng`` draws the network's faults."""

    def __init__(self, unkind: Unkindness, rng: np.random.Generator) -> None:
        self._unkind, self._rng = unkind, rng
        self._waiting: list[tuple[float, int, Callable[[], None]]] = []
        self._count, self._closed, self._some = 0, False, threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, due: float, send: Callable[[], None]) -> None:
        """Schedules ``send`` for ``due`` of this computer's time; simulated faults drop, double or delay it."""
        with self._some:
            u = self._unkind
            lost, twice, late = self._rng.random(3) < (u.loss, u.doubled, u.late_share)
            for _ in range(0 if lost else 2 if twice else 1):
                self._count += 1
                heapq.heappush(self._waiting, (due + (u.late if late else 0.0), self._count, send))
            self._some.notify()

    def close(self) -> None:
        """Stops sending."""
        with self._some:
            self._closed = True
            self._some.notify()
        self._thread.join(2.0)

    def _run(self) -> None:
        while True:
            with self._some:
                if self._closed:
                    return
                if not self._waiting:
                    self._some.wait(0.5)
                    continue
                remaining = self._waiting[0][0] - time.perf_counter()
                if remaining > 0:
                    self._some.wait(remaining)
                    continue
                send = heapq.heappop(self._waiting)[2]
            send()
