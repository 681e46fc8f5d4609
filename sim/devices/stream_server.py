"""The device's side of our own stream (docs/follow.md), for simulated cameras and force sensors.

Written from the table of the wire format alone, without the code that parses on the other side.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable
from contextlib import suppress

_HEADER = struct.Struct(">2sBBId")
_CAMERA, _FIELD, _SENSOR, _WRENCH, _ASK, _TOLD = 1, 2, 3, 4, 5, 6
_MOST = 8
"""Clients at a time."""
_QUESTION = _HEADER.size + 8


def camera_description(width: int, height: int, rate: float) -> bytes:
    """Payload of the package that says what the camera is; nothing is said of the lens.

    Args:
        width: columns [px].
        height: rows [px].
        rate: pictures a second [Hz].
    """
    return struct.pack(">HHd14d", width, height, rate, *([float("nan")] * 14))


def field_payload(number: int, width: int, height: int, gray: bytes) -> bytes:
    """Payload of a picture.

    Args:
        number: counts the pictures.
        width: columns [px].
        height: rows [px].
        gray: gray values row by row.
    """
    return struct.pack(">IHH", number % 2**32, width, height) + gray


class StreamServer:
    """Sends packages to every client there is, and answers their questions for the clock.

    Args:
        host: address of ours to listen on.
        port: TCP port; 0 for any free one.
        clock: what the device's clock shows now [s].
        kind: 1 for a camera, 3 for a sensor.
        description: payload of the package that says so.
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
        """Where it listens."""
        host, port = self._listener.getsockname()
        return str(host), int(port)

    @property
    def watched(self) -> bool:
        """Whether there is a client."""
        return bool(self._clients)

    def send(self, kind: int, stamp: float, payload: bytes) -> None:
        """One package to every client; one that does not take it within a tenth of a second is let go.

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
        """Stops listening and lets every client go."""
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
            # Sending waits so long; questions may be further apart.
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


