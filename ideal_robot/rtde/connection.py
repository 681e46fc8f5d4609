"""A TCP connection to a controller that speaks RTDE: what is agreed on at its beginning, and data packages after it."""

from __future__ import annotations

import socket
import struct
import time

from ideal_robot.rtde.rtde_error import RtdeError
from ideal_robot.rtde.wire import Kind, Reader, Recipe, Value, package, said

_VERSION = 2
"""Version of the protocol that is asked for: the first with a frequency of one's own."""


class RtdeConnection:
    """A client's side of RTDE.

    Args:
        host, port: where the controller listens.
        timeout: how long an answer, or a data package, is waited for [s].

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
        except OSError as error:
            raise RtdeError(f"no controller at {host}:{port} ({error}); RTDE has to be enabled in its security settings"
                            ) from error
        # A command is one small package: it must not wait for a second one to go with it.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def agree(self) -> tuple[int, int, int, int]:
        """Agrees on the protocol; returns the controller's version: major, minor, bug fix, build.

        Raises:
            RtdeError: the controller does not know this version of the protocol.
        """
        if self._asked(Kind.VERSION, struct.pack(">H", _VERSION)) != b"\1":
            raise RtdeError(f"the controller does not know version {_VERSION} of RTDE; it needs PolyScope 3.4 or newer")
        self.send(package(Kind.CONTROLLER))
        answer = self._answer(Kind.CONTROLLER)
        if len(answer) != 16:
            raise RtdeError(f"the controller's version has {len(answer)} bytes, 16 are expected")
        major, minor, fix, build = struct.unpack(">4I", answer)
        return major, minor, fix, build

    def outputs(self, names: tuple[str, ...], frequency: float) -> Recipe:
        """What the controller is to send, so often a second.

        Raises:
            RtdeError: see ``Recipe.agreed``.
        """
        return Recipe.agreed(names, self._asked(Kind.OUTPUTS, struct.pack(">d", frequency) + ",".join(names).encode()))

    def inputs(self, names: tuple[str, ...]) -> Recipe:
        """What we are to send.

        Raises:
            RtdeError: see ``Recipe.agreed``.
        """
        return Recipe.agreed(names, self._asked(Kind.INPUTS, ",".join(names).encode()))

    def start(self) -> None:
        """Data packages from now on.

        Raises:
            RtdeError: the controller does not start.
        """
        if self._asked(Kind.START) != b"\1":
            raise RtdeError("the controller does not start to send" + self._last_text())

    def pause(self) -> None:
        """No data packages any more; what the controller answers is not waited for."""
        try:
            self._socket.sendall(package(Kind.PAUSE))
        except OSError:
            return

    def send(self, data: bytes) -> None:
        """A data package.

        Raises:
            RtdeError: the connection is broken.
        """
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise RtdeError(f"the controller is gone ({error})" + self._last_text()) from error

    def newest(self, recipe: Recipe) -> tuple[dict[str, Value], float]:
        """The newest data package that is there, waited for if there is none, and when it was read.

        Raises:
            RtdeError: silence, a broken connection, a package that does not fit.
        """
        payload, end = None, time.perf_counter() + self._timeout
        while payload is None:
            payload = self._data(end)
        arrived = time.perf_counter()
        while (later := self._data(0.0)) is not None:
            payload = later
        return recipe.unpacked(payload), arrived

    def close(self) -> None:
        """Ends the connection."""
        self._socket.close()

    def _asked(self, kind: Kind, payload: bytes = b"") -> bytes:
        self.send(package(kind, payload))
        return self._answer(kind)

    def _answer(self, kind: Kind) -> bytes:
        end = time.perf_counter() + self._timeout
        while True:
            found, payload = self._package(end) or (None, b"")
            if found == kind:
                return payload

    def _data(self, end: float) -> bytes | None:
        """Payload of the next data package, None if the next package is another one or (``end = 0``) not there."""
        found = self._package(end)
        return found[1] if found is not None and found[0] == Kind.DATA else None

    def _package(self, end: float) -> tuple[int, bytes] | None:
        """The next package; with ``end = 0`` None instead of waiting."""
        while (found := self._reader.next()) is None:
            left = end - time.perf_counter()
            if end and left <= 0:
                raise RtdeError(f"nothing from the controller within {self._timeout:.3g} s" + self._last_text())
            self._socket.settimeout(left if end else 0.0)
            try:
                piece = self._socket.recv(4096)
            except BlockingIOError:
                return None
            except TimeoutError:
                continue
            except OSError as error:
                raise RtdeError(f"the controller is gone ({error})" + self._last_text()) from error
            if not piece:
                raise RtdeError("the controller has closed the connection" + self._last_text())
            self._reader.feed(piece)
        if found[0] == Kind.TEXT:
            self.texts = [*self.texts, said(found[1])][-10:]
        return found

    def _last_text(self) -> str:
        return f"; it says: {self.texts[-1]}" if self.texts else ""
