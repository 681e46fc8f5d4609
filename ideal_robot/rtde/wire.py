"""UR's RTDE protocol: packages with a header of size and kind, and recipes of the fields in data packages.

Everything is big-endian. Written from Universal Robots' public description of the Real-Time Data Exchange.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from itertools import islice

from ideal_robot.deadline import Deadline
from ideal_robot.errors import BAD_ADDRESS, IdealRobotError


class RtdeError(IdealRobotError):
    """The connection cannot continue; the controller's own program decides about the arm."""


MAX_PACKAGE = 4096
"""Largest package that is read [bytes]; the field names of a recipe have 2048 at most."""
_HEADER = struct.Struct(">HB")
_FORMATS = {"UINT32": "I", "INT32": "i", "DOUBLE": "d", "VECTOR3D": "3d", "VECTOR6D": "6d"}
_REFUSALS = {"NOT_FOUND": "the controller does not know it", "IN_USE": "another client writes it"}

Values = dict[str, tuple[float, ...]]
"""Numbers of a data package by the name of their field."""


class Kind(IntEnum):
    """Kinds of packages: the letter of their header."""

    VERSION = ord("V")
    CONTROLLER = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


def package(kind: Kind, payload: bytes = b"") -> bytes:
    """A package with its header."""
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


class Reader:
    """Extracts packages from a stream of bytes that arrives in any parts."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, piece: bytes) -> None:
        """Adds bytes that were read from the stream."""
        self._bytes += piece

    def next(self) -> tuple[int, bytes] | None:
        """Kind and payload of the next package, None while it is incomplete; RtdeError for an impossible size."""
        if len(self._bytes) < _HEADER.size:
            return None
        size, kind = _HEADER.unpack_from(self._bytes)
        if not _HEADER.size <= size <= MAX_PACKAGE:
            raise RtdeError(f"a package of {size} bytes: the other side does not speak RTDE")
        if len(self._bytes) < size:
            return None
        payload = bytes(self._bytes[_HEADER.size : size])
        del self._bytes[:size]
        return int(kind), payload


@dataclass(frozen=True)
class Recipe:
    """Fields of a data package.

    Attributes:
        number: the controller's number of the recipe; it is the first byte of every data package.
        names: names of the fields.
        layout: order and formats of the fields.
        counts: number of values in each field.
    """

    number: int
    names: tuple[str, ...]
    layout: struct.Struct
    counts: tuple[int, ...]

    @classmethod
    def agreed(cls, fields: Mapping[str, str], answer: bytes) -> Recipe:
        """The recipe from the controller's answer to a setup: its number, and the types of the fields.

        Raises RtdeError for a field that is unknown or already in use, another type or number of fields.
        """
        types = answer[1:].decode("ascii", "replace").split(",")
        refused = [f"{name}: {_REFUSALS.get(reply, f'{fields[name]} is expected, the controller says {reply[:20]!a}')}"
                   for name, reply in zip(fields, types, strict=False) if reply != fields[name]]
        if len(types) != len(fields) or not answer or (answer[0] == 0 and not refused):
            raise RtdeError(f"the controller's answer to the fields {', '.join(fields)} cannot be used "
                            f"({answer[:80]!a})")
        if refused:
            raise RtdeError("; ".join(refused))
        formats = [_FORMATS[kind] for kind in types]
        counts = tuple(int(text[:-1] or 1) for text in formats)
        return cls(answer[0], tuple(fields), struct.Struct(">" + "".join(formats)), counts)

    def unpacked(self, payload: bytes) -> Values:
        """Numbers of a data package by name of the field; raises RtdeError for another recipe, or another length."""
        if len(payload) != 1 + self.layout.size or payload[0] != self.number:
            raise RtdeError(f"a data package of {len(payload)} bytes does not fit recipe {self.number}")
        values = iter(self.layout.unpack_from(payload, 1))
        return {name: tuple(islice(values, count)) for name, count in zip(self.names, self.counts, strict=True)}

    def packed(self, *values: float) -> bytes:
        """Encodes a data package from the numbers of all fields in a row."""
        return package(Kind.DATA, bytes((self.number,)) + self.layout.pack(*values))


def said(payload: bytes) -> str:
    """Text of a text message."""
    length = payload[0] if payload else 0
    text = payload[1 : 1 + length].decode("utf-8", "replace")
    return "".join(letter if letter.isprintable() else " " for letter in text)


_VERSION = 2
"""Version of the protocol that is asked for: the first with a frequency of one's own."""


class RtdeConnection:
    """A client's side of RTDE.

    Args:
        host, port: address at which the controller listens.
        timeout: how long the controller has for an answer, whatever else it sends meanwhile [s].

    Raises:
        RtdeError: no one listens there.

    Attributes:
        texts: the last messages of the controller, ten at most.
    """

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self.texts: list[str] = []
        self._timeout, self._reader = timeout, Reader()
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except BAD_ADDRESS as error:
            raise RtdeError(f"no controller at {host}:{port} ({error}); RTDE has to be enabled in its security settings"
                            ) from error
        # A command is one small package, which must be sent at once.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def agree(self) -> tuple[int, int, int, int]:
        """Agrees on the protocol; returns the controller's version: major, minor, bug fix, build.

        Raises RtdeError where the controller does not know this version of the protocol.
        """
        if self._asked(Kind.VERSION, struct.pack(">H", _VERSION)) != b"\1":
            raise RtdeError(f"the controller does not know version {_VERSION} of RTDE; it needs PolyScope 3.4 or newer")
        self.send(package(Kind.CONTROLLER))
        answer = self._answer(Kind.CONTROLLER)
        if len(answer) != 16:
            raise RtdeError(f"the controller's version has {len(answer)} bytes, 16 are expected")
        major, minor, fix, build = struct.unpack(">4I", answer)
        return major, minor, fix, build

    def outputs(self, fields: Mapping[str, str], frequency: float, optional: Mapping[str, str] | None = None) -> Recipe:
        """Requests the fields that the controller sends, by names and types; raises as ``Recipe.agreed``.

        Args:
            fields: the fields that are needed.
            frequency: rate at which they are sent [Hz].
            optional: fields that are omitted where the controller does not have them.
        """
        wanted = {**fields, **(optional or {})}
        answer = self._asked(Kind.OUTPUTS, struct.pack(">d", frequency) + ",".join(wanted).encode())
        unknown = {name for name, kind in zip(wanted, answer[1:].decode("ascii", "replace").split(","), strict=False)
                   if kind == "NOT_FOUND" and name not in fields}
        if unknown:
            known = {name: kind for name, kind in wanted.items() if name not in unknown}
            return self.outputs(known, frequency)
        return Recipe.agreed(wanted, answer)

    def inputs(self, fields: Mapping[str, str]) -> Recipe:
        """Requests the input fields that this program writes, by names and types; raises as ``Recipe.agreed``."""
        return Recipe.agreed(fields, self._asked(Kind.INPUTS, ",".join(fields).encode()))

    def start(self) -> None:
        """Starts the data packages; raises RtdeError where the controller refuses."""
        if self._asked(Kind.START) != b"\1":
            raise RtdeError("the controller does not start to send" + self._last_text())

    def pause(self) -> None:
        """Asks the controller to send no more data packages; does not wait for its answer."""
        try:
            self._socket.sendall(package(Kind.PAUSE))
        except OSError:
            return

    def send(self, data: bytes) -> None:
        """Sends a data package; raises RtdeError where the connection is broken."""
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise RtdeError(f"the connection to the controller is lost ({error})" + self._last_text()) from error

    def newest(self, recipe: Recipe, deadline: Deadline) -> tuple[Values, float]:
        """The newest data package, waiting for one if needed, and the time of its reading.

        Raises RtdeError for silence, a broken connection, a package that does not fit.
        """
        payloads, arrived = self._data(deadline)
        return recipe.unpacked(payloads[-1]), arrived

    def every(self, recipe: Recipe, deadline: Deadline, quiet: bool = False) -> list[tuple[Values, float]]:
        """All available data packages with their times of reading, waiting for one if there is none.

        Args:
            recipe: of the packages.
            deadline: end of the wait for a packet.
            quiet: whether silence gives none, instead of an error.

        Raises:
            RtdeError: silence, a broken connection, a package that does not fit.
        """
        payloads, arrived = self._data(deadline, quiet)
        return [(recipe.unpacked(payload), arrived) for payload in payloads]

    def _data(self, deadline: Deadline, quiet: bool = False) -> tuple[list[bytes], float]:
        """Payloads of the data packages that are there, and when the first of them was read."""
        payloads: list[bytes] = []
        while not payloads:
            received = self._next(max(deadline.left, 0.0)) if quiet else self._package(deadline)
            if received is not None and received[0] == Kind.DATA:
                payloads.append(received[1])
            elif received is None and deadline.passed:
                return [], time.perf_counter()
        arrived = time.perf_counter()
        while not deadline.passed and (later := self._waiting()) is not None:
            payloads += [later[1]] if later[0] == Kind.DATA else []
        return payloads, arrived

    def close(self) -> None:
        """Ends the connection."""
        self._socket.close()

    def _asked(self, kind: Kind, payload: bytes = b"") -> bytes:
        self.send(package(kind, payload))
        return self._answer(kind)

    def _answer(self, kind: Kind) -> bytes:
        deadline = Deadline.within(self._timeout)
        while True:
            received, payload = self._package(deadline)
            if received == kind:
                return payload

    def _package(self, deadline: Deadline) -> tuple[int, bytes]:
        """Kind and payload of the next package; RtdeError: none before the deadline, or a broken connection."""
        while not deadline.passed:
            if (received := self._next(deadline.left)) is not None:
                return received
        raise RtdeError(f"no expected answer from the controller within {deadline.seconds:.3g} s"
                        + self._last_text())

    def _waiting(self) -> tuple[int, bytes] | None:
        """The next package if it is there already."""
        return self._next(0.0)

    def _next(self, seconds: float) -> tuple[int, bytes] | None:
        """The next package; None if it is not whole after one more piece of the stream, or none came in time."""
        if (received := self._reader.next()) is None:
            self._socket.settimeout(seconds)
            try:
                piece = self._socket.recv(4096)
            except (BlockingIOError, TimeoutError):
                return None
            except OSError as error:
                raise RtdeError(f"the connection to the controller is lost ({error})" + self._last_text()) from error
            if not piece:
                raise RtdeError("the controller has closed the connection" + self._last_text())
            self._reader.feed(piece)
            received = self._reader.next()
        if received is not None and received[0] == Kind.TEXT:
            self.texts = [*self.texts, said(received[1])][-10:]
        return received

    def _last_text(self) -> str:
        return f"; it says: {self.texts[-1]}" if self.texts else ""
