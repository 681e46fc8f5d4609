"""A client's side of a stream: connects, asks for the device's clock, and connects again where it breaks."""

from __future__ import annotations

import socket
import struct
import time

from ideal_robot.errors import InputError
from sensing.clock.clock_relation import ClockRelation
from sensing.stream.package import Kind, Package, Reader, StreamError, packed

ASKED_EVERY = 0.1
"""Time between two questions for the device's clock [s]."""
AGAIN = 0.5
"""Time between two attempts to connect [s]."""
_PIECE = 1 << 18
_FORGET = 1.001
"""Growth of the quickest time a question, so that a network that has become slower is believed in the end."""


class StreamConnection:
    """Packages of one device.

    Args:
        host: address of the device.
        port: TCP port.
        patience: how long the first connection is tried [s].

    Raises:
        InputError: no one listens there.

    Attributes:
        clock: how the device's clock relates to this computer's; no delay has to be known.
        described: the package that says what the device is, once it came.
        broken: how often the connection broke.
    """

    def __init__(self, host: str, port: int, patience: float = 5.0) -> None:
        self._where, self.clock, self.broken = (host, port), ClockRelation(), 0
        self.described: Package | None = None
        self._found: list[Package] = []
        self._socket: socket.socket | None = None
        self._tried = self._asked = 0.0
        self._quickest = float("inf")
        end = time.perf_counter() + patience
        while not self._connected():
            if time.perf_counter() > end:
                raise InputError("no device listens there", field="host:port", value=f"{host}:{port}")
            time.sleep(0.1)

    def next(self, timeout: float) -> Package | None:
        """The next field or wrench; None if none comes within ``timeout`` [s].

        A connection that breaks, or brings what is no stream, is closed and tried again from then on.
        """
        end = time.perf_counter() + timeout
        while not self._found:
            now = time.perf_counter()
            if now >= end:
                return None
            if self._socket is None and not self._again(now):
                time.sleep(min(end - now, 0.05))
                continue
            self._read(min(end - now, ASKED_EVERY))
        return self._found.pop(0)

    def close(self) -> None:
        """Ends the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected(self) -> bool:
        self._tried = time.perf_counter()
        try:
            self._socket = socket.create_connection(self._where, 0.5)
        except (OSError, OverflowError):
            return False
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._reader, self._quickest = Reader(), float("inf")
        return True

    def _again(self, now: float) -> bool:
        return now - self._tried > AGAIN and self._connected()

    def _read(self, timeout: float) -> None:
        link = self._socket
        if link is None:
            return
        try:
            now = time.perf_counter()
            if now - self._asked > ASKED_EVERY:
                self._asked = now
                link.sendall(packed(Kind.ASK, now, struct.pack(">d", now)))
            link.settimeout(max(timeout, 1e-3))
            piece = link.recv(_PIECE)
            if not piece:
                raise StreamError("the device has closed the connection")
            arrived = time.perf_counter()
            for package in self._reader.feed(piece):
                self._take(package, arrived)
        except TimeoutError:
            return
        except (OSError, StreamError):
            self.broken += 1
            self.close()

    def _take(self, package: Package, arrived: float) -> None:
        if package.kind in (Kind.FIELD, Kind.WRENCH):
            self._found.append(package)
        elif package.kind in (Kind.CAMERA, Kind.SENSOR):
            self.described = package
        elif package.kind == Kind.TOLD and len(package.payload) == 8:
            took = arrived - struct.unpack(">d", package.payload)[0]
            if not 0.0 <= took < 1.0:
                return
            # Of a slow exchange it is not known which way was slow. What the answer alone took is never below the
            # least, half of the quickest exchange; a question that waited does not count at all.
            self._quickest = min(self._quickest * _FORGET, took)
            self.clock.least_delay = 0.5 * self._quickest
            self.clock.add(package.stamp, arrived)
