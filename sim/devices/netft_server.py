"""The sensor's side of ATI's raw data transfer, for a simulated force sensor; from the manual's tables alone."""

from __future__ import annotations

import socket
import struct
import threading

from ideal_robot.arrays import Array

COUNTS_FORCE, COUNTS_TORQUE = 1_000_000, 1_000_000
"""Counts per newton and per newton metre."""
_MOST = 2**31 - 1


class NetFTServer:
    """Streams records to whoever asked last.

    Args:
        host: address of ours.
        port: UDP port; 0 for any free one.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self._socket.settimeout(0.2)
        self._client: tuple[str, int] | None = None
        self._number, self._closed = 0, False
        threading.Thread(target=self._listen, daemon=True).start()

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def record(self, sample: int, wrench: Array) -> bytes:
        """The next record.

        Args:
            sample: number of the sensor's sample.
            wrench: force [N] and moment [N m] ``(6,)``.
        """
        self._number += 1
        scales = (COUNTS_FORCE,) * 3 + (COUNTS_TORQUE,) * 3
        counts = (max(-_MOST, min(_MOST, round(float(w) * scale))) for w, scale in zip(wrench, scales, strict=True))
        return struct.pack(">IIIiiiiii", self._number % 2**32, sample % 2**32, 0, *counts)

    def send(self, record: bytes) -> None:
        """One record, if somebody has asked."""
        client = self._client
        if client is not None and not self._closed:
            try:
                self._socket.sendto(record, client)
            except OSError:
                return

    def close(self) -> None:
        """Stops."""
        self._closed = True
        self._socket.close()

    def _listen(self) -> None:
        while not self._closed:
            try:
                asked, client = self._socket.recvfrom(64)
            except TimeoutError:
                continue
            except OSError:
                if self._closed:
                    return
                continue
            if len(asked) == 8 and asked[:2] == b"\x12\x34":
                command = struct.unpack(">H", asked[2:4])[0]
                self._client = client if command == 2 else None if client == self._client else self._client
