"""The project's own stream of device data: addresses, packages, and the client side.

The wire format of our own stream: packages with stamps over TCP, and a parser of bounded memory.

All numbers are big-endian. A package is a header of 16 bytes and its payload:

====== ======== =========================================================================================
offset type     meaning
====== ======== =========================================================================================
0      2 bytes  ``IR``
2      uint8    version, 1
3      uint8    kind
4      uint32   bytes of payload, at most 4 MiB
8      float64  stamp by the sender's clock [s]: mid-exposure, instant of measurement, or of sending
====== ======== =========================================================================================

====== ========== =============== =============================================================================
kind   name       from            payload
====== ========== =============== =============================================================================
1      camera     device          uint16 width, uint16 height, float64 rate [Hz], float64 × 9 camera matrix row by
                                  row, float64 × 5 distortion k1 k2 p1 p2 k3; NaN where not known
2      field      device          uint32 number, uint16 width, uint16 height, gray values row by row, uint8
3      sensor     device          float64 rate [Hz]
4      wrench     device          uint32 number, float64 × 6: force [N] and moment [N m]
5      ask        client          float64, anything; the device answers at once
6      told       device          the same 8 bytes; the stamp is the device's clock when it answered
====== ========== =============== =============================================================================

A device sends what it is (1 or 3) first, then fields or wrenches as they come. Other kinds are passed over. With ask
and told the client finds how the clocks relate without knowing any delay: half of the way there and back. The device
has to send small packages at once (``TCP_NODELAY``).
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

from ideal_robot.deadline import Deadline
from ideal_robot.errors import BAD_ADDRESS, InputError
from sensing import SensingError
from sensing.clock_relation import ClockRelation

HEADER = struct.Struct(">2sBBId")
MAGIC, VERSION = b"IR", 1
LARGEST = 4 << 20
"""Bytes of payload that are taken at most."""


class StreamError(SensingError):
    """The data on the socket are not of this stream format, or the connection is broken."""


class Kind(IntEnum):
    """Number in a package's header that says what the payload is."""

    CAMERA = 1
    FIELD = 2
    SENSOR = 3
    WRENCH = 4
    ASK = 5
    TOLD = 6


@dataclass(frozen=True)
class Package:
    """One package: its kind, see the table, its stamp by the sender's clock [s], and its payload as it came."""

    kind: int
    stamp: float
    payload: bytes


def _packed(kind: Kind, stamp: float, payload: bytes = b"") -> bytes:
    """A package as it goes over the wire, stamped by the sender's clock [s]."""
    return HEADER.pack(MAGIC, VERSION, kind, len(payload), stamp) + payload


class Reader:
    """Cuts arriving bytes into packages; stores at most one package and the rest of a read."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, piece: bytes) -> Iterator[Package]:
        """The packages that are complete with these bytes.

        After the complete packages it raises ``StreamError`` for another format, another version, or a package too
        large. The connection is of no use then.
        """
        self._waiting += piece
        while len(self._waiting) >= HEADER.size:
            magic, version, kind, size, stamp = HEADER.unpack_from(self._waiting)
            if magic != MAGIC or version != VERSION:
                raise StreamError("the received data are not a stream of version 1 (see docs/follow.md)")
            if size > LARGEST:
                raise StreamError(f"a package of {size} bytes, at most {LARGEST} are taken")
            if len(self._waiting) < HEADER.size + size:
                break
            payload = bytes(self._waiting[HEADER.size : HEADER.size + size])
            del self._waiting[: HEADER.size + size]
            yield Package(kind, stamp, payload)


ASKED_EVERY = 0.1
"""Time between two questions for the device's clock [s]."""
AGAIN = 0.5
"""Time between two attempts to connect [s]."""
_CONNECTS = 0.5
"""Time that an attempt to connect may take, or as long as is waited if that is less [s]."""
_LEAST = 1e-3
"""A timeout of a socket that waits at all [s]."""
_PIECE = 1 << 18  # bytes per read
_FORGET = 1.001
"""Growth of the quickest time a question, so that a network that has become slower is believed in the end."""


class StreamConnection:
    """Receives the packages of one device; raises ``InputError`` where no one listens at its address.

    Args:
        host, port: address of the device, and TCP port.
        patience: how long the first connection is tried [s].

    Attributes:
        clock: how the device's clock relates to this computer's; no delay has to be known.
        described: the package that says what the device is, once it came.
        broken: number of times the connection broke.
    """

    def __init__(self, host: str, port: int, patience: float = 5.0) -> None:
        self._where, self.clock, self.broken = (host, port), ClockRelation(), 0
        self.described: Package | None = None
        self._found: list[Package] = []
        self._socket: socket.socket | None = None
        self._tried = self._asked = 0.0
        self._quickest = float("inf")
        deadline = Deadline.within(patience)
        while not self._connected(_CONNECTS):
            if deadline.passed:
                raise InputError("no device listens there", field="host:port", value=f"{host}:{port}")
            time.sleep(0.1)

    def next(self, timeout: float) -> Package | None:
        """The next field or wrench; None if none comes within ``timeout`` [s].

        A connection that breaks, or brings what is no stream, is closed and tried again from then on.
        """
        deadline = Deadline.within(timeout)
        while not self._found:
            if deadline.passed:
                return None
            if self._socket is None and not self._again(deadline.left):
                time.sleep(min(deadline.left, 0.05))
                continue
            self._read(min(deadline.left, ASKED_EVERY))
        return self._found.pop(0)

    def close(self) -> None:
        """Ends the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected(self, timeout: float) -> bool:
        self._tried = time.perf_counter()
        try:
            self._socket = socket.create_connection(self._where, max(timeout, _LEAST))
        except BAD_ADDRESS:
            return False
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._reader, self._quickest = Reader(), float("inf")
        return True

    def _again(self, left: float) -> bool:
        return time.perf_counter() - self._tried > AGAIN and self._connected(min(left, _CONNECTS))

    def _read(self, timeout: float) -> None:
        link = self._socket
        if link is None:
            return
        try:
            now = time.perf_counter()
            if now - self._asked > ASKED_EVERY:
                self._asked = now
                link.sendall(_packed(Kind.ASK, now, struct.pack(">d", now)))
            link.settimeout(max(timeout, _LEAST))
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
            # A slow exchange does not show which direction was slow. The least delay is half of the quickest exchange;
            # an answer alone never takes less. A question that waited is not used.
            self._quickest = min(self._quickest * _FORGET, took)
            self.clock.least_delay = 0.5 * self._quickest
            self.clock.add(package.stamp, arrived)


def host_and_port(rest: str, field: str, port: int | None = None) -> tuple[str, int]:
    """Host and port of ``//host:port``; raises ``InputError`` for another form.

    Args:
        rest: the address without its scheme and the colon.
        field: name of the setting that holds the address, for error messages.
        port: usual one; it must be given if None.
    """
    place = rest.removeprefix("//").partition("?")[0].rstrip("/")
    host, colon, number = place.rpartition(":")
    if not colon and port is not None:
        host, number = place, str(port)
    usable = number.isascii() and number.isdigit() and 0 < int(number[:6]) < 65536
    if not rest.startswith("//") or not host or not usable:
        raise InputError("expected an address such as stream://192.168.1.30:50000", field=field, value=rest[:80])
    return host.strip("[]"), int(number)


def options(rest: str, known: dict[str, float], field: str) -> dict[str, float]:
    """The numbers behind the question mark of an address, ``?rate=7000&counts_force=1e6``.

    Raises ``InputError`` for another name, or no positive number.

    Args:
        rest: the address without its scheme and the colon.
        known: names that may be given, with their usual values.
        field: name of the setting that holds the address, for error messages.
    """
    numbers = dict(known)
    for piece in filter(None, rest.partition("?")[2].split("&")):
        name, _, text = piece.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if name not in known or not 0.0 <= value < 1e12:
            raise InputError(f"expected one of {', '.join(known)}, each with = and a number", field=field,
                             value=piece[:40])
        numbers[name] = value
    return numbers
